import math

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from beso.envs.protocol import Metric
from pipeline.report.statistics import Estimate, difference, of_difference, of_normal, over_seeds

RESULT = Metric("result", "Result", 1.0)


def rows(scores, goals="training"):
    """Evaluation rows from scores (seeds, episodes)."""
    scores = np.asarray(scores, dtype=float)
    seeds, episodes = scores.shape
    return pd.DataFrame(
        {
            "seed": np.repeat(np.arange(seeds), episodes),
            "goals": goals,
            "episode": np.tile(np.arange(episodes), seeds),
            "result": scores.ravel(),
        }
    )


def successes(rng, seeds, episodes, rate, spread):
    rates = np.clip(rng.normal(rate, spread, seeds), 0, 1)
    return rows(rng.random((seeds, episodes)) < rates[:, None])


def test_mean_and_deviation_are_over_seeds():
    estimate = over_seeds(rows([[0.2] * 50, [0.5] * 50, [0.8] * 50]), RESULT)
    assert estimate.mean == pytest.approx(0.5)
    assert estimate.deviation == pytest.approx(0.3)


def test_seeds_may_have_played_different_numbers_of_episodes():
    both = pd.concat([rows([[0.0] * 10]), rows([[1.0] * 40]).assign(seed=1)])
    estimate = over_seeds(both, RESULT)
    assert estimate.mean == 0.5
    assert (estimate.low, estimate.high) == (0.0, 1.0)


@pytest.mark.parametrize(
    ("seeds", "episodes", "rate", "spread"), [(1, 100, 0.9, 0.0), (3, 100, 0.8, 0.05), (10, 100, 0.9, 0.03)]
)
def test_the_interval_holds_the_true_mean_about_as_often_as_it_says(seeds, episodes, rate, spread):
    rng, held, width = np.random.default_rng(0), 0, 0.0
    for _ in range(100):
        estimate = over_seeds(successes(rng, seeds, episodes, rate, spread), RESULT)
        held += estimate.low <= rate <= estimate.high
        width += (estimate.high - estimate.low) / 100
    assert held >= 91  # 95 expected; fewer than 91 of 100 happens in one of 30
    variance = spread**2 / seeds + rate * (1 - rate) / (seeds * episodes)
    factor = stats.t.ppf(0.975, seeds - 1) if seeds > 1 else 1.96
    assert width < 1.3 * 2 * factor * math.sqrt(variance), "no wider than needed"


def test_zeros_alone_do_not_prove_a_zero():
    estimate = over_seeds(rows([[0.0] * 20]), RESULT)
    assert (estimate.mean, estimate.low) == (0.0, 0.0)
    assert estimate.high == pytest.approx(3 / 20, abs=0.03)  # the rule of three
    assert math.isnan(estimate.deviation)
    of_four = over_seeds(rows([[0.0] * 20]), Metric("result", "Result", 4.0))
    assert of_four.high == pytest.approx(4 * estimate.high)


def test_scores_may_exceed_the_maximum():
    estimate = over_seeds(rows([[4.0, 5.0] * 20]), Metric("result", "Result", 4.0))
    assert estimate.low < estimate.mean == 4.5 < estimate.high


def test_seeds_that_agree_by_chance_keep_the_width_of_their_episodes():
    agreeing = over_seeds(rows([[0.0, 1.0] * 50] * 10), RESULT)
    assert agreeing.deviation == 0
    assert agreeing.high - agreeing.low > 2 * 1.96 * 0.5 / math.sqrt(1000)


def test_the_same_rows_give_the_same_interval():
    scores = successes(np.random.default_rng(0), 3, 20, 0.5, 0.1)
    assert over_seeds(scores, RESULT) == over_seeds(scores.copy(), RESULT)


def test_differences_are_of_the_same_episodes():
    rng = np.random.default_rng(0)
    first = successes(rng, 3, 50, 0.5, 0.2)
    better = first.assign(result=np.where(rng.random(len(first)) < 0.2, 1.0, first["result"]))
    change = difference(better.sample(frac=1, random_state=0), first, RESULT)
    assert change.mean == pytest.approx((better["result"] - first["result"]).mean())
    alone = [over_seeds(part, RESULT) for part in (first, better)]
    assert change.high - change.low < 0.5 * (alone[0].high - alone[0].low), "seeds differ, their differences do not"
    assert difference(first, first, RESULT).mean == 0
    assert difference(first, first.assign(goals="held_out"), RESULT) is None


def test_of_a_mean_and_a_deviation():
    paper = of_normal(0.9, 0.04, 10)
    assert paper.high - paper.mean == pytest.approx(stats.t.ppf(0.975, 9) * 0.04 / math.sqrt(10))
    low, high = of_difference(Estimate(0.5, 0.1, 0.4, 0.7), Estimate(0.3, 0.1, 0.3, 0.3))
    assert (low, high) == pytest.approx((0.1, 0.4))
    low, high = of_difference(Estimate(0.0, 0.1, -3.0, 3.0), Estimate(0.0, 0.1, -4.0, 4.0))
    assert (low, high) == pytest.approx((-5.0, 5.0))
