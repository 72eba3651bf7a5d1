"""Tables of the studies, a row a sampling, and of students and teachers: each with its difference to the first row."""

from pathlib import Path
from typing import Any, NamedTuple

from beso import envs
from beso.envs.protocol import Metric
from pipeline.params import Cell, Params
from pipeline.report.comparison import read_episodes, read_study, rows_of, verdict
from pipeline.report.names import Names, value, words
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
    """One sampling: what was changed, the same as text, how often an action calls the network if counted, scores."""

    changes: dict[str, Any]
    labels: list[str]
    calls: int | None
    scores: list[Score]


class Table(NamedTuple):
    """One study: its name and title, what its rows share, its environment, what varies, what it scores, its rows."""

    name: str
    title: str
    shared: str
    environment: str
    varied: list[str]
    columns: list[Column]
    rows: list[Row]


def tables(params: Params, root: Path = Path()) -> list[Table]:
    """One table for each study in a run's folder."""
    found, names = [], Names(params)
    for name, study in params.studies.items():
        episodes = read_study(root, study.recipe)
        env, sets = study.cell.env, study.recipe.evaluation.goals
        columns = [
            Column(_label(metric, goals, env, sets, names), metric, goals)
            for goals in sets
            for metric in envs.report(env).METRICS
        ]
        parts = [(changes, rows_of(episodes, changes)) for changes in study.recipe.changes]
        rows = [
            Row(
                changes,
                [value(v) for v in changes.values()],
                int(part["calls"].iloc[0]),
                [_score(part, parts[0][1], column) for column in columns],
            )
            for changes, part in parts
        ]
        varied = [words(key) for key in study.vary]
        shared = "models, starts and noise"
        found.append(Table(name, names.study(name, study.cell), shared, env, varied, columns, rows))
    return found


def students(params: Params, root: Path = Path()) -> list[Table]:
    """One table for each teacher: itself, then the policies that learned from it, over the first goal set."""
    names, taught = Names(params), dict[str, list[Cell]]()
    for cell in params.cells.values():
        teacher = params.cells.get(f"{cell.env}-{cell.train.teacher}")
        if teacher:  # an archive may lack it
            taught.setdefault(teacher.name, [teacher]).append(cell)
    found = []
    for teacher, *_ in taught.values():
        environment, policies = teacher.env, taught[teacher.name]
        goals = teacher.evaluate.evaluation.goals[0]
        columns = [Column(metric.label, metric, goals) for metric in envs.report(environment).METRICS]
        parts = [read_episodes(root, policy) for policy in policies]
        rows = [
            Row(
                {"policy": policy.method},
                [names.method(policy.method)],
                None,
                [_score(part, parts[0], c) for c in columns],
            )
            for policy, part in zip(policies, parts, strict=True)
        ]
        title = f"{names.method(teacher.method)} and its students in {names.environment(environment)}"
        name = f"students_{environment}_{teacher.method}"
        found.append(Table(name, title, "starts and noise", environment, ["Policy"], columns, rows))
    return found


def _label(metric: Metric, goals: str, environment: str, sets: tuple[str, ...], names: Names) -> str:
    return f"{metric.label}, {names.goals(environment, goals)}" if len(sets) > 1 else metric.label


def _score(rows: Any, first: Any, column: Column) -> Score:
    alone, of_first = rows is first, first[first["goals"] == column.goals]
    rows = rows[rows["goals"] == column.goals]
    estimate = over_seeds(rows, column.metric)
    if alone:
        return Score(estimate, None, "")
    change = difference(rows, of_first, column.metric)
    return Score(estimate, change, verdict(change.low, change.high, column.metric.maximum) if change else "")
