"""`beso train` trains cells of params.yaml where little else is installed.

For a rented GPU machine, or by hand: it needs torch, numpy, safetensors, tqdm, click and ruamel.yaml (C-BeT also
scikit-learn), this repository, params.yaml, and data/play/ENV of the cells' environments; no DVC and no simulator. When
its time is over it saves what is unfinished; the same command continues. In the folder are, for every seed,

    ENV/METHOD/seed1-FINGERPRINT/seed1.safetensors, seed1.json    the model, as in models/ENV/METHOD
    ENV/METHOD/seed1-FINGERPRINT/evaluation.json                  how params.yaml samples it, for `Policy.load`
    ENV/METHOD/seed1-FINGERPRINT/state.safetensors                unfinished
    ENV/METHOD/seed1-FINGERPRINT/curve.csv                        losses by step

where the fingerprint covers parameters, data, code, device and torch. Students find their teachers in models/, where
this puts those that are missing there and finished in the folder. `beso evaluate` and `beso watch` take models from the
folder; `beso import` brings them back to where DVC is.
"""

import csv
import dataclasses
import io
import json
import shutil
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from safetensors import safe_open

from beso import envs
from beso.core import checkpoint
from beso.core.device import pick_device
from beso.core.training_config import TrainingJob
from beso.data import play
from beso.errors import UserError
from beso.files import replacing, write_text
from pipeline import pool, scratch
from pipeline.machine import Machine
from pipeline.params import Cell, Params, load
from pipeline.tools.archive import write_evaluation
from stages.train import STATE, identity, train_seeds


def train_cells(cells: Sequence[str], seeds: Sequence[int], hours: float, out: Path) -> None:
    """Train cells one after another, in this order.

    Args:
        cells, seeds: none means all of params.yaml.
        hours: after so many it stops.
        out: folder of models, states and curves.

    Raises:
        UserError: params.yaml lacks a cell or a seed; or as `train`.
    """
    until = time.monotonic() + 3600 * hours
    params = load()
    chosen = {cell: choose(params, cell, seeds) for cell in cells or params.cells}
    for cell, jobs in chosen.items():
        if not train(params, cell, jobs, out, until):
            print(f"time is over in {cell}; the same command continues")
            return
    print(f"all trained: {', '.join(chosen)}")


def choose(params: Params, cell: str, seeds: Sequence[int]) -> list[TrainingJob]:
    """The trainings of some seeds of a cell, or of all. Raises UserError if params.yaml lacks one."""
    jobs = {job.seed: job for job in params.cell_named(cell).train.jobs}
    for seed in seeds:
        if seed not in jobs:
            raise UserError(f"{cell} has no seed {seed} in params.yaml: {', '.join(map(str, jobs))} are there")
    return [job for seed, job in jobs.items() if not seeds or seed in seeds]


def train(params: Params, cell: str, jobs: list[TrainingJob], out: Path, until: float) -> bool:
    """Train seeds of one cell below `out`, `machine.seeds_together` at a time; whether there was time for all.

    Raises:
        UserError: the play data or a package that this method alone needs are missing, or the teacher that is in
            models/ has other parameters.
    """
    recipe, machine = params.cells[cell].train, Machine.load()
    digest, device = play.data_digest(play.load(recipe.play, envs.spec(recipe.env))), pick_device(machine.device)
    if recipe.teacher is not None:
        teacher = params.cell(recipe.env, recipe.teacher)
        for job in jobs:
            _bring(
                replace(teacher.train.first, seed=job.seed), out / teacher.env / teacher.method, teacher.models, digest
            )
    for start in range(0, len(jobs), machine.seeds_together):
        group = jobs[start : start + machine.seeds_together]
        names = [scratch.fingerprint(*identity(recipe, job, digest, device)) for job in group]
        folders = [
            out / recipe.env / recipe.method / f"seed{job.seed}-{name}" for job, name in zip(group, names, strict=True)
        ]
        try:
            # By the pool, for its one torch thread: the order of sums depends on their number.
            (done,) = pool.map_jobs(train_seeds, [(recipe, group, machine, folders, until)], pool.HERE, cell)
        except ModuleNotFoundError as error:
            raise UserError(f"{cell} needs the package {error.name}: install it, or leave this cell out") from None
        for job, folder in zip(group, folders, strict=True):
            write_text(folder / "curve.csv", _csv(_curve(folder, job.seed)))
            write_evaluation(params.cells[cell], folder)
        if not done:
            return False
    return True


def cell_folder(folder: Path, cell: Cell) -> Path:
    """Where a run, an archive, a folder of models or one of `beso train` has those of a cell."""
    of_run = folder / cell.models
    return of_run if of_run.is_dir() else folder / cell.env / cell.method


def finished(folder: Path, params: Params, name: str, seeds: Sequence[int]) -> dict[int, Path]:
    """The folder of each finished model of a cell, by seed. Raises UserError if one is not there, or as `choose`."""
    cell, jobs = params.cell_named(name), choose(params, name, seeds)
    digest = play.data_digest(play.load(cell.play, envs.spec(cell.env)))
    found = {job.seed: find_finished(cell_folder(folder, cell), job, digest) for job in jobs}
    missing = [seed for seed, path in found.items() if path is None]
    if missing:
        raise UserError(f"{folder} has no model of {name}, seed {missing[0]}: train it first, or name another folder")
    return {seed: path for seed, path in found.items() if path}


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
    """Put a finished teacher where its stage would. Raises UserError if one of other parameters is there."""
    if checkpoint.paths(models, teacher.seed)[1].exists():
        checkpoint.check(models, teacher)
    elif source := find_finished(trained, teacher, digest):
        for path in checkpoint.paths(source, teacher.seed):
            with replacing(models / path.name) as temporary:
                shutil.copyfile(path, temporary)


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
