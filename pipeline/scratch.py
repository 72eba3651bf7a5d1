"""Unfinished work that outlives a killed stage.

DVC deletes a stage's outputs when it starts, so unfinished training lives elsewhere: in `.scratch/<fingerprint>/`,
which git and DVC ignore. The fingerprint covers everything the result depends on, so that work is never continued with
other parameters, data or code.
"""

import hashlib
import json
import os
from pathlib import Path
from typing import Any

import torch

import beso
from beso.files import from_home
from pipeline import paths


def folder(*parts: Any) -> Path:
    """The scratch folder for work that depends on `parts` (JSON values), on torch and on the library's code.

    The environment variable BESO_SCRATCH names another place than `.scratch`.
    """
    return from_home(os.environ.get("BESO_SCRATCH", paths.SCRATCH)).absolute() / fingerprint(*parts)


def fingerprint(*parts: Any, torch_version: str = torch.__version__) -> str:
    """The name of that folder."""
    text = json.dumps([*parts, torch_version, _code_digest()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _code_digest() -> str:
    digest = hashlib.sha256()
    root = Path(beso.__file__).parent
    for path in sorted(root.rglob("*.py")):
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()
