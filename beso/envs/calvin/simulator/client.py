"""PyBullet's functions bound to a physics server of their own in this process."""

import functools
from typing import Any

import pybullet

from beso.checks import not_copied


class Client:
    """A physics server; every function of `pybullet` is a method of it."""

    def __init__(self) -> None:
        self.identifier = pybullet.connect(pybullet.DIRECT)

    __reduce_ex__ = not_copied

    def __getattr__(self, name: str) -> Any:
        attribute = getattr(pybullet, name)
        if callable(attribute):
            attribute = functools.partial(attribute, physicsClientId=self.identifier)
        setattr(self, name, attribute)
        return attribute

    def close(self) -> None:
        """Disconnect from the server; a second call does nothing."""
        if self.isConnected():
            self.disconnect()
