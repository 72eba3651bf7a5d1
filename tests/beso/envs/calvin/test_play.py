"""Recorded scripted play."""

from collections import Counter

import numpy as np
import pytest

from beso.envs.calvin.demonstrations import scripted
from beso.envs.calvin.demonstrations.layout import IN_SLIDER, ON_TABLE, place_of
from beso.envs.calvin.demonstrations.player import draw_start
from beso.envs.calvin.demonstrations.scripted import _labels, record
from beso.envs.calvin.simulator import tasks


@pytest.fixture(scope="module")
def stretch():
    return list(record(seed=20, index=3, length=1500, size=None))


def columns(steps, name):
    return np.array([getattr(step, name) for step in steps])


def test_a_stretch_has_the_length_that_was_asked_for(stretch):
    assert len(stretch) == 1500
    assert columns(stretch, "robot_obs").shape == (1500, 15)
    assert columns(stretch, "scene_obs").shape == (1500, 24)


def test_no_family_dominates(stretch):
    families = Counter(step.family for step in stretch if step.segment_start)
    skills = {name: count for name, count in families.items() if name not in ("rest", "detour", "recover")}
    assert len(skills) >= 8
    assert max(skills.values()) <= 0.25 * sum(skills.values())
    assert families["rest"] > families["detour"] > 0
    # Most skills complete their task.
    assert columns(stretch, "tasks").any(axis=1).sum() > 0.5 * sum(skills.values())


def test_several_tasks_of_each_kind_are_done(stretch):
    done = tasks.names_of(columns(stretch, "tasks").any(axis=0))
    assert len(done) >= 12
    assert any(name.startswith("lift") for name in done)
    assert any(name.startswith(("push", "rotate")) for name in done)
    assert any(name.startswith("place") or name == "stack_block" for name in done)


def test_labels_of_fixtures_agree_with_the_states(stretch):
    """What the recorded states show within each segment, row by row."""
    scene_obs, labels = columns(stretch, "scene_obs"), columns(stretch, "tasks")
    starts = np.flatnonzero(columns(stretch, "segment_start"))
    checked = 0
    for first, end in zip(starts, [*starts[1:], len(stretch)], strict=True):
        for name, entry, threshold in (
            ("move_slider_left", 0, 0.15),
            ("open_drawer", 1, 0.12),
            ("turn_on_lightbulb", 4, 0.5),
            ("turn_on_led", 5, 0.5),
        ):
            moved = scene_obs[first:end, entry] - scene_obs[first, entry] > threshold
            label = np.flatnonzero(labels[first:end, tasks.NAMES.index(name)])
            if len(label) and label[0] < end - first - 1:
                assert moved[label[0] :].all()
                assert not moved[label[0] - 1]
                checked += 1
            if not len(label):
                assert not moved[-1]
    assert checked >= 3


def test_labels_mark_where_a_task_came_to_be_done_for_good():
    done = np.array([[0, 0, 0, 1], [1, 0, 0, 1], [0, 1, 0, 1], [1, 1, 0, 1], [1, 0, 1, 1]], dtype=bool)
    expected = np.array([[0, 0, 0, 1], [0, 0, 0, 0], [0, 0, 0, 0], [1, 0, 1, 0]])
    assert (_labels(done) == expected).all()


def test_actions_are_what_the_arm_then_did(stretch):
    robot_obs, actions = columns(stretch, "robot_obs"), columns(stretch, "action")
    assert (actions[:-1, :6] == robot_obs[1:, :6]).all()
    assert (actions[:, 6] == columns(stretch, "rel_action")[:, 6]).all()
    assert set(actions[:, 6]) == {-1, 1}
    assert np.abs(columns(stretch, "rel_action")).max() <= 1


def test_what_is_recorded_is_wanted_and_what_is_done_is_disturbed(monkeypatch):
    table = scripted._recording_table()
    done = []
    step = table.step
    monkeypatch.setattr(table, "step", lambda action: done.append(action) or step(action))
    wanted = columns(list(record(seed=2, index=0, length=400, size=None)), "rel_action")
    tremor = np.array(done) - wanted
    assert not tremor[:, 6].any()
    assert 0.03 < tremor[:, :3].std() < scripted.LARGEST_TREMOR
    assert 0.01 < tremor[:, 3:6].std() < 0.3 * scripted.LARGEST_TREMOR
    assert np.corrcoef(tremor[1:, 0], tremor[:-1, 0])[0, 1] > 0.6


def test_an_episode_depends_on_its_seed_and_index_alone():
    def bits(index, length=120):
        steps = list(record(seed=1, index=index, length=length, size=32))
        names = ("frame", "robot_obs", "scene_obs", "rel_action", "action", "tasks")
        return b"".join(columns(steps, name).tobytes() for name in names)

    first = bits(0)
    other = bits(1)
    assert bits(0) == first
    assert other != first


def test_play_starts_where_there_is_something_to_play_with():
    rng = np.random.default_rng(0)
    for _ in range(20):
        scene = draw_start(rng)
        places = [place_of(scene, block) for block in range(3)]
        assert ON_TABLE in places
        assert set(places) <= {ON_TABLE, IN_SLIDER}
