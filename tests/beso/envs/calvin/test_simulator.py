import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from beso.envs.calvin.observations import DRAWER, FIXTURES, LED, LIGHTBULB, SLIDE, SWITCH, TCP_EULER, TCP_POSITION, wrap
from beso.envs.calvin.simulator import CalvinEnv
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.calvin.simulator.spawn import draw_fixtures, draw_scene
from beso.envs.calvin.tasks import NAMES, completed, names_of

NEUTRAL_PLACE, NEUTRAL_EULER = [0.0259, -0.2313, 0.5713], [3.0905, -0.0291, 1.5001]  # facts of the published robot
ACTIONS = np.random.default_rng(0).uniform(-1, 1, (40, 7))


@pytest.fixture(scope="module")
def table():
    table = PlayTable()
    yield table
    table.close()


def scene(seed=0):
    rng = np.random.default_rng(seed)
    return draw_scene(rng, draw_fixtures(rng))


def play(table, seed=0, actions=ACTIONS):
    table.reset(scene(seed))
    states = []
    for action in actions:
        table.step(action)
        states.append(np.concatenate([table.robot_obs(), table.scene_obs()]))
    return np.array(states).tobytes() + table.picture(64).tobytes()


def test_passes_gymnasiums_checker():
    env = gymnasium.make("beso/Calvin-v0", render_mode="rgb_array", size=64, render_size=64).unwrapped
    check_env(env)
    env.close()


def test_the_arm_starts_at_the_published_neutral_pose(table):
    table.reset(scene())
    robot = table.robot_obs()
    assert robot[TCP_POSITION] == pytest.approx(NEUTRAL_PLACE, abs=2e-3)
    assert wrap(robot[TCP_EULER] - NEUTRAL_EULER) == pytest.approx(np.zeros(3), abs=5e-3)


def test_a_relative_action_moves_the_tcp_by_what_it_says(table):
    table.reset(scene())
    start = table.robot_obs()
    for _ in range(5):
        table.step(np.array([0.5, 0, 0.5, 0, 0, 0.5, 1.0]))  # 1 cm a step in x and z, 0.025 rad about z
    for _ in range(10):
        table.step(np.array([0, 0, 0, 0, 0, 0, 1.0]))
    moved = table.robot_obs()
    assert moved[TCP_POSITION] - start[TCP_POSITION] == pytest.approx([0.05, 0, 0.05], abs=5e-3)
    assert wrap(moved[TCP_EULER] - start[TCP_EULER])[2] == pytest.approx(0.125, abs=0.02)


def test_a_reset_puts_everything_where_it_is_told(table):
    for seed in range(4):
        table.reset(scene(seed))
        found = table.scene_obs()
        assert found[[SLIDE, DRAWER, SWITCH]] == pytest.approx(scene(seed)[[SLIDE, DRAWER, SWITCH]], abs=2e-3)
        assert found[[LIGHTBULB, LED]] == pytest.approx(scene(seed)[[LIGHTBULB, LED]])
        for block in (6, 12, 18):
            assert found[block : block + 3] == pytest.approx(scene(seed)[block : block + 3], abs=5e-3)


def test_same_scene_and_actions_give_the_same_bits_whatever_was_played_before(table):
    first = play(table)
    play(table, seed=1, actions=-ACTIONS)
    assert play(table) == first
    other = PlayTable()
    assert play(other) == first
    other.close()


def test_pictures_show_the_lights(table):
    dark, lit = scene(), scene()
    dark[FIXTURES] = 0
    lit[FIXTURES] = [0, 0, 0, 0.088, 1, 1]
    pictures = []
    for told in (dark, lit):
        table.reset(told)
        pictures.append(table.picture(112).astype(int))
    assert pictures[0].shape == (112, 112, 3)
    assert (np.abs(pictures[0] - pictures[1]).max(axis=-1) > 30).sum() > 50


def test_observations_are_pictures_and_info_holds_the_state():
    env = CalvinEnv(size=48)
    observation, info = env.reset(seed=3, options={"goal": np.zeros((1, 48, 48, 3), dtype=np.uint8)})
    assert observation.shape == (48, 48, 3)
    assert info["robot_obs"].shape == (15,)
    assert info["scene_obs"].shape == (24,)
    assert info["goal"].shape == (1, 48, 48, 3)
    assert "goal" not in env.reset(seed=3)[1]
    env.close()


def test_there_are_34_tasks_and_nothing_is_done_at_rest(table):
    assert len(NAMES) == len(set(NAMES)) == 34
    table.reset(scene())
    table.step(np.array([0, 0, 0, 0, 0, 0, 1.0]))
    assert names_of(completed(table.state(), table.state())) == ()
