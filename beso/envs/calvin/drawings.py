"""CALVIN's figures: success of each single task (the paper's Fig. "CALVIN Hard tasks"), single tasks beside pairs of
tasks (its Fig. "calvin results"), and what tasks the play has."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from beso.data.play import PlayDataset
from beso.envs.calvin.spec import SPEC
from beso.envs.figures import COLOURS

MEAN = "mean"
COLUMNS = ("single tasks", "two tasks: at least one", "two tasks: both at once", "two tasks: share done")


def words(task: int | str) -> str:
    """A task's name in words, from its number."""
    return SPEC.tasks[int(task)].replace("_", " ")


def by_task(rows: pd.DataFrame) -> pd.DataFrame:
    """Success in single tasks: a row a model seed, a column a task in words and MEAN, that over the tasks.

    Tasks stand in the order of their first episode.
    """
    single = rows[rows["goals"] == "single_tasks"]
    names = single["goal_tasks"].astype(str).map(words)
    table = single.groupby([single["seed"], names])["success"].mean().unstack()[list(dict.fromkeys(names))]
    return table.assign(**{MEAN: table.mean(axis=1)})


def in_short(rows: pd.DataFrame) -> pd.DataFrame:
    """The columns COLUMNS, a row a model seed; those for two tasks are missing (NaN) where none were evaluated."""
    pairs = rows[rows["goals"] == "two_tasks"]
    of_seed = pairs["seed"]
    parts = [
        by_task(rows)[MEAN],
        (pairs["completed"] >= 1).groupby(of_seed).mean(),
        pairs["success"].groupby(of_seed).mean(),
        pairs["completed"].groupby(of_seed).mean() / 2,
    ]
    return pd.concat(parts, axis=1, keys=COLUMNS)


def task_shares(dataset: PlayDataset) -> dict[str, float]:
    """Of all tasks done in the play, the share of each; in words."""
    counts = dataset.tasks.sum(axis=0, dtype=np.int64)
    return {words(task): float(count) for task, count in enumerate(counts / max(1, counts.sum()))}


def bars(tables: Mapping[str, pd.DataFrame], label: str) -> Figure:
    """Groups of bars, a group a column and a bar a method; heights are means over seeds, lines standard deviations.

    Args:
        tables: by method's label, a row a model seed; all have the same columns.
    """
    figure = Figure(figsize=(7, 3.2), layout="constrained")
    axis = figure.subplots()
    width = 0.8 / len(tables)
    columns: list[str] = []
    for i, (method, table) in enumerate(tables.items()):
        columns = list(table.columns)
        places = np.arange(len(columns)) + (i - (len(tables) - 1) / 2) * width
        colour = COLOURS[i % len(COLOURS)]
        axis.bar(
            places, table.mean(), width, yerr=table.std().fillna(0), color=colour, label=method, error_kw={"lw": 0.7}
        )
    axis.set_xticks(range(len(columns)), columns, rotation=30, ha="right")
    axis.set(ylabel=label, ylim=(0, 1.05))
    figure.legend(loc="outside upper center", ncols=len(tables), frameon=False)
    return figure


def play(shares: Mapping[str, float]) -> Figure:
    """How often each task was done in the play, a bar a task; see task_shares."""
    figure = Figure(figsize=(7, 2.6), layout="constrained")
    axis = figure.subplots()
    axis.bar(range(len(shares)), list(shares.values()), color=COLOURS[0])
    axis.set_xticks(range(len(shares)), list(shares), rotation=90, fontsize=6)
    axis.set_ylabel("share of the tasks done")
    return figure
