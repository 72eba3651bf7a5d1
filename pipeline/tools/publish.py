"""`python -m pipeline.tools.publish` archives the finished run in reports/published/<profile>/.

The folder holds what the numbers came from: parameters, versions, models, training curves, a row an episode, metrics,
comparison, tables and figures.
"""

import json
import shutil
import subprocess
from pathlib import Path

from beso.errors import UserError
from beso.files import replacing, write_json
from pipeline import paths
from pipeline.params import PATH, Params, load
from pipeline.report.page import versions
from pipeline.stage import run

FOLDER = paths.REPORTS / "published"


def main() -> None:
    params = load()
    _check()
    folder = FOLDER / params.profile
    with replacing(folder) as temporary:
        for path in _contents(params):
            if not path.exists():
                raise UserError(f"{path} is missing: run `dvc repro` first")
            target = temporary / (path.relative_to(paths.REPORTS) if path.is_relative_to(paths.REPORTS) else path)
            target.parent.mkdir(parents=True, exist_ok=True)
            if path.is_dir():
                shutil.copytree(path, target)
            else:
                shutil.copyfile(path, target)
        write_json(temporary / "environment.json", versions())
    print(f"archived in {folder}")


def _check() -> None:
    """What lies on disk must come from these parameters.

    Raises:
        UserError: `dvc repro tables` would still run something.
    """
    command = ["dvc", "status", "--json", "--with-deps", "tables"]
    status = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    if stages := json.loads(status):
        raise UserError(f"{', '.join(stages)} out of date: run `dvc repro tables` first, then publish")


def _contents(params: Params) -> list[Path]:
    kinds = (paths.models, paths.curve, paths.episodes)
    reports = [paths.REPORTS / name for name in ("tables.tex", "comparison.csv", "metrics.json", "figures")]
    cells = [kind(cell.env, cell.method) for cell in params.cells.values() for kind in kinds]
    return [PATH, *reports, *cells, *(paths.study(name) for name in params.studies)]


if __name__ == "__main__":
    run(main)
