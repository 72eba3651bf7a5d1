"""CALVIN's 34 tasks: changes between two states of the table, judged by the published criteria.

A task is a predicate over the state at its start and the state now; several may hold at once. The criteria are those
of github.com/mees/calvin (`new_playtable_tasks.yaml`), and what github.com/mees/calvin_env (`tasks.py`, 797142c) does;
docs/fidelity.md tells where that differs from what it says. Lengths are metres, angles degrees; "right" is towards
positive x and, of rotations, clockwise from above.
"""

import math
from collections.abc import Callable, Mapping
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np

from beso.envs.calvin.simulator.observations import BLOCKS
from beso.envs.calvin.simulator.state import ROBOT, TABLE, BlockState, TableState

Predicate = Callable[[TableState, TableState], bool]

ROTATION, TILT, ROTATION_SHIFT = 60.0, 30.0, 0.1  # degrees about z at least, about x and y at most; metres at most
PUSH, DOOR, DRAWER = 0.1, 0.15, 0.12
LIFTS: Final = {"table": ("base_link", 0.05), "slider": ("plank_link", 0.03), "drawer": ("drawer_link", 0.05)}
RESTING_SPEED: Final = 1.0  # m/s and rad/s


def rotated(block: str, degrees: float, start: TableState, end: TableState) -> bool:
    """The block turned by more than `degrees` (its sign is the direction) about z, not lifted, hardly moved."""
    before, after = start.blocks[block], end.blocks[block]
    if math.dist(before.position, after.position) > ROTATION_SHIFT or not after.touched - {ROBOT}:
        return False
    x, y, z = turn(before.quaternion, after.quaternion)
    return math.copysign(1, degrees) * z > abs(degrees) and abs(x) < TILT and abs(y) < TILT


def pushed(block: str, distance: float, start: TableState, end: TableState) -> bool:
    """The block moved by more than `distance` (its sign is the direction) along x and still touches what it touched."""
    before, after = start.blocks[block], end.blocks[block]
    support = _contacts(before)
    if not support or not support <= _contacts(after):
        return False
    return math.copysign(1, distance) * (after.position[0] - before.position[0]) > abs(distance)


def lifted(block: str, link: str, height: float, start: TableState, end: TableState) -> bool:
    """The block touched `link` of the table and hangs in the gripper, more than `height` higher.

    The robot may touch the block at the start.
    """
    before, after = start.blocks[block], end.blocks[block]
    return after.position[2] - before.position[2] > height and after.touched == {ROBOT} and link in before.touched_links


def placed(link: str, start: TableState, end: TableState) -> bool:
    """The block that hung in the gripper lies on `link` of the table and is let go."""
    if len(start.touched_by_robot) != 1:
        return False
    (block,) = start.touched_by_robot
    if block not in start.blocks or block in end.touched_by_robot:
        return False
    return start.blocks[block].touched == {ROBOT} and link in end.blocks[block].touched_links


def pushed_into(source: str, target: str, start: TableState, end: TableState) -> bool:
    """Some block touched link `source` of the table and nothing else, and touches link `target`.

    The robot may touch the block at the end.
    """
    return any(
        before.touched == {TABLE} and before.touched_links == {source} and target in end.blocks[name].touched_links
        for name, before in start.blocks.items()
    )


def moved(joint: str, distance: float, start: TableState, end: TableState) -> bool:
    """A joint of the table moved by more than `distance` (its sign is the direction)."""
    return math.copysign(1, distance) * (getattr(end, joint) - getattr(start, joint)) > abs(distance)


def switched(light: str, on: bool, start: TableState, end: TableState) -> bool:
    """A light came to be `on`, or off."""
    return getattr(start, light) is not on and getattr(end, light) is on


def stacked(start: TableState, end: TableState) -> bool:
    """Some block touched no other and rests on nothing but others, at rest."""
    return any(not start.blocks[name].touched & set(BLOCKS) and _rests_on_blocks(end, name) for name in start.blocks)


def unstacked(start: TableState, end: TableState) -> bool:
    """Some block rested on nothing but others, and touches none of them."""
    return any(_rests_on_blocks(start, name) and not end.blocks[name].touched & set(BLOCKS) for name in start.blocks)


def _contacts(block: BlockState) -> frozenset[str]:
    """Whatever touches the block but the robot, each link of the table by itself."""
    return (block.touched - {ROBOT, TABLE}) | block.touched_links


def _rests_on_blocks(state: TableState, name: str) -> bool:
    block = state.blocks[name]
    return bool(block.touched) and block.touched <= set(BLOCKS) and block.speed < RESTING_SPEED


def turn(before: tuple[float, ...], after: tuple[float, ...]) -> tuple[float, float, float]:
    """The rotation from one orientation (quaternion xyzw) to another, as angles about the world's x, y, z, degrees."""
    x1, y1, z1, w1 = before
    x2, y2, z2, w2 = after
    # after * conjugate(before)
    w = w2 * w1 + x2 * x1 + y2 * y1 + z2 * z1
    x = -w2 * x1 + x2 * w1 - y2 * z1 + z2 * y1
    y = -w2 * y1 + x2 * z1 + y2 * w1 - z2 * x1
    z = -w2 * z1 - x2 * y1 + y2 * x1 + z2 * w1
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(max(-1.0, min(1.0, 2 * (w * y - z * x))))
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return math.degrees(roll), math.degrees(pitch), math.degrees(yaw)


def _tasks() -> dict[str, Predicate]:
    tasks: dict[str, Predicate] = {}
    colours = {name.removeprefix("block_"): name for name in BLOCKS}
    for colour, block in colours.items():
        tasks[f"rotate_{colour}_block_right"] = partial(rotated, block, -ROTATION)
        tasks[f"rotate_{colour}_block_left"] = partial(rotated, block, ROTATION)
    for colour, block in colours.items():
        tasks[f"push_{colour}_block_right"] = partial(pushed, block, PUSH)
        tasks[f"push_{colour}_block_left"] = partial(pushed, block, -PUSH)
    tasks["move_slider_left"] = partial(moved, "slide", DOOR)
    tasks["move_slider_right"] = partial(moved, "slide", -DOOR)
    tasks["open_drawer"] = partial(moved, "drawer", DRAWER)
    tasks["close_drawer"] = partial(moved, "drawer", -DRAWER)
    for colour, block in colours.items():
        for place, (link, height) in LIFTS.items():
            tasks[f"lift_{colour}_block_{place}"] = partial(lifted, block, link, height)
    tasks["place_in_slider"] = partial(placed, "plank_link")
    tasks["place_in_drawer"] = partial(placed, "drawer_link")
    tasks["stack_block"] = stacked
    tasks["unstack_block"] = unstacked
    for light in ("lightbulb", "led"):
        tasks[f"turn_on_{light}"] = partial(switched, light, True)
        tasks[f"turn_off_{light}"] = partial(switched, light, False)
    tasks["push_into_drawer"] = partial(pushed_into, "base_link", "drawer_link")
    return tasks


TASKS: Final[Mapping[str, Predicate]] = MappingProxyType(_tasks())  # in CALVIN's order
NAMES: Final = tuple(TASKS)


def completed(start: TableState, end: TableState) -> np.ndarray:
    """Which tasks hold between two states, (34,) booleans in the order of NAMES."""
    return np.array([done(start, end) for done in TASKS.values()])


def names_of(done: np.ndarray) -> tuple[str, ...]:
    """Names of the tasks that are set in `done` (34,)."""
    return tuple(name for name, holds in zip(NAMES, done, strict=True) if holds)
