import numpy as np
import pytest

from beso.core.seeding import generator
from beso.data import play
from beso.envs.kitchen import spec
from beso.envs.kitchen.demonstrations import scripted
from beso.envs.kitchen.demonstrations.player import LARGEST_TREMOR, LIMIT, Player
from beso.envs.kitchen.demonstrations.scripted import HUMAN_TASK_SETS, record, task_set
from beso.envs.kitchen.demonstrations.skills import SKILLS
from beso.envs.kitchen.report import statistics
from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import SPEC, done

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


def test_what_is_recorded_is_wanted_and_what_is_done_is_disturbed(env, monkeypatch):
    done = []
    step = env.step
    monkeypatch.setattr(env, "step", lambda action: done.append(action) or step(action))
    player = Player(env, generator(1, "test of the tremor"))
    player.do(spec.SLIDE_CABINET)
    tremor = np.array(done) - np.array(player.actions)
    free = np.abs(done) < 1  # the others are clipped
    assert not tremor[:, 7:].any()
    assert 0.01 < tremor[:, :7][free[:, :7]].std() < LARGEST_TREMOR
    assert np.corrcoef(tremor[1:, 0], tremor[:-1, 0])[0, 1] > 0.3


def test_a_mistake_is_made_good(env):
    player = Player(env, generator(1, "test of a mistake"))
    assert player.do(spec.BOTTOM_BURNER, "middle", mistake=np.array([0.0, -0.08, 0.0]))
    assert len(player.modes) == 2


def test_the_filmed_demonstration_has_a_failed_attempt_made_good(env):
    index, take = scripted.filmed(0)
    player, taken = scripted.play(env, 0, index)
    assert taken == take
    assert player.completed == task_set(0, index)
    assert [task for task, _ in player.modes[:2]] == [spec.MICROWAVE] * 2
    assert player.made_good[0] == spec.MICROWAVE


def test_a_quarter_of_the_first_attempts_begin_with_a_mistake(env):
    player = Player(env, generator(1, "test of mistakes"))
    lengths = np.array([np.linalg.norm(player._mistake()) for _ in range(400)])
    made = lengths > 0
    assert 0.15 < made.mean() < 0.35  # 4.6 standard deviations
    assert lengths[made].min() >= 0.02
    assert lengths[made].max() <= 0.04


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


def test_statistics_of_actions():
    """Of one joint that goes from end to end; differences do not cross from one demonstration to the next."""
    actions = np.zeros((4, 9))
    actions[:, 0] = [-1, 1, -1, 1]
    actions[:, 8] = 1  # a finger
    tasks = np.zeros((4, 7), dtype=np.uint8)
    found = statistics(play.assemble([play.Episode(np.zeros((4, 30)), actions, tasks)] * 2, SPEC, {}))
    assert found["mean action of an arm joint"] == pytest.approx(1 / 7)
    assert found["share of steps with a joint at full speed"] == 1
    assert found["change of actions (rms)"] == pytest.approx(2 / 7**0.5)
    assert found["change of that change (rms)"] == pytest.approx(4 / 7**0.5)
