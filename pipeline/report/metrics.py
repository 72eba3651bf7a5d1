"""reports/metrics.json: what `dvc metrics show` and `dvc metrics diff` print."""

from typing import Any

from beso import envs
from pipeline.params import Params
from pipeline.report.comparison import read_episodes
from pipeline.report.statistics import over_seeds


def metrics(params: Params) -> dict[str, dict[str, Any]]:
    """By environment, method and goal set: every metric's mean and standard deviation over seeds, and mean length."""
    return {env: {method: _cell(env, method) for method in params.methods_in(env)} for env in params.envs}


def _cell(environment: str, method: str) -> dict[str, dict[str, float]]:
    found: dict[str, dict[str, float]] = {}
    rows = read_episodes(environment, method)
    several = rows["seed"].nunique() > 1
    for goals, part in rows.groupby("goals", sort=False):
        values = found.setdefault(f"{goals}_goals", {})
        for metric in envs.report(environment).METRICS:
            estimate = over_seeds(part, metric)
            values[metric.name] = round(estimate.mean, 4)
            if several:
                values[f"{metric.name}_std"] = round(estimate.deviation, 4)
        values["length"] = round(float(part["length"].mean()), 1)
    return found
