import pytest

from pipeline import profile
from pipeline.report import hyperparameters


@pytest.mark.parametrize(("name", "less"), [("paper", False), ("gpu", False), ("cpu", True), ("quick", True)])
def test_the_report_says_which_profiles_train_less_than_the_paper(name, less):
    assert hyperparameters.trains_less(profile.load(name)) == less
