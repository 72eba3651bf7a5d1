"""`beso evaluate CELL` plays a cell's evaluation with models from any folder, outside DVC; `beso watch CELL` films it.

A film's episode is that of the evaluation: the same start, goal and policy noise. Its run is the repository's own, or
an archived one, which has all that is needed for the policies whose weights it keeps (`beso publish`).
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from beso import envs
from beso.core import checkpoint
from beso.errors import UserError
from beso.files import write_text
from pipeline.machine import Machine
from pipeline.params import PATH, load
from pipeline.report.statistics import over_seeds
from pipeline.report.tables import number
from pipeline.rollouts import evaluation_jobs, play_all
from pipeline.tools.train import finished
from stages.evaluate import film_episode


def evaluate(name: str, seeds: Sequence[int], models: Path, rows: Path | None) -> None:
    """Play all episodes of some seeds of a cell, and print means with 95 % intervals by goal set.

    Args:
        seeds: none means all of params.yaml.
        models: a folder as `beso train` or a run has it.
        rows: a file for the episodes, as results/ENV/METHOD.csv.

    Raises:
        UserError: a model, play data or trials are missing, or of other parameters.
    """
    params, machine = load(), Machine.load()
    cell = params.cell_named(name)
    if rows is not None and not rows.parent.is_dir():
        raise UserError(f"--rows {rows}: must be a file in a folder that exists")
    folders = finished(models, params, name, seeds)
    jobs = evaluation_jobs(replace(cell.evaluate, seeds=tuple(folders)), machine)
    played, _ = play_all(machine, [replace(job, models=folders[job.seed]) for job in jobs], f"evaluate {name}")
    table, report = pd.DataFrame(played), envs.report(cell.env)
    if rows is not None:
        write_text(rows, table.to_csv(index=False))
    for goals, part in table.groupby("goals", sort=False):
        scores = [(metric.label, over_seeds(part, metric)) for metric in report.METRICS]
        told = (f"{label} {number(s.mean)} ({number(s.low)} to {number(s.high)})" for label, s in scores)
        print(f"{report.GOAL_LABELS[goals]}, {len(part)} episodes: {', '.join(told)}")


def watch(name: str, seed: int, episode: int, models: Path | None, run: Path, film: Path) -> None:
    """Film one episode and print its row.

    Args:
        seed: the trained model.
        models: a folder as `beso train` or a run has it; None is the run's.
        run: the folder of params.yaml, play data and trials.
        film: the .webm file to write.

    Raises:
        UserError: something of that is missing, models are given for another run than the repository's, or this
            machine cannot draw.
    """
    params = load(run / PATH)
    cell = params.cell_named(name)
    if film.suffix != ".webm" or not film.parent.is_dir():
        raise UserError(f"--film {film}: must be a .webm file in a folder that exists")
    if run.samefile(Path()):
        folder = finished(models or Path("models"), params, name, [seed])[seed]
    elif models:
        raise UserError(f"--models {models}, --run {run}: give one of them; another run is filmed with its own models")
    else:
        folder = run / cell.models
    weights = checkpoint.paths(folder, seed)[0]
    if not weights.is_file():
        kept = sorted(map(str, (run / "models").glob("*/*/*.safetensors")))
        raise UserError(f"{weights} was not archived: {', '.join(kept) or 'no weights'} were; others need training")
    (job,) = evaluation_jobs(replace(cell.evaluate, seeds=(seed,)), Machine.load(), run)
    row = film_episode(replace(job, models=folder), film, episode)
    print(", ".join(f"{key} {value}" for key, value in row.items()))
    print(f"film: {film}")
