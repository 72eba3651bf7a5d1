"""Means, deviations and errors of evaluation rows."""

import math

import pandas as pd


def over_seeds(rows: pd.DataFrame, value: str) -> tuple[float, float, float]:
    """Mean, standard deviation and standard error of a column of rows with a `seed` column.

    Mean and deviation are over the seeds' means, as the paper has them (the deviation with n - 1; 0 for a single seed).
    The standard error is the deviation over sqrt(seeds); a single seed's is that of its episodes.
    """
    means = rows.groupby("seed")[value].mean()
    if len(means) > 1:
        deviation = float(means.std())
        return float(means.mean()), deviation, deviation / math.sqrt(len(means))
    episodes = rows[value]
    error = float(episodes.std()) / math.sqrt(len(episodes)) if len(episodes) > 1 else math.nan
    return float(means.mean()), 0.0, error
