"""`beso evaluate CELL` plays a cell's evaluation with models from any folder, outside DVC."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd

from beso import envs
from beso.errors import UserError
from beso.files import write_text
from pipeline.machine import Machine
from pipeline.params import load
from pipeline.play import evaluation_jobs, play_all
from pipeline.report.statistics import over_seeds
from pipeline.report.tables import number
from pipeline.tools.train import finished


def evaluate(name: str, seeds: Sequence[int], models: Path, rows: Path | None) -> None:
    """Play all episodes of some seeds of a cell, and print means with 95 % intervals by goal set.

    Args:
        seeds: none means all of params.yaml.
        models: a folder as `beso train` or a run has it.
        rows: a file for the episodes, as results/ENV/METHOD.csv.

    Raises:
        UserError: a model, play data or trials are missing, or of other parameters.
    """
    params = load()
    cell = params.cell_named(name)
    if rows is not None and not rows.parent.is_dir():
        raise UserError(f"--rows {rows}: must be a file in a folder that exists")
    folders = finished(models, params, name, seeds)
    machine = Machine.load()
    jobs = evaluation_jobs(replace(cell.evaluate, seeds=tuple(folders)), machine)
    played, _ = play_all(machine, [replace(job, models=folders[job.seed]) for job in jobs], f"evaluate {name}")
    table, report = pd.DataFrame(played), envs.report(cell.env)
    if rows is not None:
        write_text(rows, table.to_csv(index=False))
    for goals, part in table.groupby("goals", sort=False):
        scores = [(metric.label, over_seeds(part, metric)) for metric in report.METRICS]
        told = (f"{label} {number(s.mean)} ({number(s.low)} to {number(s.high)})" for label, s in scores)
        print(f"{report.GOAL_LABELS[goals]}, {len(part)} episodes: {', '.join(told)}")
