import math
import re
from pathlib import Path

import pandas as pd
import pytest

from pipeline.comparison import paper_numbers, verdict
from pipeline.statistics import over_seeds

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
    rows = pd.DataFrame({"seed": [1, 1, 2, 2, 3, 3], "result": [0.0, 1.0, 1.0, 1.0, 0.0, 0.0]})
    mean, std, error = over_seeds(rows, "result")
    assert mean == pytest.approx(0.5)
    assert std == pytest.approx(0.5)  # of 0.5, 1, 0
    assert error == pytest.approx(0.5 / math.sqrt(3))


def test_a_single_seed_has_the_error_of_its_episodes():
    rows = pd.DataFrame({"seed": [1] * 4, "result": [0.0, 1.0, 1.0, 0.0]})
    mean, std, error = over_seeds(rows, "result")
    assert (mean, std) == (0.5, 0.0)
    assert error == pytest.approx(math.sqrt(1 / 3) / 2)
    assert math.isnan(over_seeds(rows[:1], "result")[2])


@pytest.mark.parametrize(
    ("difference", "error", "expected"),
    [
        (-0.3, 0.1, "worse"),
        (0.3, 0.1, "better"),
        (0.01, 0.02, "same"),
        (0.01, 0.1, "cannot tell"),
        (0.5, math.nan, "cannot tell"),
    ],
)
def test_verdicts(difference, error, expected):
    assert verdict(difference, error, maximum=1.0) == expected
