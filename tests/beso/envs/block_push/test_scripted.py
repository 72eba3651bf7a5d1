import numpy as np
import pytest

from beso.data import play
from beso.envs.block_push.demonstrations.scripted import PLANS, BlockPushDemonstrator, record
from beso.envs.block_push.report import statistics
from beso.envs.block_push.spec import SPEC
from pipeline.machine import Machine
from pipeline.pool import map_jobs


@pytest.fixture(scope="module")
def demonstrations():
    episodes = list(map_jobs(record, [(0, i) for i in range(200)], Machine()))
    return play.assemble(episodes, SPEC, {"source": "scripted"})


def test_statistics_are_those_of_the_published_set(demonstrations):
    """Published, 1000 demonstrations: mean length 116.8, mean action 0.01899 m, 30.5 % of actions of exactly 0.03 m."""
    ours = statistics(demonstrations)
    assert ours["share ended by success"] >= 0.97
    assert ours["mean length (steps)"] == pytest.approx(116, abs=3)
    assert ours["mean action size (m)"] == pytest.approx(0.0190, abs=0.0002)
    assert 0.28 <= ours["share of actions of 0.03 m"] <= 0.33
    assert ours["longest (steps)"] <= 201


def test_all_four_plans_occur_equally_often(demonstrations):
    plans = [demonstrations.completed(i) for i in range(len(demonstrations)) if len(demonstrations.completed(i)) == 2]
    counts = [plans.count(tuple(2 * block + target for block, target in plan)) for plan in PLANS]
    assert sum(counts) > 0.95 * len(plans)
    assert min(counts) > 30  # of 50 expected; five standard deviations are 30.6


def test_last_row_is_the_final_state_with_the_action_not_taken(demonstrations):
    end = demonstrations.episode_ends[0]
    states = demonstrations.observations[:end]
    moved = states[1:, 8:10] - states[:-1, 8:10]
    assert np.abs(moved - demonstrations.actions[: end - 1]).max() < 1e-6
    assert demonstrations.tasks[end - 1].sum() == 1  # the second block arrived


@pytest.mark.parametrize("number", [78, 97, 128, 154])
def test_a_demonstration_depends_on_its_number_alone(demonstrations, number):
    """These four came out differently after other episodes when resets restored a saved physics state."""
    again = record(0, number)
    start, end = demonstrations.episode_starts[number], demonstrations.episode_ends[number]
    assert again.observations.tobytes() == demonstrations.observations[start:end].tobytes()
    assert again.actions.tobytes() == demonstrations.actions[start:end].tobytes()


def test_steps_never_exceed_the_speed_limit(demonstrations):
    assert np.linalg.norm(demonstrations.actions, axis=1).max() <= 0.035 + 1e-6


def test_controller_walks_behind_the_block_first():
    observation = np.zeros(16)
    observation[[0, 1]], observation[[10, 11]], observation[[8, 9]] = [0.4, -0.2], [0.4, 0.2], [0.4, -0.4]
    action = BlockPushDemonstrator(PLANS[0]).action(observation)
    assert action == pytest.approx([0, 0.03])  # 5 cm behind the block, at 0.3 m/s for 0.1 s
    assert action.dtype == np.float32
