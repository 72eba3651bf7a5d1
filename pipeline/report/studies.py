"""Tables of the studies, a row a sampling, and of students and teachers: each with its difference to the first row."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import pandas as pd

from beso import envs
from beso.envs.protocol import Metric
from pipeline.params import Cell, Params
from pipeline.report.comparison import rows_of, verdict
from pipeline.report.names import value, words
from pipeline.report.statistics import Estimate, difference, over_seeds


class Column(NamedTuple):
    """What a study scores: a metric, over one goal set, which the label names where the study has several."""

    label: str
    metric: Metric
    goals: str


class Score(NamedTuple):
    """One column's score of one sampling.

    Attributes:
        estimate: the score.
        difference: to the first sampling's, over the same episodes; None for the first.
        verdict: on this difference (see pipeline.report.comparison.verdict); empty for the first.
    """

    estimate: Estimate
    difference: Estimate | None
    verdict: str


class Row(NamedTuple):
    """One sampling: as text, what was changed; how often an action calls the network if counted; scores."""

    labels: list[str]
    calls: int | None
    scores: list[Score]


class Table(NamedTuple):
    """One study: its name and title, what varies, what it scores, its rows."""

    name: str
    title: str
    varied: list[str]
    columns: list[Column]
    rows: list[Row]


def tables(params: Params, rows: dict[str, pd.DataFrame]) -> dict[str, Table]:
    """One table for each study, by its name, from the studies' rows."""
    found = {}
    for name, study in params.studies.items():
        env, method = study.env, params.labels[study.method]
        title = f"{words(name.removesuffix(f'_{env}'))}: {method} in {envs.report(env).LABEL}"
        parts = [([value(v) for v in changes.values()], rows_of(rows[name], changes)) for changes in study.changes]
        varied = [words(key) for key in study.varied]
        found[name] = _table(name, title, varied, env, study.evaluation.goals, parts)
    return found


def students(params: Params, episodes: dict[str, pd.DataFrame]) -> list[Table]:
    """One table for each teacher, from the cells' rows: itself, then the policies that learned from it."""
    taught: dict[str, list[Cell]] = {}
    for cell in params.cells.values():
        if teacher := params.cells.get(f"{cell.env}-{cell.train.teacher}"):  # an archive may lack it
            taught.setdefault(teacher.name, [teacher]).append(cell)
    found = []
    for policies in taught.values():
        teacher = policies[0]
        title = f"{params.labels[teacher.method]} and its students in {envs.report(teacher.env).LABEL}"
        parts = [([params.labels[policy.method]], episodes[policy.name]) for policy in policies]
        goals = teacher.evaluate.evaluation.goals[:1]
        found.append(_table(f"students_{teacher.env}_{teacher.method}", title, ["Policy"], teacher.env, goals, parts))
    return found


def _table(
    name: str,
    title: str,
    varied: list[str],
    env: str,
    goal_sets: Sequence[str],
    parts: list[tuple[list[str], pd.DataFrame]],
) -> Table:
    room = envs.report(env)
    columns = [
        Column(metric.label + (f", {room.GOAL_LABELS[goals]}" if len(goal_sets) > 1 else ""), metric, goals)
        for goals in goal_sets
        for metric in room.METRICS
    ]
    rows = [
        Row(
            labels,
            int(part["calls"].iloc[0]) if "calls" in part else None,
            [_score(part, parts[0][1], column) for column in columns],
        )
        for labels, part in parts
    ]
    return Table(name, title, varied, columns, rows)


def _score(rows: Any, first: Any, column: Column) -> Score:
    same, (rows, first) = rows is first, (part[part["goals"] == column.goals] for part in (rows, first))
    change = None if same else difference(rows, first, column.metric)
    told = verdict(change.low, change.high, column.metric.maximum) if change else ""
    return Score(over_seeds(rows, column.metric), change, told)
