"""Means, deviations and intervals of evaluation rows.

The 95 % intervals are bootstrap intervals over two levels: training runs (seeds) are drawn with replacement, and within
each drawn one its episodes. scipy.stats.bootstrap draws from one level only: from all episodes, as if those of one seed
were independent of each other, or from the seeds' means, of which there may be one. So the draws stand here, with what
makes them right for few seeds and episodes:

- The seeds' means already vary by their episodes' chance, which the second level adds again. They are shrunk towards
  their mean so that both levels together have the variance of the means (Davison & Hinkley 1997, section 3.8), or that
  of the episodes where this is larger: few seeds may agree by chance.
- For few seeds, Student's quantile takes the normal one's place (Hesterberg 2015). The interval of a single seed speaks
  of that trained model alone.
- Two episodes more are counted, one that scores the least and one the most (Agresti & Coull 1998 for proportions):
  twenty zeros do not prove a zero.
"""

import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from beso.core.seeding import generator
from beso.envs.protocol import Metric

DRAWS = 2000
NORMAL = 1.96
PAIRS = ["seed", "goals", "episode"]  # what two evaluations of the same starts share


class Estimate(NamedTuple):
    """A mean over seeds and how well it is known.

    Attributes:
        mean, deviation: over the seeds' means, as the paper has them (n - 1; NaN for one seed).
        low, high: the 95 % interval of the mean.
    """

    mean: float
    deviation: float
    low: float
    high: float


def over_seeds(rows: pd.DataFrame, metric: Metric) -> Estimate:
    """Estimate a metric, whose scores lie (almost all) between 0 and its maximum, of rows with a `seed` column."""
    return _estimate(rows, metric.name, 0.0, metric.maximum)


def difference(rows: pd.DataFrame, base: pd.DataFrame, metric: Metric) -> Estimate | None:
    """Estimate by how much a metric of `rows` exceeds that of `base`, episode by episode.

    Episodes are paired by seed, goals and episode number; None if no two fit.
    """
    keys = [*PAIRS, metric.name]
    pairs = rows[keys].merge(base[keys], on=PAIRS, suffixes=("", "_base"))
    if pairs.empty:
        return None
    pairs["difference"] = pairs[metric.name] - pairs[f"{metric.name}_base"]
    return _estimate(pairs, "difference", -metric.maximum, metric.maximum)


def of_normal(mean: float, deviation: float, count: int) -> Estimate:
    """The estimate that a mean, a standard deviation and a number of seeds give."""
    half = float(stats.t.ppf(0.975, count - 1)) * deviation / math.sqrt(count)
    return Estimate(mean, deviation, mean - half, mean + half)


def of_difference(ours: Estimate, theirs: Estimate) -> tuple[float, float]:
    """The 95 % interval of a difference of two independent means, from theirs (Zou & Donner 2008)."""
    middle = ours.mean - theirs.mean
    below = math.hypot(ours.mean - ours.low, theirs.high - theirs.mean)
    above = math.hypot(ours.high - ours.mean, theirs.mean - theirs.low)
    return middle - below, middle + above


def _estimate(rows: pd.DataFrame, column: str, least: float, most: float) -> Estimate:
    by_seed = [part.to_numpy(dtype=float) for _, part in rows.groupby("seed")[column]]
    # A score may exceed its usual maximum: of the kitchen's seven tasks, four are asked for.
    least, most = min(least, rows[column].min()), max(most, rows[column].max())
    means = np.array([values.mean() for values in by_seed])
    mean, count = float(means.mean()), len(means)
    drawn = np.percentile(_bootstrap(by_seed, means, least, most), [2.5, 97.5])
    stretch = float(stats.t.ppf(0.975, count - 1)) / NORMAL if count > 1 else 1.0
    low, high = (mean + stretch * (float(end) - mean) for end in drawn)
    deviation = float(means.std(ddof=1)) if count > 1 else math.nan
    return Estimate(mean, deviation, max(least, min(low, mean)), min(most, max(high, mean)))


def _bootstrap(by_seed: Sequence[np.ndarray], means: np.ndarray, least: float, most: float) -> np.ndarray:
    """(DRAWS,) means of drawn seeds' drawn episodes."""
    chosen, at, played = _draws(tuple(len(values) for values in by_seed))
    scores = np.concatenate([*by_seed, [least, most]])
    drawn = (scores[at] * played).sum(axis=2)  # (DRAWS, seeds)
    if len(means) > 1:
        by_episodes = np.mean([values.var() / len(values) for values in by_seed])
        between = max(0.0, means.var(ddof=1) - by_episodes)
        shrink = math.sqrt(between / means.var()) if between else 0.0
        drawn += ((shrink - 1) * (means - means.mean()))[chosen]
    return drawn.mean(axis=1)


@functools.lru_cache(maxsize=2)
def _draws(counts: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Always the same draws for the same numbers of episodes by seed.

    Returns:
        (DRAWS, seeds) drawn seeds; (DRAWS, seeds, episodes) places of their drawn episodes in a list of all, behind
        which the two episodes more stand; each place's weight, 0 where a seed played fewer episodes than another.
    """
    rng, seeds, episodes = generator(0, "bootstrap"), len(counts), np.array(counts)
    starts, longest = np.cumsum(episodes) - episodes, episodes.max()
    chosen = rng.integers(seeds, size=(DRAWS, seeds))
    count = episodes[chosen][..., None]
    place = rng.random((DRAWS, seeds, longest), dtype=np.float32) * (count + 2 / seeds)
    at = np.where(place < count, starts[chosen][..., None] + place.astype(np.int32), episodes.sum())
    at += place >= count + 1 / seeds
    return chosen, at.astype(np.int32), (np.arange(longest) < count) / count
