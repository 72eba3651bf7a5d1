"""reports/metrics.json: what `dvc metrics show` and `dvc metrics diff` print."""

import math
from typing import Any

from pipeline.report.comparison import of_cells


def metrics(values: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """By environment, method and goal set: every metric's mean and standard deviation over seeds, and mean length.

    Args:
        values: from pipeline.report.gather.gather.
    """
    found: dict[str, dict[str, Any]] = {}
    for row in of_cells(values["comparison"]).itertuples():
        rows = values["episodes"][row.environment][values["names"].methods[row.method]]
        length = rows.loc[rows["goals"] == row.goals, "length"].mean()
        cell = found.setdefault(row.environment, {}).setdefault(row.method, {})
        scores = cell.setdefault(f"{row.goals}_goals", {"length": round(float(length), 1)})
        scores[row.metric] = round(row.ours, 4)
        if not math.isnan(row.ours_std):
            scores[f"{row.metric}_std"] = round(row.ours_std, 4)
    return found
