"""`beso profile NAME` writes params.yaml from profiles/paper/ and what profiles/NAME/ changes.

A profile is a folder of files: common.yaml, and one a room (environment). The complete profile's files are joined,
common.yaml first; in those of another profile, `null` for a whole cell, method, study or environment leaves it out.
Comments are kept, and every leaf that changes in params.yaml is printed.
"""

import functools
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from beso.errors import UserError
from beso.files import write_text
from pipeline import params
from pipeline.params import Params

FOLDER = Path("profiles")
COMPLETE = "paper"
FIRST = "common.yaml"


def render(name: str) -> str:
    """The text of params.yaml for one profile.

    Raises:
        UserError: no such profile, it changes a key that the complete profile lacks, or its values do not check.
    """
    return _read(name)[0]


@functools.cache
def load(name: str) -> Params:
    """One profile's parameters, read once in a process. Raises UserError as `render` does."""
    return _read(name)[1]


def _read(name: str) -> tuple[str, Params]:
    available = sorted(path.name for path in FOLDER.iterdir() if path.is_dir())
    if name not in available:
        raise UserError(f"profile {name!r} is not one of {', '.join(available)}")
    yaml = YAML()
    yaml.width = 120
    values: Any = None
    for path in _files(COMPLETE):
        part = params.parse_yaml(path.read_text(encoding="utf-8"), str(path), yaml)
        _require_mapping(part, str(path))
        if values is None:
            values = part
        else:
            _join(values, part, str(path))
    for key, value in values.items():
        if value is None:  # no room has anything there
            values[key] = {}
    if name != COMPLETE:
        for path in _files(name):
            changes = params.read_yaml(path) or {}
            _require_mapping(changes, str(path))
            _change(values, changes, str(path))
    text = io.StringIO()
    yaml.dump(values, text)
    checked = params.parse(YAML(typ="safe").load(text.getvalue()), f"profile {name}")
    return text.getvalue(), checked


def leaves(values: Any, key: str = "") -> Iterator[tuple[str, Any]]:
    """All leaves of nested mappings, with dotted keys."""
    if isinstance(values, dict) and values:
        for name, value in values.items():
            yield from leaves(value, f"{key}.{name}" if key else str(name))
    else:
        yield key, values


def _files(name: str) -> list[Path]:
    return sorted((FOLDER / name).glob("*.yaml"), key=lambda path: (path.name != FIRST, path.name))


def _require_mapping(part: Any, where: str) -> None:
    if not isinstance(part, dict):
        raise UserError(f"{where}: must be a mapping, such as `environments:` with what belongs to it below")


def _join(values: Any, part: Any, where: str) -> None:
    """Add the keys of another file, with their comments; mappings that both have are joined."""
    for key, value in part.items():
        if values.get(key) is None:
            values[key] = value
            if key in part.ca.items and key not in values.ca.items:
                values.ca.items[key] = part.ca.items[key]
        elif isinstance(value, dict) and isinstance(values[key], dict):
            _join(values[key], value, f"{where}.{key}")
        else:
            raise UserError(f"{where}: {key} is given twice")


def _change(values: Any, changes: Any, where: str) -> None:
    for key, value in changes.items():
        if key not in values:
            raise UserError(f"{where}: {key} is not a key of profiles/{COMPLETE} there")
        if value is None and isinstance(values[key], dict):
            del values[key]
        elif isinstance(value, dict) and isinstance(values[key], dict):
            _change(values[key], value, f"{where}.{key}")
        else:
            if key != "profile":
                _note(values, key)
            values[key] = value


def _note(values: Any, key: str) -> None:
    """Put the complete profile's value into the comment of a leaf that changes."""
    comment = values.ca.items.get(key)
    existing, _, following = comment[2].value.partition("\n") if comment and comment[2] else ("", "", "")
    old = "null" if values[key] is None else values[key]
    note = f"{old} in profile {COMPLETE}" + existing.replace("#", ";", 1)
    values.yaml_add_eol_comment(note, key)
    values.ca.items[key][2].value += "\n" + following


def main(name: str) -> None:
    """Write params.yaml, and print what changes. Raises UserError as `render` does."""
    text = render(name)
    try:
        before = dict(leaves(params.read_yaml(params.PATH)))
    except UserError:  # there is none yet, or it is what the user wants to replace
        before = {}
    write_text(params.PATH, text)
    after = dict(leaves(params.read_yaml(params.PATH)))
    for key in sorted(before.keys() | after.keys()):
        if before.get(key) != after.get(key):
            print(f"{key}: {before.get(key)} -> {after.get(key)}")
