"""Training of one cell: its seeds side by side in worker processes, each resumable."""

from __future__ import annotations

import dataclasses
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beso import checkpoint, envs
from beso.data import play
from beso.device import pick_device
from beso.errors import UserError
from beso.files import replacing, sha256, write_text
from beso.training import Training, side_by_side
from beso.training_config import TrainingJob
from pipeline import paths, scratch
from pipeline.engine import map_jobs
from pipeline.params import Machine, Params

if TYPE_CHECKING:
    import pandas as pd

STATE = "state.safetensors"


def train_cell(params: Params, environment: str, method: str) -> None:
    """Train every seed of one cell and write its models and curves.

    Finished seeds and the state of unfinished ones wait in the scratch folder until all are done.
    """
    jobs = cell_jobs(params, environment, method)
    data, machine = paths.play(environment), params.machine
    device = pick_device(machine.device).type
    digest = play.data_digest(play.load(data, envs.spec(environment)))
    folders = [scratch.folder(*identity(params, environment, method, job, digest, device)) for job in jobs]
    groups = [slice(i, i + machine.seeds_together) for i in range(0, len(jobs), machine.seeds_together)]
    teacher = teacher_folder(params, environment, method)
    arguments = [(jobs[group], environment, data, machine, folders[group], teacher) for group in groups]
    for _ in map_jobs(train_seeds, arguments, machine, f"train {environment} {method}"):
        pass

    with replacing(paths.models(environment, method)) as models:
        models.mkdir()
        for finished in folders:
            for path in finished.glob("seed*"):
                shutil.copyfile(path, models / path.name)
    write_text(paths.curve(environment, method), _curves(paths.models(environment, method), jobs).to_csv())
    for finished in folders:
        shutil.rmtree(finished)


def cell_jobs(params: Params, environment: str, method: str) -> list[TrainingJob]:
    """The training run of every seed of one cell. Raises UserError if params.yaml does not have it."""
    params.cell(environment, method)
    return [params.job(environment, method, seed) for seed in params.environments[environment].seeds]


def teacher_folder(params: Params, environment: str, method: str) -> Path | None:
    """The trained models that those of one cell learn from, if it is not play data."""
    teacher = params.teacher(environment, method)
    return paths.models(environment, teacher) if teacher else None


def identity(
    params: Params, environment: str, method: str, job: TrainingJob, data_digest: str, device: str
) -> list[Any]:
    """What a trained model of one cell depends on besides code and torch (see pipeline.scratch).

    Raises:
        UserError: its teacher is missing, or of other parameters or other play data.
    """
    parts = ["train", environment, dataclasses.asdict(job), data_digest, device]
    teacher = params.teacher(environment, method)
    if teacher is None:
        return parts
    folder = paths.models(environment, teacher)
    checkpoint.check(folder, params.job(environment, teacher, job.seed))
    if checkpoint.load_description(folder, job.seed)["data"] != data_digest:
        raise UserError(f"{folder}, the teacher, was trained on other play data; train it again")
    return [*parts, sha256(checkpoint.paths(folder, job.seed)[0])]


def _curves(models: Path, jobs: list[TrainingJob]) -> pd.DataFrame:
    """By step: means over seeds, as `dvc plots` draws them, and each seed's held-out loss."""
    import pandas as pd  # a machine that only trains may lack it

    seeds = {job.seed: pd.DataFrame(checkpoint.load_description(models, job.seed)["curve"]) for job in jobs}
    table = pd.concat(seeds.values()).groupby("step").mean()
    for seed, curve in seeds.items():
        table[f"validation_loss_seed{seed}"] = curve.set_index("step")["validation_loss"]
    return table


def train_seeds(
    jobs: list[TrainingJob],
    environment: str,
    data: Path,
    machine: Machine,
    folders: list[Path],
    teacher: Path | None = None,
    until: float = math.inf,
) -> bool:
    """Train some models of one environment in turns, each into its folder, unless they are there already.

    Args:
        teacher: folder of their teachers' models.
        until: when (of time.monotonic) the state of unfinished ones is saved and they are left.

    Returns:
        Whether all are there.
    """
    waiting = [
        (job, folder)
        for job, folder in zip(jobs, folders, strict=True)
        if not checkpoint.paths(folder, job.seed)[1].exists()
    ]
    if not waiting:
        return True
    spec, device = envs.spec(environment), pick_device(machine.device)
    dataset = play.load(data, spec, verify=False)  # the stage has
    unfinished = {
        Training(job, dataset, spec, device, folder / STATE, data, teacher, machine.cuda_graph): (job, folder)
        for job, folder in waiting
    }
    for training in side_by_side(list(unfinished), machine.save_seconds, until):
        job, folder = unfinished.pop(training)
        checkpoint.save(folder, job, spec.sizes, training.result(), play.data_digest(dataset))
        (folder / STATE).unlink(missing_ok=True)
    return not unfinished
