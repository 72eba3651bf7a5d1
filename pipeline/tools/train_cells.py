"""`python -m pipeline.tools.train_cells --out FOLDER` trains cells of params.yaml where little else is installed.

For a rented GPU machine: it needs torch, numpy, safetensors, tqdm and ruamel.yaml (C-BeT also scikit-learn), this
repository, params.yaml, and data/play/ENV of the cells' environments; no DVC and no simulator. When its time is over it
saves what is unfinished; the same command continues. In the folder are, for every seed,

    ENV/METHOD/seed1-FINGERPRINT/seed1.safetensors, seed1.json    the model, as in models/ENV/METHOD
    ENV/METHOD/seed1-FINGERPRINT/state.safetensors                unfinished
    ENV/METHOD/seed1-FINGERPRINT/curve.csv                        losses by step

where the fingerprint covers parameters, data, code, device and torch. Students find their teachers in models/, where
this puts those that are missing there and finished in the folder. `python -m pipeline.tools.import_cells FOLDER` brings
them back to where DVC is.
"""

import argparse
import csv
import dataclasses
import io
import json
import math
import shutil
import sys
import time
from pathlib import Path

from safetensors import safe_open

from beso import checkpoint, envs
from beso.data import play
from beso.device import pick_device
from beso.errors import UserError
from beso.files import write_text
from beso.training_config import TrainingJob
from pipeline import paths, pool, scratch
from pipeline.cells.training import STATE, cell_jobs, identity, teacher_folder, train_seeds
from pipeline.params import Params, load
from pipeline.stage import guard


def main(*arguments: str) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.tools.train_cells", description="train cells of params.yaml"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of models, states and curves")
    parser.add_argument("--cells", nargs="+", metavar="CELL", help="as in params.yaml, in this order; default: all")
    parser.add_argument("--seeds", nargs="+", type=int, metavar="SEED", help="default: all of params.yaml")
    parser.add_argument("--hours", type=float, default=math.inf, help="stop after so many hours")
    options = parser.parse_args(arguments)
    until = time.monotonic() + 3600 * options.hours
    params = load()
    cells = options.cells or list(params.cells)
    chosen = {cell: _jobs(params, cell, options.seeds) for cell in cells}
    for cell, jobs in chosen.items():
        if not train(params, cell, jobs, options.out, until):
            print(f"time is over in {cell}; the same command continues")
            return
    print(f"all trained: {', '.join(cells)}")


def _jobs(params: Params, cell: str, seeds: list[int] | None) -> list[TrainingJob]:
    of = params.cell_named(cell)
    jobs = cell_jobs(params, of.env, of.method)
    known = [job.seed for job in jobs]
    for seed in seeds or ():
        if seed not in known:
            raise UserError(f"{cell} has no seed {seed} in params.yaml: {', '.join(map(str, known))} are there")
    return [job for job in jobs if seeds is None or job.seed in seeds]


def train(params: Params, cell: str, jobs: list[TrainingJob], out: Path, until: float) -> bool:
    """Train seeds of one cell below `out`, `machine.seeds_together` at a time; whether there was time for all.

    Raises:
        UserError: the play data are missing, or a package that this method alone needs.
    """
    environment, method = params.cells[cell].env, params.cells[cell].method
    data, machine = paths.play(environment), params.machine
    digest = play.data_digest(play.load(data, envs.spec(environment)))
    teacher = teacher_folder(params, environment, method)
    if teacher is not None:
        for job in jobs:
            _bring(params.job(environment, teacher.name, job.seed), out / environment / teacher.name, teacher, digest)
    device = pick_device(machine.device).type
    for start in range(0, len(jobs), machine.seeds_together):
        group = jobs[start : start + machine.seeds_together]
        names = [scratch.fingerprint(*identity(params, environment, method, job, digest, device)) for job in group]
        folders = [
            out / environment / method / f"seed{job.seed}-{name}" for job, name in zip(group, names, strict=True)
        ]
        try:
            # By the pool, for its one torch thread: the order of sums depends on their number.
            (done,) = pool.map_jobs(
                train_seeds, [(group, environment, data, machine, folders, teacher, until)], 1, cell
            )
        except ModuleNotFoundError as error:
            raise UserError(f"{cell} needs the package {error.name}: install it, or leave this cell out") from None
        for job, folder in zip(group, folders, strict=True):
            write_text(folder / "curve.csv", _csv(_curve(folder, job.seed)))
        if not done:
            return False
    return True


def find_finished(trained: Path, job: TrainingJob, digest: str) -> Path | None:
    """The folder of a finished model of this job and play data, a cell's or one in it; what others are is said."""
    expected = json.loads(json.dumps(dataclasses.asdict(job)))
    for folder in [trained, *sorted(trained.glob(f"seed{job.seed}-*"))]:
        if not all(path.is_file() for path in checkpoint.paths(folder, job.seed)):
            if folder != trained:
                print(f"{folder}: not finished")
            continue
        description = checkpoint.load_description(folder, job.seed)
        if description["job"] != expected:
            print(f"{folder}: of other parameters")
        elif description["data"] != digest:
            print(f"{folder}: of other play data")
        else:
            return folder
    return None


def _bring(teacher: TrainingJob, trained: Path, models: Path, digest: str) -> None:
    """Put a finished teacher where its stage would, unless one is there."""
    if not checkpoint.paths(models, teacher.seed)[1].exists() and (source := find_finished(trained, teacher, digest)):
        models.mkdir(parents=True, exist_ok=True)
        for path in checkpoint.paths(source, teacher.seed):
            shutil.copyfile(path, models / path.name)


def _curve(folder: Path, seed: int) -> list[dict[str, float]]:
    """The curve of a finished or an unfinished seed."""
    if (folder / STATE).exists():
        with safe_open(folder / STATE, "pt") as file:
            return json.loads(file.metadata()["curve"])
    return checkpoint.load_description(folder, seed)["curve"]


def _csv(rows: list[dict[str, float]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, ["step", "training_loss", "validation_loss", "learning_rate"], lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


if __name__ == "__main__":
    guard(main, *sys.argv[1:])
