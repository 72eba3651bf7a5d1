"""Start, goal and end of an episode of each single task: kept by evaluation, shown by the report."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from beso.envs.protocol import Outcome
from pipeline import profile, rollouts
from pipeline.machine import Machine
from pipeline.report import figures
from stages import evaluate
from stages.evaluate import evaluate_cell

SIZE = 8


def colour(seed, goals, episode, part):
    """A picture that says of which episode it is, and whether start, goal or end."""
    return np.full((SIZE, SIZE, 3), 60 * seed + 30 * (goals == "two_tasks") + 10 * part + episode, dtype=np.uint8)


def played(job, chunks, film=None, witness=None):
    """What beso.evaluation.rollout.evaluate answers, without a policy and a simulator; the second episode succeeds."""
    rows = []
    for chunk in chunks:
        rows.append([])
        for i in range(chunk.first, chunk.last):
            row = {"seed": job.seed, "goals": chunk.goals, "episode": i, "success": int(i == 1), "length": 9}
            start, goal, end = (colour(job.seed, chunk.goals, i, part) for part in range(3))
            rows[-1].append(row)
            witness(row, Outcome(0.0, 9, end, {}, goal[None], start))
    return rows


@pytest.fixture
def smoke(monkeypatch, tmp_path):
    """Two models of two methods in CALVIN, five episodes with three tasks in chunks of two, in an empty folder."""
    smoke = profile.load("smoke")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(rollouts, "evaluate", played)
    monkeypatch.setattr(evaluate, "write_film", lambda *arguments: None)
    room = smoke.environments["calvin"]
    config = dataclasses.replace(room.evaluation, rollouts=5, chunk=2, tasks=room.evaluation.tasks[:3])
    room = dataclasses.replace(room, seeds=(1, 2), evaluation=config)
    cells = {}
    for cell in smoke.cells_in("calvin"):
        film = cell.method in ("gcbc", "c_beso")
        recipe = dataclasses.replace(cell.evaluate, seeds=(1, 2), evaluation=config, film=film)
        cells[cell.name] = dataclasses.replace(cell, evaluate=recipe)
    return dataclasses.replace(smoke, environments={"calvin": room}, cells=cells, studies={})


def play(cell, **changes):
    evaluate_cell(dataclasses.replace(cell.evaluate, **changes), Machine(workers=1))
    return np.load(cell.scenes)


def test_an_episode_of_each_single_task_is_kept(smoke):
    scenes = play(smoke.cell("calvin", "gcbc"))
    assert scenes.shape == (3, 3, SIZE, SIZE, 3)
    expected = [[colour(1, "single_tasks", i, part) for part in range(3)] for i in range(3)]
    assert np.array_equal(scenes, expected), "of the first seed and goal set, start, goal and end"


def test_without_a_list_of_tasks_none_is_kept(smoke):
    cell = smoke.cell("calvin", "gcbc")
    assert len(play(cell, evaluation=dataclasses.replace(cell.evaluate.evaluation, tasks=None))) == 0


def draw(smoke):
    cells = [cell for cell in smoke.cells.values() if cell.evaluate.film]
    episodes = {smoke.labels[cell.method]: pd.read_csv(cell.episodes) for cell in cells}
    return figures.goals(smoke, "calvin", episodes, Path())


def test_goals_stand_beside_what_the_filmed_methods_left(smoke, tmp_path):
    for method in ("gcbc", "c_beso"):
        play(smoke.cell("calvin", method))
    drawing = draw(smoke)
    assert drawing.name == "goals_calvin"
    assert "GCBC, C-BESO (model seed 1)" in drawing.caption
    axes = drawing.figure.axes
    assert len(axes) == 3 * 4
    assert [axis.get_title() for axis in axes[:4]] == ["start", "goal", "GCBC", "C-BESO"]
    assert [axis.get_ylabel().split() for axis in axes[::4]] == [
        ["open", "drawer"],
        ["close", "drawer"],
        ["move", "slider", "left"],
    ]
    shown = [[int(axis.images[0].get_array()[0, 0, 0]) for axis in axes[4 * i : 4 * i + 4]] for i in range(3)]
    assert shown == [[60 + i, 70 + i, 80 + i, 80 + i] for i in range(3)]
    assert [axis.get_xlabel() for axis in axes[2::4]] == [f"success {n}, 9 actions" for n in (0, 1, 0)]
    assert [axis.spines["top"].get_visible() for axis in axes[2::4]] == [False, True, False]
    for name in ("one", "two"):
        figures.save(draw(smoke).figure, tmp_path, name)
    for kind in ("png", "pdf"):
        assert (tmp_path / f"one.{kind}").read_bytes() == (tmp_path / f"two.{kind}").read_bytes()


def test_where_nothing_is_filmed_there_is_no_figure(smoke):
    unfilmed = {
        name: dataclasses.replace(cell, evaluate=dataclasses.replace(cell.evaluate, film=False))
        for name, cell in smoke.cells.items()
    }
    assert draw(dataclasses.replace(smoke, cells=unfilmed)) is None


def test_an_evaluation_that_lacks_episodes_writes_nothing(smoke, monkeypatch):
    cell = smoke.cells["calvin-gcbc"]
    monkeypatch.setattr(rollouts, "evaluate", lambda *arguments, **named: played(*arguments, **named)[:-1])
    with pytest.raises(RuntimeError, match=r"evaluate calvin gcbc: \d+ of 20 episodes were played"):
        play(cell)
    assert not cell.episodes.exists()
