"""YAML 1.2 files, as DVC reads them: PyYAML would read 1e-4 as text and `on` as true."""

import re
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beso.errors import UserError


def read_yaml(path: Path) -> Any:
    """Read a YAML file.

    Raises:
        UserError: the file is missing or is not YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        hint = ": run this in the repository's root" if path.parent == Path() else ""
        raise UserError(f"{path} is missing{hint}") from None
    except IsADirectoryError:
        raise UserError(f"{path} is a folder, expected a file") from None
    except UnicodeDecodeError:
        raise UserError(f"{path} is not UTF-8 text") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, where: str) -> Any:
    """Read YAML. Raises UserError if it is none."""
    if re.search("^(<<<<<<<|>>>>>>>) ", text, re.MULTILINE):
        raise UserError(f"{where} has git's merge markers (<<<<<<<): resolve the conflict first")
    try:
        return YAML(typ="safe").load(text)
    except (YAMLError, ValueError, RecursionError) as error:
        raise UserError(f"{where} is not valid YAML: {' '.join(str(error).split())}") from None
