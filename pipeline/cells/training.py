"""Training of one cell: its seeds side by side in worker processes, each resumable."""

import dataclasses
import shutil
from pathlib import Path

import pandas as pd

from beso import checkpoint, envs
from beso.data import play
from beso.device import pick_device
from beso.errors import UserError
from beso.files import replacing, sha256, write_text
from beso.training import train
from beso.training_config import TrainingJob
from pipeline import paths, scratch
from pipeline.engine import map_jobs
from pipeline.params import Machine, Params


def train_cell(params: Params, environment: str, method: str) -> None:
    """Train every seed of one cell and write its models and curves.

    Finished seeds and the state of unfinished ones wait in the scratch folder until all are done.
    """
    params.cell(environment, method)
    jobs = [params.job(environment, method, seed) for seed in params.environments[environment].seeds]
    data = paths.play(environment)
    digest = play.data_digest(play.load(data, envs.spec(environment)))
    device = pick_device(params.machine.device).type
    parts = [["train", environment, dataclasses.asdict(job), digest, device] for job in jobs]
    taught_by = params.teacher(environment, method)
    teacher = paths.models(environment, taught_by) if taught_by else None
    if taught_by and teacher:
        for job, part in zip(jobs, parts, strict=True):
            part.append(_teacher_digest(teacher, params.job(environment, taught_by, job.seed), digest))
    folders = [scratch.folder(*part) for part in parts]
    arguments = [(job, environment, data, params.machine, f, teacher) for job, f in zip(jobs, folders, strict=True)]
    for _ in map_jobs(train_seed, arguments, params.machine, f"train {environment} {method}"):
        pass

    with replacing(paths.models(environment, method)) as models:
        models.mkdir()
        for finished in folders:
            for path in finished.glob("seed*"):
                shutil.copyfile(path, models / path.name)
    write_text(paths.curve(environment, method), _curves(paths.models(environment, method), jobs).to_csv())
    for finished in folders:
        shutil.rmtree(finished)


def _teacher_digest(teacher: Path, job: TrainingJob, data_digest: str) -> str:
    """SHA-256 of one trained teacher's weights.

    Raises:
        UserError: it is missing, or of other parameters or other play data.
    """
    checkpoint.check(teacher, job)
    if checkpoint.load_description(teacher, job.seed)["data"] != data_digest:
        raise UserError(f"{teacher}, the teacher, was trained on other play data; train it again")
    return sha256(checkpoint.paths(teacher, job.seed)[0])


def _curves(models: Path, jobs: list[TrainingJob]) -> pd.DataFrame:
    """By step: means over seeds, as `dvc plots` draws them, and each seed's held-out loss."""
    seeds = {job.seed: pd.DataFrame(checkpoint.load_description(models, job.seed)["curve"]) for job in jobs}
    table = pd.concat(seeds.values()).groupby("step").mean()
    for seed, curve in seeds.items():
        table[f"validation_loss_seed{seed}"] = curve.set_index("step")["validation_loss"]
    return table


def train_seed(
    job: TrainingJob, environment: str, data: Path, machine: Machine, folder: Path, teacher: Path | None = None
) -> None:
    """Train one model into `folder`, unless it is there already. `teacher` is the folder of its teacher's models."""
    if checkpoint.paths(folder, job.seed)[1].exists():
        return
    spec = envs.spec(environment)
    dataset = play.load(data, spec)
    state = folder / "state.safetensors"
    trained = train(job, dataset, spec, pick_device(machine.device), state, machine.save_seconds, data, teacher)
    checkpoint.save(folder, job, spec.sizes, trained, play.data_digest(dataset))
    state.unlink(missing_ok=True)
