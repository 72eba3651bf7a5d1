import numpy as np
import pytest

from beso.envs.calvin.probe import TARGETS
from beso.images import probe
from beso.images.probe import Target

SWITCH, PLACE = Target("switch", (0,), 0.5), Target("place", (1, 2))


@pytest.fixture
def states():
    rng = np.random.default_rng(0)
    return np.column_stack([rng.integers(2, size=9000), rng.normal(size=(9000, 2))])


@pytest.fixture
def held_out():
    return np.arange(9000) >= 7500


def table(representations, states, held_out):
    rows = probe.probe(representations, states, held_out, (SWITCH, PLACE))
    return {(row["target"], row["representation"]): row for row in rows}


def test_what_is_linear_in_features_is_found_and_noise_tells_nothing(states, held_out):
    rng = np.random.default_rng(1)
    mixed = states @ rng.normal(size=(3, 20)) + 5
    rows = table({"mixed": mixed.astype(np.float32), "noise": rng.normal(size=(9000, 20))}, states, held_out)
    assert rows["switch", "mixed"]["value"] == 1
    assert rows["switch", "mixed"]["measure"] == "accuracy"
    assert rows["place", "mixed"]["value"] < 1e-3
    assert rows["place", "mixed"]["measure"] == "error"
    assert rows["switch", "noise"]["value"] == pytest.approx(0.5, abs=4 * 0.5 / 1500**0.5)
    assert rows["place", "noise"]["value"] == pytest.approx(2**0.5, rel=0.06)
    assert rows["place", "noise"]["constant"] == pytest.approx(2**0.5, rel=0.06)


def test_agrees_with_the_closed_form(states, held_out):
    rng = np.random.default_rng(2)
    features = (states @ rng.normal(size=(3, 6)) + rng.normal(size=(9000, 6))).astype(np.float32)
    values = PLACE.values(states)
    fitted, asked = np.flatnonzero(~held_out), np.flatnonzero(held_out)
    standard = (features - features[fitted].mean(0)) / features[fitted].astype(float).std(0)
    design = np.column_stack([standard, np.ones(9000)])
    for penalty, found in zip(probe.PENALTIES, probe._ridge(features, values, fitted, asked), strict=True):
        ridge = penalty * len(fitted) * np.diag([1.0] * 6 + [0])  # the constant is not shrunk
        answer = np.linalg.solve(design[fitted].T @ design[fitted] + ridge, design[fitted].T @ values[fitted])
        assert np.allclose(found, design[asked] @ answer, atol=1e-4)


def test_held_out_steps_are_not_fitted(states, held_out):
    """Features that tell the held-out steps something else make them wrong."""
    lying = np.where(held_out[:, None], -states, states)
    rows = table({"lying": lying}, states, held_out)
    assert rows["place", "lying"]["value"] > 2


def test_features_that_never_change_do_no_harm(states, held_out):
    rows = table({"dead": np.column_stack([states, np.full(9000, 7.0)])}, states, held_out)
    assert rows["switch", "dead"]["value"] == 1


def test_targets_of_calvin_name_numbers_of_its_state():
    robot, scene = np.arange(15), np.arange(24) + 100
    state = np.concatenate([robot, scene])
    columns = {target.name: state[list(target.columns)].tolist() for target in TARGETS}
    assert columns == {
        "drawer": [101],
        "slider": [100],
        "led": [105],
        "lightbulb": [104],
        "block_red": [106, 107, 108],
        "block_blue": [112, 113, 114],
        "block_pink": [118, 119, 120],
        "hand": [0, 1, 2],
        "gripper": [6],
    }


def test_steps_in_the_middle_are_on_neither_side():
    target, states = Target("door", (0,), 0.5, margin=0.2), np.array([[0.0], [0.29], [0.31], [0.69], [0.71], [1.0]])
    assert target.counts(states).tolist() == [True, True, False, False, True, True]
    rng = np.random.default_rng(0)
    door = rng.uniform(size=(4000, 1))
    held_out = np.arange(4000) >= 3000
    confused = np.where(np.abs(door - 0.5) < 0.15, 1 - door, door)
    (row,) = probe.probe({"door": confused}, door, held_out, (target,))
    assert row["value"] == 1
    (row,) = probe.probe({"door": confused}, door, held_out, (Target("door", (0,), 0.5),))
    assert row["value"] < 0.8
