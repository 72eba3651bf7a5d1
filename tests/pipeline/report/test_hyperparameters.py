import pytest

from pipeline import profile
from pipeline.report import hyperparameters


@pytest.mark.parametrize(("name", "less"), [("paper", False), ("gpu", False), ("cpu", True), ("quick", True)])
def test_the_report_says_which_profiles_train_less_than_the_paper(name, less):
    assert any(table["share"] < 1 for table in hyperparameters.tables(profile.load(name))) == less


def test_what_two_parts_of_a_cell_call_alike_has_a_row_for_each():
    tables = {
        (table["method"], table["environment"]): table["rows"] for table in hyperparameters.tables(profile.load("cpu"))
    }
    student = {name: (ours, paper) for name, ours, paper in tables["C-BESO, two steps", "Block-Push"]}
    assert student["model: steps"] == ("2", "2")
    assert student["optimization: steps"] == ("3000", "10000")
    values = {name: ours for name, ours, _ in tables["C-BESO", "Block-Push"]}
    assert {"steps", "sampling: steps"} <= values.keys()
    assert values["sampling: context length"] == "all"
