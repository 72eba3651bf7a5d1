"""Where the blocks are, which of them the hand can get at, and where there is room."""

import math
from typing import Final

import numpy as np

from beso.envs.calvin.demonstrations.fixture_skills import BUTTON_TOP, slide_handle
from beso.envs.calvin.simulator.arm import BASE_POSITION
from beso.envs.calvin.simulator.observations import BLOCKS, DRAWER, SLIDE, block_slice
from beso.envs.calvin.simulator.table import SLIDE_TRAVEL

ON_TABLE, ON_BLOCK, IN_SLIDER, IN_DRAWER, LOST = "table", "block", "slider", "drawer", "lost"

REACH: Final = 0.74  # m from the arm's base, seen from above, at the height from which blocks are grasped
TABLE_LOW, TABLE_HIGH = np.array([0.0, -0.15]), np.array([0.30, -0.05])  # where blocks are put down, centres
BEHIND: Final = 0.075  # m from a block's centre to where a push starts
TURNING_ROOM: Final = 0.085  # m between the centres of a block that is turned and of another
HANDLE_ROOM: Final = (0.15, -0.07)  # |dx| from the door's handle, and y beyond which an upright hand meets it


def place_of(scene: np.ndarray, block: int) -> str:
    """Where a block is: ON_TABLE, ON_BLOCK, IN_SLIDER, IN_DRAWER or LOST."""
    x, y, z = scene[block_slice(block)][:3]
    if z < 0.3 or abs(x) > 0.45:
        return LOST
    if z < 0.43:
        return IN_DRAWER
    if z > 0.48:
        return ON_BLOCK
    return IN_SLIDER if y > 0.03 else ON_TABLE


def others(block: int) -> list[int]:
    """Numbers of the other two blocks."""
    return [other for other in range(len(BLOCKS)) if other != block]


def distance(scene: np.ndarray, block: int, other: int) -> float:
    """Between the centres of two blocks seen from above, metres."""
    a, b = scene[block_slice(block)], scene[block_slice(other)]
    return math.hypot(a[0] - b[0], a[1] - b[1])


def in_reach(x: float, y: float) -> bool:
    """Whether the hand can hover over a place of the table."""
    return math.hypot(x - BASE_POSITION[0], y - BASE_POSITION[1]) < REACH


def covered(scene: np.ndarray, block: int) -> bool:
    """Whether another block stands on this one."""
    height = scene[block_slice(block)][2]
    return any(
        distance(scene, block, other) < 0.06 and scene[block_slice(other)][2] > height + 0.03 for other in others(block)
    )


def free(scene: np.ndarray, block: int) -> bool:
    """Whether the block can be turned without meeting another one."""
    return all(distance(scene, block, other) > TURNING_ROOM for other in others(block))


def below(scene: np.ndarray, block: int) -> int | None:
    """The block that a stacked block stands on."""
    near = [other for other in others(block) if distance(scene, block, other) < 0.04]
    return near[0] if len(near) == 1 else None


def clear_of_handle(scene: np.ndarray, block: int) -> bool:
    """Whether an upright hand over the block does not meet the door's handle."""
    x, y = scene[block_slice(block)][:2]
    across, front = HANDLE_ROOM
    return y < front or abs(x - slide_handle(scene[SLIDE])[0]) > across


def compartment_open(scene: np.ndarray, x: float) -> bool:
    """Whether the door leaves the cabinet open at x, with room for the hand."""
    slide = scene[SLIDE]
    if slide < 0.03:
        return -0.28 < x < -0.2
    return bool(slide > SLIDE_TRAVEL - 0.03 and 0.0 < x < 0.13)


def can_push(scene: np.ndarray, block: int, side: int, distance: float) -> bool:
    """Whether the hand fits behind a block and nothing stands in the way; `side` is the sign of the push along x."""
    x, y = scene[block_slice(block)][:2]
    start, end = x - side * BEHIND, x + side * distance
    if place_of(scene, block) != ON_TABLE or end < TABLE_LOW[0] - 0.04 or not in_reach(end, y) or y > 0:
        return False
    if not in_reach(start, y) or (abs(start - slide_handle(scene[SLIDE])[0]) < 0.1 and y > HANDLE_ROOM[1]):
        return False
    if math.hypot(start - BUTTON_TOP[0], y - BUTTON_TOP[1]) < 0.07:
        return False
    stop = end + side * 0.09  # half a block beyond the pushed one, half the other's
    low, high = sorted((start - side * 0.05, stop))
    return all(
        abs(scene[block_slice(other)][1] - y) > 0.085 or not low < scene[block_slice(other)][0] < high
        for other in others(block)
    )


def can_push_into_drawer(scene: np.ndarray, block: int) -> bool:
    """Whether the drawer is open before a block and the hand fits behind it."""
    x, y = scene[block_slice(block)][:2]
    return bool(
        place_of(scene, block) == ON_TABLE
        and scene[DRAWER] > 0.16
        and 0.07 < x < 0.30
        and y < -0.055
        and (y < -0.1 or clear_of_handle(scene, block))
        and all(
            abs(scene[block_slice(other)][0] - x) > 0.085 or scene[block_slice(other)][1] > y + 0.14
            for other in others(block)
            if place_of(scene, other) in (ON_TABLE, ON_BLOCK)
        )
    )


def free_spot(scene: np.ndarray, block: int, rng: np.random.Generator) -> tuple[float, float] | None:
    """A random place on the table for the held `block`, away from the others; None if none was found."""
    for _ in range(50):
        x, y = rng.uniform(TABLE_LOW, TABLE_HIGH)
        gaps = [math.hypot(x - scene[block_slice(b)][0], y - scene[block_slice(b)][1]) for b in others(block)]
        if min(gaps) > 0.11 and in_reach(x, y):
            return float(x), float(y)
    return None
