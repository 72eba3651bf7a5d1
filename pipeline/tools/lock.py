"""The versions of this environment's packages, as constraints for pip.

`constraints/results.txt` has those that bytes of results depend on; stages depend on this file. `constraints/tools.txt`
has the rest. pip takes both: `pip install -c constraints/results.txt -c constraints/tools.txt`.
"""

import importlib.metadata
import re
from pathlib import Path

from beso.files import write_text
from pipeline.report.page import PACKAGES

FOLDER = Path("constraints")
INSTALLER = ("pip", "setuptools", "beso-reproduction")  # not what is installed by the constraints


def pinned() -> dict[str, list[str]]:
    """Lines `name==version` of the installed packages, by the name of their file."""
    found: dict[str, list[str]] = {"results": [], "tools": []}
    for distribution in importlib.metadata.distributions():
        name = re.sub("[-_.]+", "-", distribution.metadata["Name"]).lower()
        version = distribution.version.partition("+")[0]  # a CPU and a CUDA build are the same release
        if name not in INSTALLER:
            found["results" if name in PACKAGES else "tools"].append(f"{name}=={version}")
    return {name: sorted(set(lines)) for name, lines in found.items()}


def main() -> None:
    for name, lines in pinned().items():
        write_text(FOLDER / f"{name}.txt", "\n".join(lines) + "\n")
        print(f"{FOLDER / name}.txt: {len(lines)} packages")
