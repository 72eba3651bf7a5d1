import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from beso.envs.calvin.simulator import CalvinEnv
from beso.envs.calvin.spec import SPEC
from beso.errors import UserError


@pytest.fixture(scope="module")
def env():
    env = CalvinEnv(size=48)
    yield env
    env.close()


@pytest.mark.filterwarnings("error")
def test_passes_gymnasiums_checker():
    env = gymnasium.make("beso/Calvin-v0", render_mode="rgb_array").unwrapped
    assert env.observation_space.shape == (112, 112, 3)
    check_env(env)
    env.close()


def test_observations_are_pictures_and_info_tells_the_state(env):
    observation, info = env.reset(seed=0)
    assert observation.dtype == np.uint8
    assert observation.shape == (48, 48, 3)
    assert set(info) == {"robot_obs", "scene_obs", "state", "tasks", "goal"}
    assert info["scene_obs"][:6] == pytest.approx(np.zeros(6), abs=1e-3)
    _, reward, terminated, truncated, after = env.step(np.array([1, 0, 0, 0, 0, 0, 1], dtype=np.float32))
    assert (reward, terminated, truncated) == (0.0, False, False)
    assert after["robot_obs"][0] > info["robot_obs"][0]


def test_reset_to_a_given_state_with_a_goal(env, scene):
    scene[1] = 0.15
    goal = np.zeros((1, 48, 48, 3), dtype=np.uint8)
    _, info = env.reset(options={"scene_obs": scene, "goal": goal})
    assert info["scene_obs"] == pytest.approx(scene, abs=1e-3)
    assert info["goal"] is goal


def test_without_options_the_drawer_is_to_be_opened(env):
    observation, info = env.reset(seed=0)
    assert info["goal"].shape == (1, 48, 48, 3)
    assert 0.01 < (info["goal"][0] != observation).any(axis=-1).mean() < 0.3, "the drawer alone differs"
    env.table.fixtures.reset([0, 0.2, 0, 0, 0, 0])
    _, reward, terminated, _, info = env.step(np.zeros(7))
    assert (reward, terminated, info["tasks"]) == (1.0, True, (SPEC.tasks.index("open_drawer"),))


def test_same_seed_same_episode(env):
    first, _ = env.reset(seed=3)
    env.reset(seed=4)
    second, _ = env.reset(seed=3)
    assert first.tobytes() == second.tobytes()


def test_rendering_needs_a_mode(env):
    env.reset(seed=0)
    assert env.render() is None
    with pytest.raises(ValueError, match="'human' is not one of"):
        CalvinEnv(render_mode="human")


def test_a_goal_stands_beside_what_is_filmed(scene):
    env = CalvinEnv(render_mode="rgb_array", size=48, render_size=96)
    goal = np.full((1, 24, 24, 3), 200, dtype=np.uint8)
    first, _ = env.reset(options={"scene_obs": scene, "goal": goal})
    picture = env.render()
    assert picture.shape == (96, 2 * 96, 3)
    titles = slice(0, 24)  # rows with "goal" and "now"
    assert (picture[24:, :96] == 200).all()
    assert (picture[titles, :96] < 100).any()
    now = env.table.picture(96)
    assert np.array_equal(picture[24:, 96:], now[24:])
    assert np.array_equal(first, env.table.picture(24)), "what policies see has neither"
    assert (goal == 200).all()
    env.reset(options={"scene_obs": scene})
    assert np.array_equal(env.render(), now)
    env.close()


@pytest.mark.parametrize("action", [[np.nan, *[0.0] * 6], [0.0] * 6, [[0.0] * 7], [*[0.0] * 6, np.inf]])
def test_an_action_that_is_not_seven_finite_numbers_is_refused(env, action):
    env.reset(seed=0)
    for _ in range(2):  # two of them would hang the inverse kinematics
        with pytest.raises(UserError, match=r"^action "):
            env.step(action)
    env.step(np.zeros(7))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("scene_obs", np.full(24, np.nan)),
        ("scene_obs", np.zeros(23)),
        ("robot_obs", np.full(15, np.inf)),
        ("tasks", np.zeros(33)),
        ("goal", np.zeros((48, 48, 3), dtype=np.uint8)),
    ],
)
def test_a_start_that_is_no_state_is_refused(env, name, value):
    with pytest.raises(UserError, match=f"^{name} "):
        env.reset(seed=0, options={name: value})


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_an_environment_is_not_copied(env, copied):
    with pytest.raises(TypeError, match="a CalvinEnv cannot be copied: make another"):
        copied(env)
    with pytest.raises(TypeError, match="a Client cannot be copied"):
        copy.deepcopy(env.table)
