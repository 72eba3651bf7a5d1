"""Doing one wanted task with the scripted skills: how goals for policies are made, and how skills are tested."""

from typing import Final

import numpy as np

from beso.envs.calvin.demonstrations.hand import Hand, Motion
from beso.envs.calvin.demonstrations.layout import others
from beso.envs.calvin.demonstrations.placing_skills import drawer_middle
from beso.envs.calvin.demonstrations.player import draw_start
from beso.envs.calvin.demonstrations.repertoire import Skill, with_block, with_free_hand
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import BLOCKS, DRAWER, OPEN, block_slice
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.calvin.simulator.spawn import OPEN_DRAWER

PLACINGS: Final = ("place_in_slider", "place_in_drawer", "stack_block")  # start with a block in the gripper
SETTLE_STEPS: Final = 20
SCENES: Final = 200  # that are tried before giving up
STACKED_HEIGHT, DRAWER_HEIGHT = 0.50, 0.365  # m, of a block's centre


def perform(table: PlayTable, motion: Motion) -> int:
    """Carry out a motion on the table; returns the number of actions."""
    steps = 0
    for action in motion:
        table.step(action)
        steps += 1
    return steps


def settle(table: PlayTable, hand: Hand) -> None:
    """Open the gripper and stay until everything has come to rest."""
    hand.grip = OPEN
    perform(table, hand.wait(SETTLE_STEPS))


def prepare(table: PlayTable, hand: Hand, task: str, rng: np.random.Generator) -> Skill:
    """Reset the table to a random state in which `task` can be done.

    For the tasks of PLACINGS a block then hangs in the gripper.

    Returns:
        The skill that does it, to be performed next.

    Raises:
        ValueError: no such task.
        RuntimeError: no state was found.
    """
    if task not in tasks.TASKS:
        raise ValueError(f"task {task!r} is not one of {', '.join(tasks.NAMES)}")
    for _ in range(SCENES):
        table.reset(_start(task, rng))
        settle(table, hand)
        held = _lift_any(table, hand, rng) if task in PLACINGS else None
        if task in PLACINGS and held is None:
            continue
        scene = table.scene_obs()
        skills = with_free_hand(scene, rng) if held is None else with_block(scene, held, rng)
        fitting = [skill for skill in skills if skill.task == task]
        if fitting:
            return fitting[rng.integers(len(fitting))]
    raise RuntimeError(f"no state to start {task} from in {SCENES} random scenes")


def _start(task: str, rng: np.random.Generator) -> np.ndarray:
    """A scene_obs (24,); blocks that must be stacked or in the drawer are put there, a little above where they rest."""
    scene = draw_start(rng)
    block = int(rng.integers(len(BLOCKS)))
    if task.startswith("lift") and task.endswith("drawer"):
        block = [name.removeprefix("block_") in task for name in BLOCKS].index(True)
        scene[DRAWER] = OPEN_DRAWER
        y = drawer_middle(OPEN_DRAWER) + rng.uniform(-0.02, 0.02)
        scene[block_slice(block)][:3] = rng.uniform(0.1, 0.27), y, DRAWER_HEIGHT
    if task == "unstack_block":
        pose = scene[block_slice(others(block)[0])]
        scene[block_slice(block)] = pose[0], pose[1], STACKED_HEIGHT, 0, 0, pose[5] + rng.uniform(-0.3, 0.3)
    return scene


def _lift_any(table: PlayTable, hand: Hand, rng: np.random.Generator) -> int | None:
    """Lift some block from the table; its number, or None if that did not work."""
    skills = [skill for skill in with_free_hand(table.scene_obs(), rng) if skill.family == "lift_table"]
    if not skills:
        return None
    skill = skills[rng.integers(len(skills))]
    start = table.state()
    perform(table, skill.motion(hand))
    done = skill.task in tasks.names_of(tasks.completed(start, table.state()))
    return skill.held if done else None
