"""Checks of what enters a policy or a simulator: the one place where numbers from outside become arrays."""

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np

from beso.errors import UserError


def numbers(what: str, value: Any, *shapes: Sequence[int | None]) -> np.ndarray:
    """An array of finite real numbers of one of these shapes, as it is or made of lists.

    Args:
        what: its name, for messages.
        shapes: of the array; None is any number of at least 1.

    Raises:
        UserError: it is something else; the message names the first number that is not finite.
    """
    expected = " or ".join(str(tuple(shape)).replace("None", "any") for shape in shapes)
    if isinstance(value, dict):
        raise UserError(f"{what} is a dict, expected an array of shape {expected}")
    try:
        array = np.asarray(value)
    except (ValueError, TypeError) as error:
        raise UserError(f"{what} is no array of numbers ({error})") from None
    if array.dtype.kind not in "biuf":
        raise UserError(f"{what} holds {array.dtype}, expected real numbers")
    if not any(_fits(array.shape, shape) for shape in shapes):
        raise UserError(f"{what} has shape {array.shape}, expected {expected}")
    finite(what, array)
    return array


def _fits(found: Sequence[int], shape: Sequence[int | None]) -> bool:
    return len(found) == len(shape) and all(
        n == size or (size is None and n > 0) for n, size in zip(found, shape, strict=True)
    )


def finite(what: str, array: np.ndarray) -> None:
    """Raise UserError, naming the first, if not all numbers of an array are finite."""
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        where = f" at {list(place)}" if place else ""
        raise UserError(f"{what} holds {array[place]}{where}: every number must be finite")


def not_copied(self: object, protocol: Any) -> NoReturn:
    """For `__reduce_ex__` of what stands on a simulation: a copy or pickle would share it, or break it.

    Raises:
        TypeError: always.
    """
    raise TypeError(f"a {type(self).__name__} cannot be copied: make another and reset it with the same seed")
