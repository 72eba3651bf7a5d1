"""Frozen configuration objects from plain mappings, checked when built.

Every mistake becomes one line with the key, the value and what is allowed.
"""

import contextlib
import dataclasses
import math
import types
from collections.abc import Mapping
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from beso.errors import UserError

Config = TypeVar("Config")


LONGEST = 80  # characters of a wrong value that an error shows

# The largest whole number that can be meant, by the name of a field, whichever configuration has it: what is above
# would fill a disk or the memory, or never end.
LARGEST = {
    **dict.fromkeys(("width", "recognition_width", "prior_width", "decoder_width", "plan"), 1 << 15),
    **dict.fromkeys(("layers", "recognition_layers", "prior_layers", "decoder_layers"), 1000),
    **dict.fromkeys(("heads", "recognition_heads"), 1000),
    **dict.fromkeys(("bins", "classes", "mixtures", "counter_examples", "candidates"), 1 << 20),
    **dict.fromkeys(("window", "horizon", "replan", "context_length", "extra_steps", "iterations"), 10_000),
    **dict.fromkeys(("diffusion_steps", "teacher_steps"), 10_000),
    **dict.fromkeys(("steps", "updates", "every"), 10**9),
    **dict.fromkeys(("batch_size", "batches", "windows"), 1 << 20),
    **dict.fromkeys(("demonstrations", "rollouts", "length", "max_actions", "goal_horizon", "samples"), 10**6),
    **dict.fromkeys(("chunk", "workers", "seeds_together", "repeats"), 10_000),
    **dict.fromkeys(("size", "shift"), 4096),  # pixels
    **dict.fromkeys(("seed", "seeds", "root_seed"), (1 << 63) - 1),
}


def shown(value: Any) -> str:
    """A value as an error shows it."""
    text = repr(value)
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def build(cls: type[Config], values: Any, where: str) -> Config:
    """Make a frozen dataclass from a mapping.

    Args:
        cls: a dataclass whose fields are int, float, bool, str, Literal, X | None, tuple[X, ...], dict[str, X],
            other such dataclasses, or Any (taken as it is). A ValueError from its __post_init__ is reported as a
            mistake in the mapping.
        values: the mapping.
        where: name of the mapping, for messages.

    Raises:
        UserError: unknown key, missing key, wrong type, or a value the dataclass refuses.
    """
    if not isinstance(values, Mapping):
        raise UserError(f"{where} = {shown(values)}: expected a mapping")
    hints = get_type_hints(cls)
    fields = {f.name: f for f in dataclasses.fields(cls)}  # type: ignore[arg-type]
    for key in values:
        if key not in fields:
            allowed = ", ".join(fields) or "none"
            raise UserError(f"{where}.{key} = {shown(values[key])}: unknown key; allowed are {allowed}")
    missing = [name for name, f in fields.items() if name not in values and f.default is dataclasses.MISSING]
    if missing:
        raise UserError(f"{where}.{missing[0]} is missing: expected {_describe(hints[missing[0]])}")
    arguments = {key: _convert(hints[key], value, f"{where}.{key}") for key, value in values.items()}
    for key, value in arguments.items():
        for number in value if isinstance(value, tuple) else (value,):
            if isinstance(number, int) and number > LARGEST.get(key, number):
                raise UserError(f"{where}.{key} = {shown(value)}: must be at most {LARGEST[key]}")
    try:
        return cls(**arguments)
    except ValueError as error:
        raise UserError(f"{where}: {error}") from None


def _convert(hint: Any, value: Any, where: str) -> Any:
    origin, arguments = get_origin(hint), get_args(hint)
    if hint is Any:
        return value
    if dataclasses.is_dataclass(hint):
        return build(hint, value, where)  # type: ignore[arg-type]
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        inner = [a for a in arguments if a is not type(None)]
        return _convert(inner[0], value, where)
    if origin is tuple and isinstance(value, (list, tuple)):
        return tuple(_convert(arguments[0], item, f"{where}[{i}]") for i, item in enumerate(value))
    if origin is dict and isinstance(value, Mapping):
        return {str(key): _convert(arguments[1], item, f"{where}.{key}") for key, item in value.items()}
    if origin is Literal and value in arguments:
        return value
    if hint is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        with contextlib.suppress(OverflowError):  # of an integer of hundreds of digits
            if math.isfinite(value):
                return float(value)
    if hint is int and isinstance(value, int) and not isinstance(value, bool):
        return value
    if hint in (str, bool) and isinstance(value, hint):
        return value
    raise UserError(f"{where} = {shown(value)}: expected {_describe(hint)}")


def _describe(hint: Any) -> str:
    origin, arguments = get_origin(hint), get_args(hint)
    if dataclasses.is_dataclass(hint) or origin is dict or hint is Any:
        return "a mapping"
    if origin in (Union, types.UnionType):
        return " or ".join("null" if a is type(None) else _describe(a) for a in arguments)
    if origin is tuple:
        return f"a list, each item {_describe(arguments[0])}"
    if origin is Literal:
        return "one of " + ", ".join(str(a) for a in arguments)
    return {int: "an integer", float: "a finite number", bool: "true or false", str: "text"}[hint]


def require(condition: bool, message: str) -> None:
    """Raise ValueError(message) unless the condition holds; for __post_init__ checks."""
    if not condition:
        raise ValueError(message)


def require_name(config: Any, attribute: str, known: Mapping[str, Any]) -> None:
    """Raise ValueError unless this attribute is one of the names in a registry."""
    value = getattr(config, attribute)
    require(value in known, f"{attribute} = {shown(value)}: must be one of {', '.join(known)}")


def require_positive(config: Any, *names: str) -> None:
    """Raise ValueError unless each of these attributes is at least 1, or None where that is allowed."""
    for name in names:
        value = getattr(config, name)
        require(value is None or value >= 1, f"{name} = {value}: must be at least 1")


def require_rate(config: Any, *names: str) -> None:
    """Raise ValueError unless each of these attributes is a share below one: a dropout rate or a decay."""
    for name in names:
        value = getattr(config, name)
        require(0 <= value < 1, f"{name} = {value}: must be in [0, 1)")
