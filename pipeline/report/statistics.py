"""Means, deviations and errors of evaluation rows."""

import math
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from beso.envs.protocol import Metric


class Estimate(NamedTuple):
    """A mean over seeds and how well it is known.

    Attributes:
        mean, deviation: over the seeds' means, as the paper has them (n - 1; NaN for one seed).
        error: standard error of the mean.
        factor: how many standard errors reach to the ends of a 95 % interval.
    """

    mean: float
    deviation: float
    error: float
    factor: float


def over_seeds(rows: pd.DataFrame, metric: Metric, deviation_of_one: float = 0.0) -> Estimate:
    """Estimate a metric of rows that have a `seed` column.

    The standard error is the larger of what the seeds show, deviation / sqrt(seeds) with Student's factor, and what the
    number of episodes allows: few seeds may agree by chance. One seed does not show how much seeds differ; then
    `deviation_of_one` stands for it.
    """
    means = rows.groupby("seed")[metric.name].mean()
    mean, count = float(means.mean()), len(means)
    by_episodes = episode_error(rows[metric.name], metric.maximum)
    if count == 1:
        return Estimate(mean, math.nan, math.hypot(by_episodes, deviation_of_one), 1.96)
    deviation = float(means.std())
    by_seeds, student = deviation / math.sqrt(count), float(stats.t.ppf(0.975, count - 1))
    if student * by_seeds > 1.96 * by_episodes:
        return Estimate(mean, deviation, by_seeds, student)
    return Estimate(mean, deviation, by_episodes, 1.96)


def episode_error(values: pd.Series, maximum: float) -> float:
    """Standard error of a mean of scores from 0 to `maximum`, never 0.

    One episode more with 0 and one with the maximum are counted (Agresti & Coull for proportions), so that a handful of
    equal scores does not look certain.
    """
    counted = np.concatenate([values.to_numpy(dtype=float), [0.0, maximum]])
    return float(counted.std() / math.sqrt(len(counted)))
