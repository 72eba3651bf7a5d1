"""How values of params.yaml are merged from blocks, the later ones over the earlier. For a method in an environment:

    all_methods: all, then the environment's own
    the method that `like` names, with what that is like
    the method itself: all, then the environment's own

null in place of a mapping drops it.
"""

import re
from collections.abc import Iterator, Mapping
from typing import Any

from beso import envs
from beso.config import build, shown
from beso.errors import UserError
from pipeline.settings import SHARED, File

Layer = tuple[str, Any]  # a block of params.yaml and its key
Layers = list[Layer]


class Inheritance:
    """The methods' blocks, and what a method has in an environment after merging them. See this file's first lines.

    Raises:
        UserError: a block is of no environment, or `like` names no method or leads in a circle.
    """

    def __init__(self, file: File, where: str) -> None:
        self._blocks: Mapping[str, Any] = {"all_methods": file.all_methods, **file.methods}
        self._where = {name: f"{where}.{name}" for name in file.methods} | {
            "all_methods": f"{where.removesuffix('methods')}all_methods"
        }
        for name, block in self._blocks.items():
            for part in ("train", "sample"):
                for column in getattr(block, part):
                    if column not in (*SHARED, *envs.names()):
                        allowed = ", ".join((*SHARED, *envs.names()))
                        raise UserError(f"{self._where[name]}.{part}.{column}: must be one of {allowed}")
                if name != "all_methods":
                    self._chain(name, part)

    def _chain(self, method: str, part: str) -> list[str]:
        """The methods whose blocks are merged, in that order."""
        chain, allowed = [method], list(self._blocks)[1:]
        while (like := getattr(self._blocks[chain[0]], part).get("like")) is not None:
            where = f"{self._where[chain[0]]}.{part}.like = {shown(like)}"
            if like not in allowed:
                raise UserError(f"{where}: must be one of {', '.join(allowed)}")
            if like in chain:
                raise UserError(f"{where}: leads in a circle")
            chain.insert(0, like)
        return ["all_methods", *chain]

    def layers(self, method: str, part: str, env: str) -> Iterator[Layer]:
        """The blocks of one method in one environment, the weakest first, with their keys in params.yaml."""
        for name in self._chain(method, part):
            for column in ("all", env):
                block = getattr(self._blocks[name], part).get(column)
                if block is not None:
                    yield f"{self._where[name]}.{part}.{column}", block

    def whole(self, cls: Any, method: str, part: str, env: str) -> tuple[Any, Layers]:
        """A configuration from the merged blocks, and these. Raises UserError as `build_merged`."""
        layers = list(self.layers(method, part, env))
        return build_merged(cls, layers, f"{self._where[method]}.{part}.{env}"), layers


def build_merged(cls: Any, layers: Layers, place: str, inner: tuple[str, Any] | None = None) -> Any:
    """A configuration from merged blocks.

    Args:
        layers: the blocks, each with its key in params.yaml.
        place: the key where the merged values would stand.
        inner: a key below that, and its values: only these are built.

    Raises:
        UserError: a mistake, with the key of the block that has it.
    """
    values: Any = {}
    for key, block in layers:
        if not isinstance(block, dict):
            raise UserError(f"{key} = {shown(block)}: expected a mapping")
        values = merge(values, block)
    try:
        return build(cls, inner[1], f"{place}.{inner[0]}") if inner else build(cls, values, place)
    except UserError as error:
        raise UserError(_located(str(error), place, layers)) from None


def _located(message: str, place: str, layers: Layers) -> str:
    """A message about a merged value with the key of the block that gives it."""
    match = re.match(re.escape(place) + r"((?:\.\w+)*)(: (\w+) = )?", message)
    if match is None:
        return message
    path = [*match[1].split(".")[1:], *([match[3]] if match[3] else [])]
    for key, block in reversed(layers):
        inner: Any = block
        for name in path:
            inner = inner.get(name, layers) if isinstance(inner, dict) else layers
        if inner is not layers:
            return key + message[len(place) :]
    return message


def merge(base: Any, changes: Any) -> dict[str, Any]:
    """Nested mappings, those of `changes` over those of `base`; null in place of a mapping drops it."""
    merged = dict(base or {})
    for key, value in (changes or {}).items():
        if isinstance(merged.get(key), dict) and (value is None or isinstance(value, dict)):
            if value is None:
                del merged[key]
            else:
                merged[key] = merge(merged[key], value)
        else:
            merged[key] = value
    return merged
