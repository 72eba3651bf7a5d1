"""Which episodes policies are evaluated on: single tasks and pairs of tasks, each from one goal image.

The paper evaluates "hard" single tasks and two tasks in a row, "conditioned on goal images outside the training
distribution, that did not contain the end-effector in the correct position". Those episodes were never published. Here
a start state is drawn in which the tasks can be done, scripted skills do them, the arm goes back to its neutral pose,
and what the camera sees then is the goal: a state that can be reached, with the side effects of reaching it.

Trial i asks for task i of the list in the parameters, or for pair i of a fixed list, counted round: of 13 tasks, any 13
successive trials have each once. Start, skills and so the goal depend on evaluation seed, goal set, model seed, i and
the tasks that trial i asks for alone.
"""

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from beso.core.seeding import generator, integer_seed
from beso.envs.calvin.demonstrations.hand import Hand
from beso.envs.calvin.demonstrations.oracle import PLACINGS, perform, prepare, settle
from beso.envs.calvin.demonstrations.placing_skills import neutral
from beso.envs.calvin.demonstrations.repertoire import Skill, with_block, with_free_hand
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.arm import neutral_robot_obs
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.calvin.spec import SPEC
from beso.envs.protocol import Trial, TrialRequest
from beso.errors import UserError
from beso.files import read_json

# Two tasks are of different families, and start with an empty gripper.
FAMILIES: Final = (
    ("open_drawer", "close_drawer"),
    ("move_slider_left", "move_slider_right"),
    ("turn_on_led", "turn_off_led"),
    ("turn_on_lightbulb", "turn_off_lightbulb"),
    ("push_into_drawer", "unstack_block"),
)
MAX_ACTIONS: Final = {"single_tasks": 256, "two_tasks": 300}  # Rosete-Beas et al.'s (2022), whose protocol this is
ATTEMPTS: Final = 100  # at a start state from which the skills do what is wanted, and nothing else


class Made(NamedTuple):
    """A start, (24,) and (15,), from which the wanted tasks were done, and what is seen afterwards."""

    scene_obs: np.ndarray
    robot_obs: np.ndarray
    goal: np.ndarray


def make(request: TrialRequest) -> list[Trial]:
    """The trials asked for. Of the play data only the encoder's description is read: the size of its frames.

    Raises:
        UserError: that description is missing or damaged.
    """
    size, table = frame_size(request.data), PlayTable()
    try:
        return [trial(table, request, number, lambda: table.picture(size)) for number in request.numbers]
    finally:
        table.close()


def frame_size(data: Path) -> int:
    """Height and width of the frames that the encoder takes, pixels. Raises UserError as `make` does."""
    path = data / "encoder.json"
    encoding = read_json(path).get("encoding")
    size = encoding.get("size") if isinstance(encoding, dict) else None
    if not isinstance(size, int) or size < 1:
        raise UserError(f"{path}: encoding.size = {size!r}: must be a whole number of pixels")
    return size


def wanted_tasks(goals: str, number: int, single_tasks: tuple[str, ...]) -> tuple[str, ...]:
    """What trial `number` asks for: one of the single tasks, or two tasks."""
    if goals == "single_tasks":
        return (single_tasks[number % len(single_tasks)],)
    pairs = list(itertools.combinations(FAMILIES, 2))
    turn, pair = divmod(number, len(pairs))
    first, second = pairs[pair]
    kind = (turn + number) % 4  # runs through the four combinations of a pair's tasks, in a different order for each
    return first[kind // 2], second[kind % 2]


def trial(table: PlayTable, request: TrialRequest, number: int, see: Callable[[], np.ndarray]) -> Trial:
    """One trial; `see` gives what its goal holds of the table's state at the end."""
    rng = generator(request.seed, f"calvin trial, {request.goals}", request.model_seed, number)
    wanted = wanted_tasks(request.goals, number, request.tasks)
    attempts = (attempt(table, wanted, rng, see) for _ in range(ATTEMPTS))
    made = next((made for made in attempts if made is not None), None)
    if made is None:
        raise RuntimeError(f"{' and '.join(wanted)} (trial {number}) failed from {ATTEMPTS} start states")
    chosen = tuple(SPEC.tasks.index(task) for task in wanted)
    return Trial(
        seed=integer_seed(request.seed, f"start, {request.goals}", request.model_seed, number),
        options={
            "scene_obs": made.scene_obs,
            "robot_obs": made.robot_obs,
            "tasks": np.isin(np.arange(len(SPEC.tasks)), chosen),
            "goal": made.goal[None],
        },
        tasks=chosen,
        limit=MAX_ACTIONS[request.goals],
        labels={"goal_tasks": " ".join(map(str, chosen))},
    )


def attempt(
    table: PlayTable, wanted: tuple[str, ...], rng: np.random.Generator, see: Callable[[], np.ndarray]
) -> Made | None:
    """Draw a start state and do the wanted tasks from it, in a random order.

    Returns:
        None where a skill failed, where a later task cannot be done, or where the end differs from the start in
        another task than those wanted.
    """
    order = rng.permutation(wanted).tolist()
    hand = Hand(table)
    skill: Skill | None = prepare(table, hand, order[0], rng)
    holds = order[0] in PLACINGS
    scene_obs, robot_obs = table.scene_obs(), table.robot_obs() if holds else neutral_robot_obs()
    # From here on everything happens as it can in an episode, which starts with this reset.
    table.reset(scene_obs, robot_obs)
    start = table.state()
    for task in order:
        if task != order[0]:
            skill = next((s for s in with_free_hand(table.scene_obs(), rng) if s.task == task), None)
        if skill is None or not _do(table, hand, skill, rng):
            return None
    end_scene = table.scene_obs()
    table.reset(end_scene)
    if set(tasks.names_of(tasks.completed(start, table.state()))) != set(wanted):
        return None
    return Made(scene_obs, robot_obs, see())


def _do(table: PlayTable, hand: Hand, skill: Skill, rng: np.random.Generator) -> bool:
    """Carry out a skill, put down what the hand then holds, bring the arm back; whether there was a place for that."""
    perform(table, skill.motion(hand))
    if skill.held is not None:
        put_down = next((s for s in with_block(table.scene_obs(), skill.held, rng) if s.family == "put_on_table"), None)
        if put_down is None:
            return False
        perform(table, put_down.motion(hand))
    perform(table, neutral(hand))
    settle(table, hand)
    return True
