import math
import re
from pathlib import Path

import pandas as pd
import pytest

from beso.envs.protocol import Metric
from pipeline.report.comparison import paper_numbers, verdict
from pipeline.report.statistics import over_seeds

RESULT = Metric("result", "Result", 1.0)

COLUMNS = ["gcbc", "c_ibc", "lmp", "ril", "c_bet", "cx_diff", "c_beso", "cfg_beso"]
NUMBER = re.compile(r"(\d\.\d+)\}*\s*\(\$\\pm\$ (\d\.\d+)\)")


def test_paper_numbers_are_those_of_the_papers_table():
    source = (Path(__file__).with_name("paper_table_1.tex")).read_text()
    environments = {"Block-Push": "block_push", "Relay-Kitchen": "kitchen"}
    environment, found = "", {}
    for line in source.split(r"\\"):
        environment = next((value for key, value in environments.items() if key in line), environment)
        metric = re.search(r"Reward|Result", line)
        for method, (mean, std) in zip(COLUMNS, NUMBER.findall(line), strict=False):
            found[environment, metric[0].lower(), method] = float(mean), float(std)
    assert len(found) == 2 * 2 * 8
    label = re.search(r"\\label\{(.*?)\}", source)[1]
    numbers = paper_numbers()
    assert set(numbers["table"]) == {label}
    keys = zip(numbers["environment"], numbers["metric"], numbers["method"], strict=True)
    stored = dict(zip(keys, zip(numbers["mean"], numbers["std"], strict=True), strict=True))
    assert stored == found
    assert set(numbers["seeds"]) == {10}


def test_mean_and_deviation_are_over_seeds():
    rows = pd.DataFrame({"seed": [1] * 50 + [2] * 50 + [3] * 50, "result": [0.2] * 50 + [0.5] * 50 + [0.8] * 50})
    estimate = over_seeds(rows, RESULT)
    assert estimate.mean == pytest.approx(0.5)
    assert estimate.deviation == pytest.approx(0.3)
    assert estimate.error == pytest.approx(0.3 / math.sqrt(3))
    assert estimate.factor == pytest.approx(4.303, abs=1e-3)  # Student's t, 2 degrees of freedom


def test_seeds_that_agree_by_chance_keep_the_error_of_their_episodes():
    rows = pd.DataFrame({"seed": [1, 1, 2, 2], "result": [0.0] * 4})
    estimate = over_seeds(rows, RESULT)
    assert (estimate.mean, estimate.deviation) == (0.0, 0.0)
    assert estimate.error == pytest.approx(math.sqrt(5 / 36 / 6))  # variance 1/6 x 5/6 of five zeros and a one
    assert verdict(-0.13, estimate.factor * estimate.error, 1.0) == "cannot tell"


def test_pseudo_scores_reach_to_the_metrics_largest_value():
    rows = pd.DataFrame({"seed": [1, 1, 2, 2], "result": [0.0] * 4})
    of_one, of_four = (over_seeds(rows, Metric("result", "Result", maximum)).error for maximum in (1.0, 4.0))
    assert of_four == pytest.approx(4 * of_one)


def test_one_seed_has_no_deviation_and_the_errors_of_episodes_and_of_another_source():
    rows = pd.DataFrame({"seed": [1] * 98, "result": [0.0, 1.0] * 49})
    estimate = over_seeds(rows, RESULT, deviation_of_one=0.03)
    assert math.isnan(estimate.deviation)
    assert estimate.error == pytest.approx(math.hypot(0.05, 0.03))


@pytest.mark.parametrize(
    ("difference", "half_width", "expected"),
    [
        (-0.3, 0.2, "worse"),
        (0.3, 0.2, "better"),
        (0.01, 0.03, "same"),
        (0.01, 0.04, "same"),
        (0.03, 0.04, "cannot tell"),
        (0.01, 0.2, "cannot tell"),
    ],
)
def test_verdicts(difference, half_width, expected):
    assert verdict(difference, half_width, maximum=1.0) == expected
