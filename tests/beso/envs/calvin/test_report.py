import dataclasses

import numpy as np
import pandas as pd
import pytest

from beso.data.play import PlayDataset
from beso.envs.calvin import drawings, report
from beso.envs.calvin.spec import SPEC

OPEN, CLOSE, LED = (SPEC.tasks.index(name) for name in ("open_drawer", "close_drawer", "turn_on_led"))


@pytest.fixture
def rows():
    """Two seeds; `open drawer` was tried more often, so that the mean over tasks is not that over episodes."""
    single = [
        *((1, "single_tasks", str(OPEN), 1, 1), (1, "single_tasks", str(OPEN), 1, 1)),
        *((1, "single_tasks", str(CLOSE), 0, 0), (2, "single_tasks", str(OPEN), 0, 0)),
        (2, "single_tasks", str(CLOSE), 0, 0),
    ]
    pairs = [
        *((1, "two_tasks", f"{OPEN} {LED}", 1, 2), (1, "two_tasks", f"{OPEN} {LED}", 0, 2)),
        *((1, "two_tasks", f"{OPEN} {LED}", 0, 1), (1, "two_tasks", f"{OPEN} {LED}", 0, 0)),
        (2, "two_tasks", f"{OPEN} {LED}", 1, 2),
    ]
    return pd.DataFrame([*single, *pairs], columns=["seed", "goals", "goal_tasks", "success", "completed"])


def test_tasks_count_alike(rows):
    table = drawings.by_task(rows)
    assert list(table.columns) == ["open drawer", "close drawer", "mean"]
    assert table.loc[1].tolist() == [1, 0, 0.5]
    assert table.loc[2].tolist() == [0, 0, 0]


def test_pairs_are_counted_as_in_the_papers_figure(rows):
    table = drawings.in_short(rows)
    assert table.loc[1].tolist() == [0.5, 0.75, 0.25, 5 / 8]
    assert table.loc[2].tolist() == [0, 1, 1, 1]


def test_numbers_are_read_as_numbers_where_there_are_no_pairs(rows):
    single = rows[rows["goals"] == "single_tasks"].astype({"goal_tasks": int})
    assert drawings.by_task(single).equals(drawings.by_task(rows))
    assert drawings.in_short(single).iloc[:, 1:].isna().all(axis=None)


def test_bars_show_means_over_seeds(rows):
    figure = drawings.bars({"A": drawings.by_task(rows), "B": drawings.by_task(rows)}, "success")
    (axis,) = figure.axes
    assert [label.get_text() for label in axis.get_xticklabels()] == ["open drawer", "close drawer", "mean"]
    assert [bar.get_height() for bar in axis.patches] == [0.5, 0, 0.25] * 2


def test_statistics_of_play():
    tasks = np.zeros((30 * 60, 34), dtype=np.uint8)
    tasks[[5, 100, 200], OPEN] = tasks[50, LED] = 1
    dataset = PlayDataset(np.zeros((1800, 512)), np.zeros((1800, 7)), tasks, np.array([600, 1800]), {})
    found = report.statistics(dataset)
    assert found["hours of play"] == pytest.approx(1 / 60)
    assert found["tasks done a minute"] == pytest.approx(4)
    assert found["share of tasks: open drawer"] == 0.75
    assert sum(value for name, value in found.items() if name.startswith("share")) == pytest.approx(1)
    assert set(report.PUBLISHED) <= set(found)
    assert drawings.play(report.summary(dataset)["shares"]).axes[0].patches[OPEN].get_height() == 0.75


def test_of_unlabelled_play_it_is_not_told_what_is_done():
    tasks = np.zeros((1800, 34), dtype=np.uint8)
    dataset = PlayDataset(np.zeros((1800, 512)), np.zeros((1800, 7)), tasks, np.array([1800]), {"labelled": False})
    found = report.statistics(dataset)
    assert found["hours of play"] == pytest.approx(1 / 60)
    assert not [name for name in found if "task" in name]
    assert report.summary(dataset)["shares"] == {}


def test_figures_and_tables_have_every_method(rows):
    tasks = np.zeros((40, 34), dtype=np.uint8)
    dataset = PlayDataset(np.zeros((40, 512)), np.zeros((40, 7)), tasks, np.array([20, 40]), {})
    single = rows[rows["goals"] == "single_tasks"]
    episodes = {"A": rows, "B": single}
    summary, tasks = report.tables(episodes)
    assert summary.columns == ("Method", *drawings.COLUMNS)
    assert summary.rows[0] == ("A", 0.25, 0.875, 0.625, 0.8125)
    assert summary.rows[1][:2] == ("B", 0.25)
    assert np.isnan(summary.rows[1][2:]).all()
    assert tasks.columns == ("Task", "A", "B")
    assert tasks.rows == [("open drawer", 0.5, 0.5), ("close drawer", 0, 0), ("mean", 0.25, 0.25)]
    assert tuple(report.GOAL_LABELS) == SPEC.goal_sets
    drawn = report.drawings(report.summary(dataset), episodes)
    assert "in each of 2 single tasks" in drawn[1].caption, "as many as there were"
    assert len({drawing.name for drawing in drawn}) == len(drawn)
    unlabelled = report.summary(dataclasses.replace(dataset, meta={"labelled": False}))
    assert [drawing.name for drawing in report.drawings(unlabelled, episodes)] == [d.name for d in drawn[:-1]]
    assert drawn[0].figure.axes[0].get_legend_handles_labels()[1] == ["A", "B"]
