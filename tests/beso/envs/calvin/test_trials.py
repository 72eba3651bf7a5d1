"""Trials ask for their tasks, can be done from their start, and depend on nothing but their names."""

import itertools
import json

import numpy as np
import pytest

from beso import envs
from beso.envs.calvin import evaluation, trials
from beso.envs.calvin.demonstrations.hand import Hand
from beso.envs.calvin.demonstrations.oracle import PLACINGS
from beso.envs.calvin.demonstrations.placing_skills import neutral
from beso.envs.calvin.demonstrations.repertoire import with_block, with_free_hand
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import BLOCKS, CLOSE, GRIPPER_COMMAND, OPEN
from beso.envs.calvin.spec import SPEC
from beso.envs.protocol import TrialRequest
from beso.errors import UserError
from pipeline import profile
from pipeline.machine import Machine
from pipeline.pool import map_jobs

SIZE = 112
PAIRS = 3
# The paper profile's; and two of the tasks that other lists may have.
PAPER_TASKS = profile.load("paper").environments["calvin"].evaluation.tasks
SINGLE_TASKS = (*PAPER_TASKS, "push_blue_block_left", "rotate_pink_block_right")


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Play data as far as trials read them."""
    folder = tmp_path_factory.mktemp("data")
    (folder / "encoder.json").write_text(json.dumps({"encoding": {"size": SIZE}}))
    return folder


@pytest.fixture(scope="module")
def request_for(data):
    def request(goals, numbers, model_seed=1):
        return TrialRequest(goals, model_seed, numbers, 1000, data, 0.95, 0, SINGLE_TASKS)

    return request


@pytest.fixture(scope="module")
def made(request_for):
    """Each single task once, and some pairs."""
    return {
        "single_tasks": trials.make(request_for("single_tasks", range(len(SINGLE_TASKS)))),
        "two_tasks": trials.make(request_for("two_tasks", range(PAIRS))),
    }


@pytest.fixture(scope="module")
def environment():
    environment = evaluation.make()
    yield environment
    environment.close()


def do(environment, task, rng):
    """Steps of a scripted skill from the environment's state; the last answer, or None where it cannot be done."""
    table, hand, scene = environment.table, Hand(environment.table), environment.table.scene_obs()
    holds = task in PLACINGS
    held = [BLOCKS.index(block) for block in table.state().touched_by_robot]
    hand.grip = CLOSE if holds else OPEN
    drawn = [
        skill for _ in range(5) for skill in (with_block(scene, *held, rng) if holds else with_free_hand(scene, rng))
    ]
    skill = next((skill for skill in drawn if skill.task == task), None)
    answer = None
    for action in itertools.chain(skill.motion(hand), neutral(hand)) if skill else ():
        answer = environment.step(action)
        if answer[2]:
            break
    return answer


@pytest.mark.parametrize("number", range(len(SINGLE_TASKS)))
def test_a_single_task_can_be_done_from_its_start(made, environment, number):
    trial, task = made["single_tasks"][number], SINGLE_TASKS[number]
    assert trial.tasks == (SPEC.tasks.index(task),)
    assert trial.limit == 256
    start, info = environment.reset(seed=trial.seed, options=trial.options)
    assert start.shape == (SIZE, SIZE, 3)
    assert info["tasks"] == ()
    goal = info["goal"]
    assert goal.shape == (1, SIZE, SIZE, 3)
    assert goal.dtype == np.uint8
    assert (np.abs(goal[0].astype(int) - start).max(axis=2) > 30).sum() > 10, "the goal looks like the start"
    _, reward, terminated, _, info = do(environment, task, np.random.default_rng(number))
    assert (reward, terminated, info["tasks"]) == (1.0, True, trial.tasks)


@pytest.mark.parametrize("number", range(PAIRS))
def test_two_tasks_can_be_done_from_their_start(made, environment, number):
    trial = made["two_tasks"][number]
    assert trial.limit == 300
    names = [SPEC.tasks[task] for task in trial.tasks]
    for order in (names, names[::-1]):
        environment.reset(seed=trial.seed, options=trial.options)
        answers = [do(environment, task, np.random.default_rng(number)) for task in order]
        if answers[-1] is not None and answers[-1][2]:
            assert not answers[0][2], "one task is half of what is wanted"
            assert set(answers[-1][4]["tasks"]) == set(trial.tasks)
            return
    pytest.fail(f"{names} could not be done in either order")


def test_the_arm_starts_at_its_neutral_pose_unless_it_holds_a_block(made, environment):
    for trial, task in zip(made["single_tasks"], SINGLE_TASKS, strict=True):
        _, info = environment.reset(options=trial.options)
        holds = task in PLACINGS
        assert (trial.options["robot_obs"][GRIPPER_COMMAND] == CLOSE) == holds
        assert len(info["state"].touched_by_robot) == holds


def assert_same(ours, theirs):
    assert (ours.seed, ours.tasks, ours.limit, ours.labels) == (theirs.seed, theirs.tasks, theirs.limit, theirs.labels)
    for name, array in theirs.options.items():
        assert np.array_equal(ours.options[name], array), name


def test_a_trial_depends_on_its_own_name_alone(made, request_for):
    """Neither on the trials made before it, nor on the process."""
    jobs = [(request_for("single_tasks", range(3, 5)),), (request_for("two_tasks", range(1, 2)),)]
    one, two = map_jobs(trials.make, jobs, Machine(workers=2))
    for ours, theirs in zip([*one, *two], [*made["single_tasks"][3:5], made["two_tasks"][1]], strict=True):
        assert_same(ours, theirs)
    (other,) = trials.make(request_for("single_tasks", range(3, 4), model_seed=2))
    assert not np.array_equal(other.options["scene_obs"], one[0].options["scene_obs"])
    assert not np.array_equal(other.options["goal"], one[0].options["goal"])


def test_tasks_are_balanced():
    singles = [trials.wanted_tasks("single_tasks", i, PAPER_TASKS) for i in range(5, 18)]
    assert sorted(singles) == sorted((task,) for task in PAPER_TASKS)
    pairs = [trials.wanted_tasks("two_tasks", i, ()) for i in range(40)]
    assert len(set(pairs)) == 40
    family = {task: number for number, members in enumerate(trials.FAMILIES) for task in members}
    assert all(family[first] != family[second] for first, second in pairs)
    assert len({(family[first], family[second]) for first, second in pairs[:10]}) == 10
    assert trials.wanted_tasks("two_tasks", 47, ()) == pairs[7]


def test_the_specs_tasks_are_those_that_are_judged():
    assert SPEC.tasks == tasks.NAMES
    assert envs.spec("calvin").goal_sets == tuple(trials.MAX_ACTIONS)
    assert len(envs.single_tasks("calvin")) == 34 - 9, "all but lifts"


def test_the_papers_single_tasks_are_those_without_a_colour():
    colours = ("red", "blue", "pink")
    assert set(PAPER_TASKS) == {task for task in SPEC.tasks if not any(colour in task for colour in colours)}
    assert len(PAPER_TASKS) == 13


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (None, r"encoder\.json is missing"),
        ("{", r"encoder\.json is damaged"),
        ("{}", r"encoding\.size = None: must be a whole number of pixels"),
        ('{"encoding": {"size": 0}}', r"encoding\.size = 0: must be"),
    ],
)
def test_without_the_frames_size_there_are_no_trials(tmp_path, request_for, text, message):
    if text is not None:
        (tmp_path / "encoder.json").write_text(text)
    with pytest.raises(UserError, match=message):
        trials.make(request_for("single_tasks", range(1))._replace(data=tmp_path))
