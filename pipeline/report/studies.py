"""Tables of the studies: a row a sampling."""

from typing import Any

from beso import envs
from pipeline import paths
from pipeline.params import Params
from pipeline.report.comparison import read_rows
from pipeline.report.statistics import over_seeds


def tables(params: Params) -> list[dict[str, Any]]:
    """One table for each study: its name, cell, columns, and rows of what varies and a (mean, std) a metric.

    Scores are over the first goal set, the paper's.
    """
    found = []
    for name, study in params.studies.items():
        rows = read_rows(paths.study(name), f"study@{name}")
        rows = rows[rows["goals"] == params.environments[study.env].evaluation.goals[0]]
        metrics = envs.report(study.env).METRICS
        cells = []
        for changes, _ in params.samplings(name):
            part = rows
            for key, value in changes.items():
                part = part[part[key] == value] if value is not None else part[part[key].isna()]
            scores = [over_seeds(part, metric) for metric in metrics]
            cells.append((list(changes.values()), [(score.mean, score.deviation) for score in scores]))
        found.append({"name": name, "study": study, "varied": list(study.vary), "metrics": metrics, "rows": cells})
    return found
