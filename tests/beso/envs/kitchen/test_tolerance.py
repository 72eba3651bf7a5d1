import numpy as np
import pytest

from beso.core.seeding import generator
from beso.envs.kitchen.demonstrations import tolerance
from beso.envs.kitchen.demonstrations.skills import SKILLS
from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import HINGE_CABINET, MICROWAVE
from beso.errors import UserError

MODES = [(task, mode) for task, skill in SKILLS.items() for mode in skill.modes]


@pytest.fixture(scope="module")
def env():
    return KitchenEnv()


@pytest.mark.parametrize(("task", "mode"), MODES, ids=lambda value: str(value))
def test_every_mode_works_with_the_thing_two_centimetres_off(env, task, mode):
    """At least 90 % do (`python -m beso.envs.kitchen.demonstrations.tolerance`); of three, at least two."""
    assert tolerance.successes(env, task, mode, 0.02, 3) >= 2


def test_nothing_is_done_with_the_thing_far_off(env):
    assert tolerance.successes(env, MICROWAVE, "pull", 0.3, 2) == 0


def test_every_skill_but_two_has_at_least_two_ways():
    assert {task for task, skill in SKILLS.items() if len(skill.modes) < 2} == {MICROWAVE, HINGE_CABINET}


def test_the_table_has_a_line_for_every_mode(monkeypatch, capsys):
    monkeypatch.setattr(tolerance, "successes", lambda env, task, mode, mistake, trials: round(100 * mistake) + trials)
    tolerance.main(["5"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["0", "cm", "1", "cm", "2", "cm", "3", "cm"]
    assert len(lines) == 1 + len(MODES)
    assert lines[1].split() == ["microwave", "pull", "5", "6", "7", "8"]


@pytest.mark.parametrize("arguments", [["0"], ["-1"], ["many"], ["3", "4"]])
def test_what_is_no_number_of_trials_is_refused(arguments):
    with pytest.raises(UserError, match="is not a number of trials"):
        tolerance.main(arguments)


def test_directions_have_length_one_and_no_preference():
    rng = generator(0, "test of directions")
    found = np.array([tolerance.direction(rng) for _ in range(2000)])
    assert np.linalg.norm(found, axis=1) == pytest.approx(1)
    assert np.abs(found.mean(axis=0)).max() < 0.06  # 4.6 standard deviations
