"""Training of one cell: its seeds side by side in worker processes, each resumable."""

from __future__ import annotations

import dataclasses
import math
import shutil
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beso import envs
from beso.core import checkpoint
from beso.core.device import Precision, pick_device, pick_precision
from beso.core.training_config import TrainingJob
from beso.data import play
from beso.errors import UserError
from beso.files import replacing, sha256, write_text
from beso.training.loop import Training, side_by_side
from pipeline import recipes, scratch
from pipeline.machine import Machine
from pipeline.pool import map_jobs
from pipeline.recipes import TrainRecipe

if TYPE_CHECKING:
    import pandas as pd
    import torch

STATE = "state.safetensors"


def main(env: str, method: str) -> None:
    train_cell(recipes.read_train(env, method), Machine.load())


def train_cell(recipe: TrainRecipe, machine: Machine) -> None:
    """Train every seed of one cell and write its models and curves.

    Finished seeds and the state of unfinished ones wait in the scratch folder until all are done.
    """
    jobs = recipe.jobs
    digest = play.data_digest(play.load(recipe.play, envs.spec(recipe.env)))
    folders = [scratch.folder(*identity(recipe, job, digest, pick_device(machine.device))) for job in jobs]
    groups = [slice(i, i + machine.seeds_together) for i in range(0, len(jobs), machine.seeds_together)]
    arguments = [(recipe, jobs[group], machine, folders[group]) for group in groups]
    for _ in map_jobs(train_seeds, arguments, machine, f"train {recipe.env} {recipe.method}"):
        pass

    with replacing(recipe.models) as models:
        models.mkdir()
        for finished in folders:
            for path in finished.glob("seed*"):
                shutil.copyfile(path, models / path.name)
    write_text(recipe.curve, _curves(recipe.models, jobs).to_csv())
    for finished in folders:
        shutil.rmtree(finished)


def identity(
    recipe: TrainRecipe, job: TrainingJob, data_digest: str, device: torch.device, auto: Precision | None = None
) -> list[Any]:
    """What a trained model of one cell depends on besides code and torch (see pipeline.scratch).

    Args:
        auto: what precision "auto" means on the device; None asks it.

    Raises:
        UserError: its teacher is missing, or of other play data.
    """
    parts = ["train", recipe.env, dataclasses.asdict(job), data_digest, device.type]
    if job.config.optimization.precision == "auto":
        parts.append(auto or pick_precision("auto", device))
    if recipe.teacher is None:
        return parts
    if checkpoint.load_description(recipe.source, job.seed)["data"] != data_digest:
        raise UserError(f"{recipe.source}, the teacher, was trained on other play data; train it again")
    return [*parts, sha256(checkpoint.paths(recipe.source, job.seed)[0])]


def _curves(models: Path, jobs: list[TrainingJob]) -> pd.DataFrame:
    """By step: means over seeds, as `dvc plots` draws them, and each seed's held-out loss."""
    import pandas as pd  # a machine that only trains may lack it

    seeds = {job.seed: pd.DataFrame(checkpoint.load_description(models, job.seed)["curve"]) for job in jobs}
    table = pd.concat(seeds.values()).groupby("step").mean()
    for seed, curve in seeds.items():
        table[f"validation_loss_seed{seed}"] = curve.set_index("step")["validation_loss"]
    return table


def train_seeds(
    recipe: TrainRecipe, jobs: list[TrainingJob], machine: Machine, folders: list[Path], until: float = math.inf
) -> bool:
    """Train some models of one cell in turns, each into its folder, unless they are there already.

    Args:
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
    spec, device = envs.spec(recipe.env), pick_device(machine.device)
    dataset = play.load(recipe.play, spec, verify=False)  # the stage has
    teacher = recipe.source if recipe.teacher else None
    unfinished = {
        Training(job, dataset, spec, device, folder / STATE, recipe.play, teacher, machine.cuda_graph): (job, folder)
        for job, folder in waiting
    }
    for training in side_by_side(list(unfinished), machine.save_seconds, until):
        job, folder = unfinished.pop(training)
        checkpoint.save(folder, job, spec.sizes, training.result(), play.data_digest(dataset))
        (folder / STATE).unlink(missing_ok=True)
    return not unfinished
