"""Each of the 34 tasks is done by its scripted skill, from random states and in random manners."""

from functools import partial

import numpy as np
import pytest

from beso.envs.calvin.demonstrations.fixture_skills import move_slider, open_drawer
from beso.envs.calvin.demonstrations.hand import FINGER_STEPS, Hand, Manner
from beso.envs.calvin.demonstrations.oracle import perform, prepare
from beso.envs.calvin.demonstrations.placing_skills import neutral
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import CLOSE, GRIPPER_COMMAND, GRIPPER_WIDTH, OPEN, TCP_POSITION

SEEDS = 3


@pytest.mark.parametrize("task", tasks.NAMES)
def test_skill_completes_its_task(table, task):
    """At least two of three times: skills succeed 19 times out of 20, and rounding differs between processors."""
    successes = 0
    for seed in range(SEEDS):
        rng = np.random.default_rng([100, seed])
        hand = Hand(table, Manner.draw(rng))
        skill = prepare(table, hand, task, rng)
        start = table.state()
        steps = perform(table, skill.motion(hand))
        assert steps < 256
        successes += task in tasks.names_of(tasks.completed(start, table.state()))
    assert successes >= SEEDS - 1


def test_the_hand_returns_to_where_episodes_start(table, scene):
    table.reset(scene)
    start = table.robot_obs()[TCP_POSITION]
    hand = Hand(table)
    perform(table, hand.go((0.2, -0.1, 0.6), yaw=2.5))
    perform(table, neutral(hand))
    assert np.linalg.norm(table.robot_obs()[TCP_POSITION] - start) < 0.03


def test_pace_and_bow_change_the_way(table, scene):
    def way(manner):
        table.reset(scene)
        hand = Hand(table, manner)
        actions, places = [], []
        for action in hand.go((0.2, -0.2, 0.6)):
            actions.append(action)
            table.step(action)
            places.append(hand.position)
        return np.array(actions), np.array(places)

    (plain, straight), (slow, _), (_, bowed) = (way(m) for m in (Manner(), Manner(pace=0.5), Manner(bow=(0.4, 0.3))))
    assert len(slow) > len(plain)
    assert np.abs(slow[:, :3]).max() <= 0.4 + 1e-9
    assert np.abs(plain).max() <= 1
    for axis in (1, 2):  # to the left, which is to positive y where the way leads to positive x, and above
        assert np.interp(0.1, bowed[:, 0], bowed[:, axis]) > np.interp(0.1, straight[:, 0], straight[:, axis]) + 0.01
    assert bowed[-1] == pytest.approx(straight[-1], abs=0.02)


@pytest.mark.parametrize("touch", [-1.0, 1.0])
@pytest.mark.parametrize(
    ("task", "skill"), [("open_drawer", open_drawer), ("move_slider_left", partial(move_slider, left=True))]
)
def test_a_handle_can_be_touched_at_both_of_its_ends(table, scene, task, skill, touch):
    table.reset(scene)
    start = table.state()
    perform(table, skill(Hand(table, Manner(touch=touch))))
    assert tasks.names_of(tasks.completed(start, table.state())) == (task,)


def test_a_waiting_hand_comes_back_where_it_is_moved(table, scene):
    table.reset(scene)
    start, waiting = table.robot_obs()[TCP_POSITION], Hand(table).wait(20)
    assert not next(waiting)[:6].any()
    table.step(np.array([1.0, -1.0, 0.5, 0, 0, 0, 1.0]))
    back = next(waiting)
    assert back[:3] == pytest.approx([-1.0, 1.0, -0.5])
    table.step(back)
    perform(table, waiting)
    assert table.robot_obs()[TCP_POSITION] == pytest.approx(start, abs=3e-3)


def test_the_hand_goes_on_when_the_fingers_have_stopped(table, scene):
    table.reset(scene)
    hand = Hand(table)
    for motion, command, width in ((hand.close, CLOSE, 0.0), (hand.open, OPEN, 0.08)):
        assert 2 <= perform(table, motion()) < FINGER_STEPS
        assert table.robot_obs()[GRIPPER_COMMAND] == command
        assert table.robot_obs()[GRIPPER_WIDTH] == pytest.approx(width, abs=4e-3)


def test_an_unknown_task_is_refused(table):
    with pytest.raises(ValueError, match="'juggle' is not one of"):
        prepare(table, Hand(table), "juggle", np.random.default_rng(0))
