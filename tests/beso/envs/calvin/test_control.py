"""Relative Cartesian control, resets and determinism."""

import numpy as np
import pytest

from beso.envs.calvin.demonstrations.block_skills import lift
from beso.envs.calvin.demonstrations.hand import Hand
from beso.envs.calvin.demonstrations.oracle import perform
from beso.envs.calvin.simulator.observations import GRIPPER_COMMAND, GRIPPER_WIDTH, TCP_EULER, TCP_POSITION, block_slice
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.errors import UserError


def act(table, *action, times=1, gripper=1.0):
    for _ in range(times):
        table.step(np.array([*action, gripper]))


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_translation_moves_the_tcp_by_two_centimetres_an_action(table, scene, axis, sign):
    table.reset(scene)
    start = table.robot_obs()
    action = np.zeros(6)
    action[axis] = sign
    act(table, *action, times=3)
    act(table, *np.zeros(6), times=10)  # the arm follows its target
    moved = table.robot_obs()[TCP_POSITION] - start[TCP_POSITION]
    assert moved == pytest.approx(0.06 * action[:3], abs=3e-3)
    assert table.robot_obs()[TCP_EULER] == pytest.approx(start[TCP_EULER], abs=0.02)


def test_rotation_turns_the_tcp_by_a_twentieth_of_a_radian_an_action(table, scene):
    table.reset(scene)
    start = table.robot_obs()
    act(table, 0, 0, 0, 0, 0, -1, times=8)
    act(table, *np.zeros(6), times=10)
    assert table.robot_obs()[TCP_EULER][2] - start[TCP_EULER][2] == pytest.approx(-0.4, abs=0.02)
    assert table.robot_obs()[TCP_POSITION] == pytest.approx(start[TCP_POSITION], abs=3e-3)


def test_actions_are_clipped_and_the_gripper_thresholds_at_zero(table, scene):
    table.reset(scene)
    start = table.arm.target_position.copy()
    act(table, 5.0, -5.0, 0, 0, 0, 0, gripper=0.2)
    assert table.arm.target_position - start == pytest.approx([0.02, -0.02, 0])
    assert table.robot_obs()[GRIPPER_COMMAND] == 1
    act(table, *np.zeros(6), gripper=-0.2, times=12)
    assert table.robot_obs()[GRIPPER_COMMAND] == -1
    assert table.robot_obs()[GRIPPER_WIDTH] == pytest.approx(0.0, abs=2e-3)
    act(table, *np.zeros(6), gripper=0.2, times=12)
    assert table.robot_obs()[GRIPPER_WIDTH] == pytest.approx(0.08, abs=2e-3)


def test_the_target_runs_ahead_of_a_blocked_arm(table, scene):
    table.reset(scene)
    act(table, 0, 0.3, -1, 0, 0, 0, times=20)
    assert table.robot_obs()[TCP_POSITION][2] - table.arm.target_position[2] > 0.1


def test_reset_reproduces_a_state_of_play(table, scene):
    table.reset(scene)
    rng = np.random.default_rng(0)
    for _ in range(40):
        table.step(np.array([*rng.uniform(-0.5, 0.5, 6), -1]))
    act(table, *np.zeros(6), gripper=-1, times=10)
    robot_obs, scene_obs, picture = table.robot_obs(), table.scene_obs(), table.picture(112)
    table.reset(scene_obs, robot_obs)
    assert table.robot_obs() == pytest.approx(robot_obs, abs=2e-3)
    assert table.scene_obs() == pytest.approx(scene_obs, abs=1e-3)
    assert (np.abs(table.picture(112).astype(int) - picture) > 30).mean() < 0.005


def test_reset_keeps_a_held_block_held(table, scene):
    table.reset(scene)
    perform(table, lift(Hand(table), 0))
    table.reset(table.scene_obs(), table.robot_obs())
    height = table.scene_obs()[block_slice(0)][2]
    act(table, *np.zeros(6), gripper=-1, times=30)
    assert table.state().blocks["block_red"].touched == {"robot"}
    assert table.scene_obs()[block_slice(0)][2] == pytest.approx(height, abs=5e-3)


def test_arrays_of_another_shape_are_refused(table, scene):
    with pytest.raises(UserError, match=r"scene_obs has shape \(23,\), expected \(24,\)"):
        table.reset(scene[1:])


def test_equal_actions_give_equal_bytes_whatever_came_before(table, scene):
    """Contacts with blocks, door and button included; pictures as well."""
    rng = np.random.default_rng(1)
    scenes = [scene, scene.copy()]
    scenes[1][[0, 1]] = 0.28, 0.2
    # Down beside the red block, then along the row of blocks.
    drift = np.repeat([[-0.15, 0.32, -0.29, 0, 0, 0], [0.12, 0, 0, 0, 0, 0]], [20, 100], axis=0)
    plays = [np.c_[rng.normal(drift, 0.1), rng.choice([-1, 1], 120)] for _ in scenes]

    def play(on, i):
        on.reset(scenes[i])
        bits = [on.picture(64).tobytes()]
        for action in plays[i]:
            on.step(action)
            bits.append(on.robot_obs().tobytes() + on.scene_obs().tobytes())
        return [*bits, on.picture(64).tobytes()]

    fresh = PlayTable()
    reference = [play(fresh, 0)]
    fresh.close()
    fresh = PlayTable()
    reference.append(play(fresh, 1))
    fresh.close()
    assert np.abs(np.frombuffer(reference[0][-2])[15 + 6 :] - scene[6:]).max() > 0.01, "the arm must touch something"
    for i in (0, 1, 1, 0, 1, 0):
        assert play(table, i) == reference[i]
