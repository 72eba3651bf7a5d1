import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium_robotics.envs.franka_kitchen.kitchen_env import BONUS_THRESH, OBS_ELEMENT_GOALS, OBS_ELEMENT_INDICES

from beso.envs.kitchen import spec
from beso.envs.kitchen.simulator import KitchenEnv, camera
from beso.errors import UserError

ACTIONS = np.random.default_rng(0).uniform(-1, 1, (30, 9)).astype(np.float32)


@pytest.fixture(scope="module")
def env():
    return KitchenEnv()


def play(env, seed=5, actions=ACTIONS):
    start, _ = env.reset(seed=seed)
    return np.stack([start, *(env.step(action)[0] for action in actions)])


def put(env, task, share=1.0):
    """Put a task's element at a share of its way from where it is to its goal."""
    element, goal = list(spec.TASKS[task].element), np.array(spec.TASKS[task].goal)
    env.data.qpos[element] += share * (goal - env.data.qpos[element])


def can_draw():
    try:
        KitchenEnv("rgb_array").render()
    except UserError:
        return False
    return True


@pytest.mark.filterwarnings("error")
def test_passes_gymnasiums_checker():
    env = gymnasium.make("beso/Kitchen-v0", render_mode="rgb_array").unwrapped
    check_env(env, skip_render_check=not can_draw())
    env.close()


def test_tasks_are_those_of_the_wrapped_environment():
    assert {task.name: task.element for task in spec.TASKS} == {k: tuple(v) for k, v in OBS_ELEMENT_INDICES.items()}
    assert {task.name: task.goal for task in spec.TASKS} == {k: tuple(v) for k, v in OBS_ELEMENT_GOALS.items()}
    assert spec.THRESHOLD == BONUS_THRESH


def test_observation_is_the_robot_and_the_objects_with_the_relay_environments_noise(env):
    noise = []
    for seed in range(300):
        observation, _ = env.reset(seed=seed)
        assert observation.dtype == np.float64
        noise.append(observation - env.data.qpos)
    # Entries 9 to 29 of the 35 amplitudes in the relay environment's configuration, times 0.1
    amplitudes = 2 * [0.005] + 6 * [0.0005] + 3 * [0.005] + 3 * [0.1] + 3 * [0.005] + 3 * [0.1] + [0.005]
    largest = np.concatenate([np.full(9, 0.01), 0.1 * np.array(amplitudes)])
    noise = np.array(noise) / largest
    assert np.abs(noise).max() <= 1 + 1e-9
    assert np.abs(noise).max(axis=0).min() > 0.95
    assert np.abs(noise.mean(axis=0)).max() < 0.15  # uniform: 4.5 standard deviations
    assert np.abs(noise.std(axis=0) - 3**-0.5).max() < 0.08


# Largest deviation from the mean at rest in people's demonstrations, by entry (25 steps of four episodes, rad or m)
HUMAN_NOISE = {
    9: 8e-4,
    10: 8e-4,
    12: 6e-5,
    13: 6e-5,
    14: 6e-5,
    15: 6e-5,
    16: 6e-5,
    17: 6e-4,
    20: 0.011,
    23: 6e-4,
    29: 6e-4,
}


def test_noise_is_no_larger_than_in_peoples_demonstrations(env):
    """Where nothing moves, a policy that learnt from them sees scaled noise as large as in them, and no larger."""
    entries = list(HUMAN_NOISE)
    noise = np.zeros(len(entries))
    for seed in range(100):
        observation, _ = env.reset(seed=seed)
        noise = np.maximum(noise, np.abs(observation - env.data.qpos)[entries])
    assert (noise <= list(HUMAN_NOISE.values())).all()


def test_noise_acts_on_the_robot_because_actions_start_from_the_observed_pose(env):
    observation, _ = env.reset(seed=0)
    env.step(np.full(9, 0.1, dtype=np.float32))
    assert env.data.ctrl[:7] == pytest.approx(observation[:7] + 0.1 * 2 * 0.08)


def test_same_seed_gives_the_same_bits_whatever_was_played_before(env):
    first = play(env)
    play(env, seed=6, actions=-ACTIONS)
    assert play(env).tobytes() == first.tobytes()
    assert play(KitchenEnv()).tobytes() == first.tobytes()
    assert play(env, seed=6).tobytes() != first.tobytes()


def test_environments_played_in_turns_do_not_touch_each_other(env):
    expected, other = play(env), KitchenEnv()
    assert other.model is env.model, "they share what is compiled"
    env.reset(seed=5)
    other.reset(seed=7)
    observations = []
    for action in ACTIONS:
        observations.append(env.step(action)[0])
        other.step(-action)
    assert np.stack(observations).tobytes() == expected[1:].tobytes()


def test_environments_without_a_seed_differ():
    one, other = KitchenEnv(), KitchenEnv()
    assert one.reset()[0].tobytes() != other.reset()[0].tobytes()
    assert one.reset()[0].tobytes() != one.reset()[0].tobytes()


def test_every_task_pays_once_and_is_listed_in_order(env):
    env.reset(seed=0)
    rest = np.zeros(9, dtype=np.float32)
    rewards, listed = [], []
    for changes in ([(5, 1.0)], [], [(5, -1.0)], [(5, 1.0), (0, 1.0)], [(4, 1.0), (3, 1.0)], []):
        for task, share in changes:
            put(env, task, share)
        _, reward, terminated, truncated, info = env.step(rest)
        rewards.append(reward)
        listed.append(info["tasks"])
        assert not terminated
        assert not truncated
    assert rewards == [1, 0, 0, 1, 2, 0]
    assert listed == [(5,), (5,), (5,), (5, 0), (5, 0, 3, 4), (5, 0, 3, 4)]  # two at once: in the order of TASKS
    assert env.reset(seed=0)[1]["tasks"] == ()


def test_ends_when_all_seven_tasks_are_done(env):
    env.reset(seed=0)
    for task in range(7):
        put(env, task)
    _, reward, terminated, truncated, info = env.step(np.zeros(9, dtype=np.float32))
    assert (reward, terminated, truncated) == (7, True, False)
    assert info["tasks"] == tuple(range(7))


def test_no_limit_of_length(env):
    env.reset(seed=0)
    assert not any(env.step(np.zeros(9, dtype=np.float32))[3] for _ in range(300))


def test_nothing_handed_out_is_changed_later(env):
    goal = np.arange(60.0).reshape(2, 30)
    observation, info = env.reset(seed=0, options={"goal": goal})
    kept = observation.copy()
    _, _, _, _, first = env.step(ACTIONS[0])
    put(env, 5)
    env.step(ACTIONS[1])
    assert np.array_equal(observation, kept)
    assert first["tasks"] == ()
    goal[:] = 0
    assert np.array_equal(info["goal"], np.arange(60.0).reshape(2, 30))


def test_a_goal_of_its_own_has_four_tasks_done(env):
    observation, info = env.reset(seed=0)
    assert info["goal"].shape == (2, 30)
    assert spec.done(info["goal"]).sum(axis=1).tolist() == [4, 4]
    assert np.array_equal(info["goal"][:, :9], [observation[:9]] * 2), "the robot as it is"


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_noise_is_a_keyword(env, noise):
    other = gymnasium.make("beso/Kitchen-v0", noise=noise).unwrapped
    usual, scaled = (e.reset(seed=4)[0] - e.data.qpos for e in (env, other))
    assert scaled == pytest.approx(noise * usual, abs=1e-12)


@pytest.mark.parametrize("noise", [-1.0, np.nan, np.inf])
def test_no_noise_is_refused(noise):
    with pytest.raises(ValueError, match="is not a number from 0 up"):
        KitchenEnv(noise=noise)


def test_actions_are_clipped_and_not_altered(env):
    large = 5 * ACTIONS
    kept = large.copy()
    assert play(env, actions=large).tobytes() == play(env, actions=large.clip(-1, 1)).tobytes()
    assert np.array_equal(large, kept)


def test_rendering_does_not_change_the_physics(env):
    if not can_draw():
        pytest.skip("MuJoCo cannot draw on this machine")
    filmed = KitchenEnv(render_mode="rgb_array", render_size=(60, 80))
    filmed.reset(seed=5)
    observations = []
    for action in ACTIONS[:5]:
        observations.append(filmed.step(action)[0])
        picture = filmed.render()
    assert np.stack(observations).tobytes() == play(env, actions=ACTIONS[:5])[1:].tobytes()
    assert picture.shape == (60, 80, 3)
    assert picture.dtype == np.uint8
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 100
    filmed.close()


def test_a_machine_that_cannot_draw_says_so_in_one_line(monkeypatch):
    def no_driver(name):
        raise ImportError(name)

    monkeypatch.setattr(camera.importlib, "import_module", no_driver)
    with pytest.raises(UserError, match=r"cannot draw with .* MUJOCO_GL=osmesa") as caught:
        KitchenEnv(render_mode="rgb_array").render()
    assert len(str(caught.value).splitlines()) == 1
    assert KitchenEnv().render() is None


def test_unknown_render_mode_and_too_large_pictures_are_refused():
    with pytest.raises(ValueError, match="'human' is not one of None, 'rgb_array'"):
        KitchenEnv(render_mode="human")
    with pytest.raises(UserError, match=r"render_size \(9999, 10\) is not between"):
        KitchenEnv(render_mode="rgb_array", render_size=(9999, 10)).render()


@pytest.mark.parametrize("action", [np.full(9, np.nan), np.zeros(8), np.zeros((1, 9)), {"x": 0.0}])
def test_an_action_that_is_not_nine_finite_numbers_is_refused(env, action):
    env.reset(seed=0)
    with pytest.raises(UserError, match=r"^action "):
        env.step(action)


@pytest.mark.parametrize("goal", [np.full((1, 30), np.nan), np.zeros((1, 29)), np.zeros(30), np.zeros((0, 30))])
def test_a_goal_that_is_not_states_is_refused(env, goal):
    with pytest.raises(UserError, match=r"^goal "):
        env.reset(seed=0, options={"goal": goal})


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickle.dumps])
def test_an_environment_is_not_copied(env, copied):
    with pytest.raises(TypeError, match="a KitchenEnv cannot be copied: make another"):
        copied(env)
