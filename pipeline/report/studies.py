"""Tables of the studies: a row a sampling, with its difference to the first one."""

from pathlib import Path
from typing import Any, NamedTuple

from beso import envs
from beso.envs.protocol import Metric
from pipeline.params import Params
from pipeline.report.comparison import read_study, rows_of, verdict
from pipeline.report.names import Names, value, words
from pipeline.report.statistics import Estimate, difference, over_seeds


class Score(NamedTuple):
    """One metric of one sampling.

    Attributes:
        estimate: the score.
        difference: to the first sampling's, over the same episodes; None for the first.
        verdict: on this difference (see pipeline.report.comparison.verdict); empty for the first.
    """

    estimate: Estimate
    difference: Estimate | None
    verdict: str


class Row(NamedTuple):
    """One sampling: what was changed, the same as text, and a score a metric."""

    changes: dict[str, Any]
    labels: list[str]
    scores: list[Score]


class Table(NamedTuple):
    """One study: its name and title, its environment, what varies, its metrics, a row a sampling."""

    name: str
    title: str
    environment: str
    varied: list[str]
    metrics: tuple[Metric, ...]
    rows: list[Row]


def tables(params: Params, root: Path = Path()) -> list[Table]:
    """One table for each study in a run's folder. Scores are over the first goal set, the paper's."""
    found, names = [], Names(params)
    for name, study in params.studies.items():
        episodes = read_study(root, name)
        episodes = episodes[episodes["goals"] == params.environments[study.env].evaluation.goals[0]]
        metrics = envs.report(study.env).METRICS
        parts = [(changes, rows_of(episodes, changes)) for changes, _ in params.samplings(name)]
        rows = [
            Row(changes, [value(v) for v in changes.values()], [_score(part, parts[0][1], m) for m in metrics])
            for changes, part in parts
        ]
        varied = [words(key) for key in study.vary]
        found.append(Table(name, names.study(name, study), study.env, varied, metrics, rows))
    return found


def _score(rows: Any, first: Any, metric: Metric) -> Score:
    estimate = over_seeds(rows, metric)
    if rows is first:
        return Score(estimate, None, "")
    change = difference(rows, first, metric)
    return Score(estimate, change, verdict(change.low, change.high, metric.maximum) if change else "")
