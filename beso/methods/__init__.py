"""The methods of the paper's comparison, one module each.

A module defines, from what beso.core.method offers,

    Config       what shapes the network (`methods.<name>.train.<env>.model`), a ModelConfig
    Sampling     what only action generation needs (`methods.<name>.sample.<env>`), a SamplingConfig
    Method       network, loss and acting, a BaseMethod

Where a Sampling stands on code that training must not depend on, as the diffusion policies' does on samplers, it lies
in beso.sampling, and the module has its place instead: SAMPLING = "<module>:<class>".

Modules are imported by name, so that a pipeline cell depends on its own method's file and on no other's.
"""

from __future__ import annotations

import importlib
import pkgutil
from typing import Any, Protocol

from beso.core.method import ModelConfig, SamplingConfig
from beso.errors import UserError


class Module(Protocol):
    """What a method's module offers."""

    Config: type[ModelConfig]
    Method: Any  # a BaseMethod and a torch.nn.Module


def names() -> list[str]:
    """Names of all methods."""
    return sorted(m.name for m in pkgutil.iter_modules(__path__))


def load(name: str) -> Module:
    """The module of one method.

    Raises:
        UserError: no such method.
    """
    if name not in names():
        raise UserError(f"method {name!r} is not one of {', '.join(names())}")
    module: Any = importlib.import_module(f"beso.methods.{name}")
    return module


def sampling(name: str) -> type[SamplingConfig]:
    """The Sampling of one method. Raises UserError as `load` does."""
    module: Any = load(name)
    return module.Sampling if hasattr(module, "Sampling") else pkgutil.resolve_name(module.SAMPLING)
