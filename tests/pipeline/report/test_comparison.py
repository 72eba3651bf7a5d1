import pytest

from pipeline.report.comparison import verdict
from pipeline.report.tables import number, significant


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
