from dataclasses import replace

import pandas as pd
import pytest

from pipeline import profile
from pipeline.report.comparison import verdict
from pipeline.report.tables import main_methods, main_rows, number, significant


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (-0.5, -0.1, "worse"),
        (0.1, 0.5, "better"),
        (0.001, 0.002, "better"),
        (-0.02, 0.04, "same"),
        (-0.05, 0.05, "same"),
        (-0.01, 0.07, "cannot tell"),
        (-0.19, 0.21, "cannot tell"),
    ],
)
def test_verdicts(low, high, expected):
    assert verdict(low, high, maximum=1.0) == expected


def test_small_is_a_share_of_the_largest_value():
    assert verdict(-0.1, 0.15, maximum=4.0) == "same"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (116_793, "116,793"),
        (1000.0, "1,000"),
        (0, "0"),
        (12_345.678, "12,346"),
        (116.793, "116.8"),
        (15.4, "15.4"),
        (0.018_990_1, "0.01899"),
        (0.305, "0.305"),
        (-0.000_123_456, "-0.0001235"),
        (float("nan"), "--"),
        (None, "--"),
    ],
)
def test_quantities_have_significant_digits(value, text):
    assert significant(value) == text


def test_scores_have_decimals_and_no_minus_before_a_zero():
    assert [number(x) for x in (0.5, -0.004, -0.006, 10.0, None)] == ["0.50", "0.00", "-0.01", "10.00", "--"]


def test_the_main_table_has_the_papers_number_beside_a_cell_that_was_not_run():
    params = profile.load("smoke")
    kept = ("block_push-gcbc", "block_push-c_beso", "kitchen-lmp", "kitchen-c_beso")
    params = replace(params, cells={name: params.cells[name] for name in kept}, studies={})
    columns = ["environment", "metric", "method", "study", "goals", "ours", "ours_std", "paper", "paper_std"]
    comparison = pd.DataFrame(
        [
            ("block_push", "result", "gcbc", None, "training", 0.25, None, 0.13, 0.04),
            ("block_push", "result", "lmp", None, "training", None, None, 0.04, 0.02),
            ("block_push", "result", "c_beso", "steps_block_push", "training", 0.75, None, 0.9, 0.02),
        ],
        columns=columns,
    )
    assert main_methods(params) == ["gcbc", "lmp", "c_beso"], "in the parameters' order"
    rows = main_rows(params, comparison)
    (ours, theirs) = [
        [mean for mean, _ in row["cells"]]
        for row in rows
        if (row["environment"], row["metric"]) == ("Block-Push", "Result") and "held" not in row["whose"]
    ]
    assert [number(x) for x in ours] == ["0.25", "--", "--"]
    assert [number(x) for x in theirs] == ["0.13", "0.04", "0.90"], "of a study where it has none of the cell"
