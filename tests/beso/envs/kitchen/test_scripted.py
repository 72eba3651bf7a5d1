import numpy as np
import pytest

from beso.data import play
from beso.envs.kitchen.demonstrations.player import LIMIT, Player
from beso.envs.kitchen.demonstrations.scripted import HUMAN_TASK_SETS, record, task_set
from beso.envs.kitchen.demonstrations.skills import SKILLS
from beso.envs.kitchen.report import statistics
from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import SPEC, done
from beso.seeding import generator

MODES = [(task, mode) for task, skill in SKILLS.items() for mode in skill.modes]


@pytest.fixture(scope="module")
def env():
    return KitchenEnv()


@pytest.fixture(scope="module")
def demonstrations():
    return [record(0, i) for i in range(6)]


@pytest.mark.parametrize(("task", "mode"), MODES, ids=lambda value: str(value))
def test_every_skill_succeeds_in_every_mode(env, task, mode):
    """Without a mistake: at the second attempt at the latest, and most of the time at the first."""
    attempts = 0
    for i in range(3):
        player = Player(env, generator(1, "test of a skill", task, i))
        assert player.do(task, mode, attempts=2, mistake=np.zeros(3))
        attempts += len(player.modes)
    assert attempts <= 4


def test_there_are_twenty_four_sets_of_four_tasks_in_the_human_order():
    assert len(set(HUMAN_TASK_SETS)) == 24
    assert all(len(tasks) == 4 and list(tasks) == sorted(tasks) for tasks in HUMAN_TASK_SETS)
    drawn = [task_set(0, i) for i in range(2000)]
    counts = [drawn.count(tasks) for tasks in HUMAN_TASK_SETS]
    assert sum(counts) == 2000
    assert min(counts) > 40  # of 83 expected; 4.8 standard deviations


def test_a_demonstration_ends_with_its_four_tasks_done(demonstrations):
    for i, episode in enumerate(demonstrations):
        assert len(episode.actions) == len(episode.observations) <= LIMIT
        assert np.abs(episode.actions).max() <= 1
        dataset = play.assemble([episode, episode], SPEC, {})
        assert dataset.completed(0) == task_set(0, i)
        # Noise of at most 0.01 rad or m hardly moves the distance of 0.3.
        assert set(task_set(0, i)) <= set(np.flatnonzero(done(episode.observations[-1].astype(float))))


def test_a_demonstration_depends_on_its_number_alone(demonstrations):
    record(0, 3)
    again = record(0, 1)
    for name in ("observations", "actions", "tasks"):
        assert getattr(again, name).tobytes() == getattr(demonstrations[1], name).tobytes()
    assert again.failed_takes == demonstrations[1].failed_takes
    assert record(1, 1).actions.tobytes() != again.actions.tobytes()


def test_statistics_say_how_varied_the_demonstrations_are(demonstrations):
    found = statistics(play.assemble(demonstrations, SPEC, {"failed_takes": 2}))
    assert found["share with four tasks"] == 1
    assert 1 < found["different orders of tasks"] <= 6
    assert 130 < found["mean length (steps)"] < 260
    assert found["failed takes"] == 2
