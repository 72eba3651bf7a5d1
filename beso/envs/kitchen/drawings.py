"""Figures of the relay kitchen: how varied the demonstrations are, and what policies do beside them."""

import itertools
import textwrap
from collections.abc import Iterable, Sequence
from typing import Any

import mujoco
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from beso.data.play import PlayDataset
from beso.envs.figures import COLOURS, panels
from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import TASKS
from beso.envs.protocol import Episodes

Order = Sequence[int]  # tasks as they were done

APPROACH = 25  # steps before a task is done: about two seconds, from the way to the thing to its end
DRAWN = 60  # demonstrations a panel
FINGERS, OPEN = 7, 0.02  # entry of an observation, and metres above which the hand is open
BLUE, ORANGE = COLOURS[:2]


def orders(rows: pd.DataFrame) -> Sequence[Order]:
    """Tasks in the order in which each episode did them."""
    return [tuple(map(int, str(tasks).split())) for tasks in rows["tasks"].fillna("")]


def transitions(done: Iterable[Order]) -> np.ndarray:
    """What follows what, (8, 7): the share of each task among those that came next after none yet, after task 0, ...

    Rows after which nothing came are NaN.
    """
    counts = np.zeros((len(TASKS) + 1, len(TASKS)))
    for order in done:
        for before, after in itertools.pairwise((-1, *order)):
            counts[before + 1, after] += 1
    totals = counts.sum(axis=1, keepdims=True)
    return np.divide(counts, totals, out=np.full_like(counts, np.nan), where=totals > 0)


def order_matrices(demonstrated: Sequence[Order], episodes: Episodes) -> Figure:
    """Which task follows which: the demonstrations and every method, a panel each."""
    shown = {"demonstrations": demonstrated} | {method: orders(rows) for method, rows in episodes.items()}
    figure, grid = panels(len(shown), 0.5, 1.6)
    letters = [task.letter for task in TASKS]
    image = None
    for axis, (title, done) in zip(grid, shown.items(), strict=False):
        image = axis.imshow(transitions(done), vmin=0, vmax=1, cmap="Blues", aspect="equal")
        axis.set_title(textwrap.fill(title, 14))
        axis.set_xticks(range(len(letters)), letters)
        axis.set_yticks(range(len(letters) + 1), ["start", *letters])
        axis.spines[:].set_visible(True)
    figure.supxlabel("next task")
    figure.supylabel("task before")
    assert image is not None
    figure.colorbar(image, ax=grid, label="share", fraction=0.02)
    return figure


def completed_shares(rows: pd.DataFrame, most: int) -> list[float]:
    """Shares of episodes that did at least 1, 2, ... `most` of their goal's tasks."""
    return [float((rows["result"] >= n).mean()) for n in range(1, most + 1)]


def completion(episodes: Episodes, most: int) -> Figure:
    """Bars: shares of episodes that did at least 1, 2, ... `most` of their goal's tasks, by method."""
    figure = Figure(figsize=(7, 2.2), layout="constrained")
    axis = figure.subplots()
    shades = np.linspace(0.35, 1.0, most)
    shares = [completed_shares(rows, most) for rows in episodes.values()]
    for n in range(most):
        heights = [of_method[n] for of_method in shares]
        places = np.arange(len(episodes)) + (n - (most - 1) / 2) * 0.8 / most
        axis.bar(places, heights, 0.8 / most, color=BLUE, alpha=shades[n], label=f"at least {n + 1}")
    axis.set_xticks(range(len(episodes)), list(episodes), rotation=30, ha="right")
    axis.set(ylabel="share of episodes", ylim=(0, 1))
    figure.legend(loc="outside right upper", frameon=False, title="goal's tasks done")
    return figure


def approaches(dataset: PlayDataset, task: int) -> list[dict[str, Any]]:
    """The hand on its way to a task, in up to DRAWN demonstrations, the first that have the time for it.

    Returns:
        JSON values: "right" and "up", its places in the APPROACH steps up to the first in which the task is done,
        millimetres, and whether it was "open" then.
    """
    ends = np.flatnonzero(dataset.tasks[:, task])
    starts = np.array([0, *dataset.episode_ends[:-1]])[np.searchsorted(dataset.episode_ends, ends, side="right")]
    ends = ends[ends - starts >= APPROACH - 1][:DRAWN]
    steps = ends[:, None] + np.arange(1 - APPROACH, 1)
    kitchen = KitchenEnv()
    hand = kitchen.model.site("end_effector").id
    places = np.empty((*steps.shape, 3))
    for where in np.ndindex(steps.shape):
        kitchen.data.qpos[:] = dataset.observations[steps[where]]
        mujoco.mj_kinematics(kitchen.model, kitchen.data)
        places[where] = kitchen.data.site_xpos[hand]
    right, up = np.round(1000 * places[..., [0, 2]]).astype(int).transpose(2, 0, 1).tolist()
    opened = (dataset.observations[ends, FINGERS] > OPEN).tolist()
    return [{"right": r, "up": u, "open": o} for r, u, o in zip(right, up, opened, strict=True)]


def variety(demonstrated: Sequence[Order], paths: Sequence[list[dict[str, Any]]]) -> Figure:
    """The hand's paths to each task as seen from the front, and how many demonstrations did which set of tasks."""
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    grid = figure.subplots(2, 4).flatten()
    for axis, task, of_task in zip(grid, TASKS, paths, strict=False):
        for path in of_task:
            right, up = np.array(path["right"]) / 1000, np.array(path["up"]) / 1000
            axis.plot(right, up, color=BLUE if path["open"] else ORANGE, linewidth=0.5, alpha=0.6)
        axis.set_title(f"{task.name} ({task.letter})")
        axis.tick_params(labelsize=6)
    sets = pd.Series(["".join(TASKS[t].letter for t in sorted(order)) for order in demonstrated])
    counts = sets.value_counts(sort=False).sort_index()
    grid[-1].bar(range(len(counts)), counts, color="#888888")
    grid[-1].set_title("sets of tasks")
    grid[-1].set_xticks([])
    grid[-1].set_xlabel(f"{len(counts)} sets", fontsize=7)
    grid[-1].tick_params(labelsize=6)
    figure.supxlabel("right (m)")
    figure.supylabel("up (m)")
    return figure
