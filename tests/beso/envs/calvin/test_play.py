"""A stretch of scripted play: what was recorded, and that it depends on seed and number alone."""

import itertools

import numpy as np
import pytest

from beso.envs.calvin.demonstrations.scripted import record


@pytest.fixture(scope="module")
def steps():
    return list(record(0, 0, 400, size=32))


def test_steps_hold_what_was_seen_and_done(steps):
    assert len(steps) == 400
    first = steps[0]
    assert first.segment_start
    assert (first.frame.shape, first.frame.dtype) == ((32, 32, 3), np.uint8)
    assert (first.robot_obs.shape, first.scene_obs.shape) == ((15,), (24,))
    actions = np.stack([step.rel_action for step in steps])
    assert np.abs(actions).max() <= 1
    assert set(actions[:, 6]) <= {-1.0, 1.0}
    following = np.stack([step.robot_obs[:3] for step in steps[1:]])
    assert np.stack([step.action[:3] for step in steps[:-1]]) == pytest.approx(following)


def test_play_does_several_things_and_labels_them(steps):
    assert sum(step.segment_start for step in steps) >= 4
    assert len({step.family for step in steps}) >= 2
    assert np.stack([step.tasks for step in steps]).sum() >= 2


def test_play_depends_on_its_number_alone(steps):
    list(itertools.islice(record(0, 1, 100, size=None), 60))
    again = list(record(0, 0, 400, size=32))
    for name in ("frame", "robot_obs", "scene_obs", "rel_action", "action", "tasks"):
        ours, theirs = (np.stack([getattr(step, name) for step in part]) for part in (steps, again))
        assert ours.tobytes() == theirs.tobytes(), name
    other = next(iter(record(1, 0, 1, size=None)))
    assert not np.array_equal(other.scene_obs, steps[0].scene_obs)
