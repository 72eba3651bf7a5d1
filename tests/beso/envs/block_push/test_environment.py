import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from beso import envs
from beso.envs.block_push import evaluation, trials
from beso.envs.block_push.simulator.environment import BlockPushEnv, fitting_goal
from beso.envs.protocol import Outcome, Trial
from beso.errors import UserError

ARM, TOOL = 2, 3  # body numbers in the order of loading, after ground and work surface


@pytest.fixture(scope="module")
def env():
    env = BlockPushEnv()
    yield env
    env.close()


def place(env, block, xy):
    """Put a block somewhere and let it come to rest."""
    env._place(env._blocks[block], np.asarray(xy), 0.02, 0.0)


@pytest.mark.filterwarnings("error")
def test_passes_gymnasiums_checker():
    env = gymnasium.make("beso/BlockPush-v0", render_mode="rgb_array").unwrapped
    check_env(env)
    env.close()


def test_same_seed_gives_the_same_bits_whatever_was_played_before(env):
    actions = np.random.default_rng(0).uniform(-0.03, 0.03, (15, 2))

    def play():
        start, _ = env.reset(seed=5)
        return np.stack([start, *(env.step(a)[0] for a in actions)])

    first = play()
    env.reset(seed=6)
    env.step([0.02, 0.03])
    assert play().tobytes() == first.tobytes()


def test_rendering_does_not_change_the_physics(env):
    filmed = BlockPushEnv(render_mode="rgb_array", render_size=(60, 80))
    actions = np.random.default_rng(1).uniform(-0.03, 0.03, (10, 2))
    for e in (env, filmed):
        e.reset(seed=3)
    for action in actions:
        plain, with_picture = env.step(action)[0], filmed.step(action)[0]
        picture = filmed.render()
        assert plain.tobytes() == with_picture.tobytes()
    assert picture.shape == (60, 80, 3)
    assert picture.dtype == np.uint8
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 10
    filmed.close()


def test_start_distribution(env):
    starts = np.stack([env.reset(seed=i)[0] for i in range(150)])
    blocks = starts[:, [[0, 1], [3, 4]]]
    # A block may slide a little while it surfaces.
    assert (np.abs(blocks - [0.4, -0.2]) < [0.102, 0.152]).all()
    assert (np.abs(blocks[:, 0, 0] - blocks[:, 1, 0]) > 0.098).all()
    assert (starts[:, [2, 5]] > 0.99).all()
    left, right = np.sort(starts[:, [10, 13]], axis=1).T
    assert np.abs(left - 0.28).max() <= 0.005
    assert np.abs(right - 0.52).max() <= 0.005
    assert np.abs(starts[:, [11, 14]] - 0.2).max() <= 0.0075
    assert 0.35 < (starts[:, 10] < 0.4).mean() < 0.65  # either target may be the left one
    # The first block is uniform in x, although the second must keep 0.1 m away from it.
    assert np.histogram(blocks[:, 0, 0], bins=3, range=(0.3, 0.5))[0].min() > 30
    # The effector starts where the published environment's does (measured there).
    assert np.abs(starts[:, 6:8] - [0.3003, -0.3986]).max() < 5e-4


def test_tool_is_held_where_its_shaft_meets_the_blocks(env):
    env.reset(seed=0)
    height = env._client.getBasePositionAndOrientation(TOOL)[0][2]
    assert height == pytest.approx(0.0584, abs=5e-4)  # measured in the published environment; 0.0703 without contact
    force = sum(point[9] for point in env._client.getContactPoints(ARM, TOOL))
    assert force > 10


def test_each_pair_pays_once_and_both_targets_end_the_episode(env):
    observation, info = env.reset(seed=1)
    targets = observation[[[10, 11], [13, 14]]]
    assert info["tasks"] == ()
    place(env, 0, targets[1])
    _, reward, terminated, truncated, info = env.step([0, 0])
    assert (reward, terminated, truncated, info["tasks"]) == (0.49, False, False, (1,))
    _, reward, terminated, _, info = env.step([0, 0])
    assert (reward, terminated, info["tasks"]) == (0.0, False, (1,))
    place(env, 1, targets[0])
    _, reward, terminated, _, info = env.step([0, 0])
    assert (reward, terminated, info["tasks"]) == (0.51, True, (1, 2))


def test_two_blocks_in_one_target_are_no_success(env):
    observation, _ = env.reset(seed=1)
    target = observation[10:12]
    place(env, 0, target - [0.022, 0])
    _, reward, terminated, _, _ = env.step([0, 0])
    assert (reward, terminated) == (0.49, False)
    place(env, 1, target + [0.022, 0])
    _, reward, terminated, _, info = env.step([0, 0])
    assert (reward, terminated, info["tasks"]) == (0.49, False, (0, 2))


def test_effector_target_integrates_actions_inside_the_workspace(env):
    env.reset(seed=0)
    observation = env.step([0.02, 0.03])[0]
    assert observation[8:10] == pytest.approx([0.32, -0.37])
    for _ in range(10):
        observation = env.step([-0.1, -0.1])[0]
    assert observation[8:10] == pytest.approx([0.15, -0.5])
    assert observation[6:8] == pytest.approx([0.15, -0.5], abs=0.005)  # the arm follows


def test_goal_exchanges_the_blocks_when_the_targets_lie_the_other_way_round():
    state = np.arange(16.0)[None]
    state[0, 10:12] = [0.28, 0.2]
    same, other = np.zeros(16), np.zeros(16)
    same[10:12], other[10:12] = [0.281, 0.201], [0.52, 0.2]
    assert (fitting_goal(state, same) == state).all()
    swapped = fitting_goal(state, other)
    assert swapped[0, [0, 1, 3, 4]].tolist() == [3, 4, 0, 1]
    assert state[0, 0] == 0  # the demonstration itself is not touched


def test_reset_answers_with_the_fitting_goal(env):
    state = np.arange(16.0)[None]
    observation, info = env.reset(seed=3, options={"goal": state})
    assert np.array_equal(info["goal"], fitting_goal(state, observation))


def test_a_goal_of_its_own_has_each_block_in_its_target(env):
    observation, info = env.reset(seed=3)
    assert np.array_equal(info["goal"][:, [0, 1, 3, 4]], observation[None, [10, 11, 13, 14]])
    assert np.array_equal(info["goal"][:, 5:], observation[None, 5:])


def result(info, wanted):
    trial = Trial(seed=0, options={}, tasks=wanted, limit=1, labels={})
    return evaluation.score(trial, Outcome(0.0, 1, np.zeros(16), info, np.zeros((1, 16)), np.zeros(16)))["result"]


def test_result_counts_the_goals_pairs_in_any_order():
    assert result({"tasks": (2, 1)}, (1, 2)) == 1.0
    assert result({"tasks": (0, 1)}, (1, 2)) == 0.5
    assert result({"tasks": (0, 3)}, (1, 2)) == 0.0
    assert result({"tasks": (0, 3, 1, 2)}, (1,)) == 0.5  # a demonstration that did one task caps the result


def test_bad_render_mode_is_refused():
    with pytest.raises(ValueError, match="'human' is not one of"):
        BlockPushEnv(render_mode="human")


def test_distance_is_the_mean_of_the_blocks_from_their_places():
    observation, goal = np.zeros(16), np.zeros((1, 16))
    observation[0], observation[4] = 0.3, 0.1
    trial = Trial(seed=0, options={}, tasks=(), limit=1, labels={})
    row = evaluation.score(trial, Outcome(0.49, 7, observation, {"tasks": (1, 2)}, goal, np.zeros(16)))
    assert row == {"tasks": "1 2", "reward": 0.49, "result": 0, "length": 7, "goal_distance": 0.2}


def test_rooms_load_by_name():
    assert envs.names() == sorted(envs.names())
    assert trials.MAX_ACTIONS == 299


@pytest.mark.parametrize("action", [[np.nan, 0.0], [0.0, np.inf], [0.01], [[0.0, 0.0]], {"x": 0.0}])
def test_an_action_that_is_not_two_finite_numbers_is_refused(env, action):
    env.reset(seed=0)
    for _ in range(2):  # two of them would hang the inverse kinematics
        with pytest.raises(UserError, match=r"^action "):
            env.step(action)
    env.step(np.zeros(2))


@pytest.mark.parametrize("goal", [np.full((1, 16), np.nan), np.zeros((1, 15)), np.zeros(16), np.zeros((0, 16))])
def test_a_goal_that_is_not_states_is_refused(env, goal):
    with pytest.raises(UserError, match=r"^goal "):
        env.reset(seed=0, options={"goal": goal})


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_an_environment_is_not_copied(env, copied):
    env.reset(seed=0)
    with pytest.raises(TypeError, match="a BlockPushEnv cannot be copied: make another"):
        copied(env)
