"""A profile is a folder of `profiles/`: what params.yaml holds, in `common.yaml` and a file for each environment.

Profile `paper` is complete. Any other gives what it changes in the profile that it `extends`; without a word, in paper.
null in place of a mapping takes it out: a cell, a study, a method. What a profile says of all environments, of all
studies, or of a method in `all` environments replaces what the profiles before it said of each.
"""

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from beso.errors import UserError
from beso.files import write_text
from pipeline import params
from pipeline.params import Params
from pipeline.yaml import parse_yaml, read_yaml

FOLDER = Path("profiles")
COMPLETE = "paper"
FIRST = "common.yaml"
WIDTH = 100  # of a list on one line
GENERAL = {"all_environments": "environments", "all_studies": "studies"}
KEY = re.compile(r"(?P<indent> *)(?P<key>[^\s#:-][^\s#:]*):(?: (?P<value>[^#]*?))??(?:\s*# (?P<note>.*))?")

Key = tuple[str, ...]


class Comment(NamedTuple):
    """The lines above a key, and the comment at the end of its own line."""

    above: str
    note: str


def render(name: str) -> str:
    """The text of params.yaml for one profile, with comments, and the paper's value beside each that differs.

    Raises:
        UserError: no such profile, or its values do not check.
    """
    return _read(name)[0]


@functools.cache
def load(name: str) -> Params:
    """One profile's parameters, read once in a process. Raises UserError as `render` does."""
    return _read(name)[1]


def names() -> list[str]:
    """All profiles."""
    return sorted(path.name for path in FOLDER.iterdir() if path.is_dir())


def write(name: str) -> list[str]:
    """Write params.yaml for one profile; a line for each leaf that changes. Raises UserError as `render` does."""
    text = render(name)
    try:
        before = dict(leaves(read_yaml(params.PATH)))
    except UserError:  # there is none yet, or it is what the user wants to replace
        before = {}
    write_text(params.PATH, text)
    after, missing = dict(leaves(read_yaml(params.PATH))), "(none)"
    keys = [key for key in sorted(before.keys() | after.keys()) if before.get(key, missing) != after.get(key, missing)]
    return [f"{key}: {before.get(key, missing)} -> {after.get(key, missing)}" for key in keys]


def leaves(values: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """All leaves of nested mappings, with dotted keys."""
    if isinstance(values, dict) and values:
        for name, value in values.items():
            yield from leaves(value, f"{key}.{name}" if key else str(name))
    else:
        yield key, values


def _read(name: str) -> tuple[str, Params]:
    values, comments = _merged(name, ())
    values["profile"] = name
    text = "\n".join(_lines(values, comments)).strip() + "\n"
    return text, params.parse(parse_yaml(text, f"profile {name}"), f"profile {name}")


def _merged(name: str, extending: tuple[str, ...]) -> tuple[dict[str, Any], dict[Key, Comment]]:
    """A profile's values, on those that it extends, and the comments of all."""
    if name not in names():
        raise UserError(f"profile {name!r} is not one of {', '.join(names())}")
    if name in extending:
        raise UserError(f"profile {name} extends itself: {' -> '.join([*extending, name])}")
    files = sorted((FOLDER / name).glob("*.yaml"), key=lambda path: (path.name != FIRST, path.name))
    texts = {path: path.read_text(encoding="utf-8") for path in files}
    parts = {path: parse_yaml(text, str(path)) for path, text in texts.items()}
    for path, part in parts.items():
        if not isinstance(part, dict):
            raise UserError(f"{path}: must be a mapping, such as `environments:` with what belongs to it below")
    if name == COMPLETE:
        values: dict[str, Any] = {}
        comments = {key: comment for text in reversed(texts.values()) for key, comment in _comments(text).items()}
        for path, part in parts.items():
            _join(values, part, str(path))
        return values, comments
    base = next((part.pop("extends") for part in parts.values() if "extends" in part), COMPLETE)
    values, comments = _merged(base, (*extending, name))
    for part in parts.values():
        _change(values, part, values, comments, (), base)
    return values, comments


@functools.cache
def _complete() -> tuple[dict[str, Any], dict[Key, Comment]]:
    """The values of profile paper, by dotted keys, and its comments."""
    values, comments = _merged(COMPLETE, ())
    return dict(leaves(values)), comments


def _join(values: dict[str, Any], part: dict[str, Any], where: str) -> None:
    """Add the keys of another file; mappings that both have are joined."""
    for key, value in part.items():
        if isinstance(values.get(key), dict) and isinstance(value, dict):
            _join(values[key], value, f"{where}.{key}")
        elif key in values:
            raise UserError(f"{where}: {key} is given twice")
        else:
            values[key] = value


def _change(
    inner: dict[str, Any], changes: dict[str, Any], values: dict[str, Any], notes: Any, path: Key, base: str
) -> None:
    """Apply a profile's changes to one mapping of all values, which are those of profile `base`."""
    for name, value in changes.items():
        key = (*path, name)
        if value is None and isinstance(inner.get(name), dict):
            del inner[name]
        elif isinstance(value, dict):
            if not isinstance(inner.get(name), dict):
                inner[name] = {}
            _change(inner[name], value, values, notes, key, base)
        else:
            for special in _special(values, key):
                _remove(values, special)
            if inner.get(name, value) != value:
                papers, comments = _complete()
                before, whose = inner[name], base
                above, note = notes.get(key, Comment("", ""))
                if (dotted := ".".join(key)) in papers:
                    before, whose, (above, note) = papers[dotted], COMPLETE, comments.get(key, Comment("", ""))
                if before != value and " in profile " not in note:
                    note = f"{_text(before)} in profile {whose}" + (f"; {note}" if note else "")
                notes[key] = Comment(above, note)
            inner[name] = value


def _special(values: dict[str, Any], key: Key) -> list[Key]:
    """The keys for single environments or studies that a key for all of them replaces."""
    if key[0] in GENERAL:
        return [(GENERAL[key[0]], name, *key[1:]) for name in values[GENERAL[key[0]]]]
    if key[0] == "methods" and key[3:4] == ("all",):
        return [(*key[:3], name, *key[4:]) for name in values["methods"][key[1]][key[2]] if name not in ("all", "like")]
    return []


def _remove(values: Any, key: Key) -> None:
    """Delete a leaf, and the mappings that it leaves empty."""
    name, *rest = key
    if isinstance(values, dict) and name in values:
        if rest:
            _remove(values[name], tuple(rest))
        if not rest or values[name] == {}:
            del values[name]


def _comments(text: str) -> dict[Key, Comment]:
    """The comments of a file by key."""
    found: dict[Key, Comment] = {}
    path: Key = ()
    above: list[str] = []
    for line in text.splitlines():
        if not line.strip() or line.lstrip().startswith("#"):
            above.append(line.strip())
        elif match := KEY.fullmatch(line):
            path = (*path[: len(match["indent"]) // 2], match["key"])
            found[path] = Comment("\n".join(above), match["note"] or "")
            above = []
    return found


def _lines(values: dict[str, Any], comments: dict[Key, Comment], path: Key = ()) -> Iterator[str]:
    """YAML of nested mappings."""
    indent = "  " * len(path)
    for name, value in values.items():
        key = (*path, name)
        above, note = comments.get(key, Comment("", ""))
        yield from (f"{indent}{line}".rstrip() for line in above.split("\n") if above)
        end = f" # {note}" if note else ""
        if isinstance(value, dict) and value and path != ("cells",):
            yield f"{indent}{name}:{end}"
            yield from _lines(value, comments, key)
        elif isinstance(value, list) and len(_text(value)) > WIDTH:
            yield f"{indent}{name}:{end}"
            yield from (f"{indent}- {_text(item)}" for item in value)
        else:
            yield f"{indent}{name}: {_text(value)}{end}"


def _text(value: Any) -> str:
    """A value on one line, as YAML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_text(item)}" for name, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_text, value)) + "]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    return str(value)
