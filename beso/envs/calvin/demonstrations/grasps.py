"""How the hand takes hold of a block: which way it is turned, and whether it points straight down or leans.

A hand that points down is 0.2 m wide along the line between its fingers, 0.1 m above their tips. Under the cabinet's
top, next to the door's handle and at the back of the drawer there is no room for it; there the fingers point away from
the person and the hand stays in front.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from beso.envs.calvin.demonstrations.hand import DOWN, YAW
from beso.envs.calvin.demonstrations.layout import (
    IN_DRAWER,
    IN_SLIDER,
    LOST,
    clear_of_handle,
    compartment_open,
    covered,
    in_reach,
    others,
    place_of,
)
from beso.envs.calvin.simulator.observations import BLOCKS, DRAWER, block_slice
from beso.envs.calvin.simulator.table import BLOCK_SIZES

LEANING: Final = (DOWN[0], -0.5)  # tilt of a hand with its fingers pointing down and, at a yaw of pi/2, away
LEANING_TURN: Final = 0.55  # rad from YAW; turned further, a leaning hand leans sideways
WIDEST_GRASP: Final = 0.065  # m; the gripper opens to 0.08
FINGER_PLACE, FINGER_ROOM = 0.05, 0.016  # m, of an open finger from the middle; its half width and a margin
FINGER_SPAN: Final = 0.058  # m from the middle to an open finger's outer side
SLIDER_BACK: Final = 0.112  # y of a block in the cabinet, further than which the hand meets its top
DRAWER_LEFT, DRAWER_RIGHT = 0.06, 0.31  # x between which the drawer has room for fingers
TABLE_EDGE, DRAWER_FRONT = -0.18, -0.157  # y of the table's front edge, and of the closed drawer's front inside
DRAWER_LEANING: Final = -0.175  # y of a block before which a leaning hand clears the table's edge
DRAWER_OPEN: Final = 0.15  # m


@dataclass(frozen=True)
class Grasp:
    """The orientation of a hand about a block: yaw, and tilt (roll, pitch), radians."""

    yaw: float
    tilt: tuple[float, float] = DOWN


def grasp_yaw(yaw: float, near: float = YAW, quarter: bool = False) -> float:
    """The yaw of the hand, nearest to `near`, at which its fingers close on a block of this yaw, radians.

    The fingers close on the block's short sides, or with `quarter` on either pair of sides.
    """
    turns = 4 if quarter else 2
    return near + math.remainder(turns * (yaw - near), 2 * math.pi) / turns


def find_grasp(scene: np.ndarray, block: int) -> Grasp | None:
    """A grasp with which the hand can lift a block from where it is; None if there is none."""
    if place_of(scene, block) == LOST or covered(scene, block):
        return None
    fitting = (grasp for grasp in _grasps(scene, block) if fingers_clear(scene, block, grasp.yaw))
    return next(fitting, None)


def _grasps(scene: np.ndarray, block: int) -> Iterator[Grasp]:
    """Grasps for which the table leaves room, the best first."""
    x, y, _, _, _, yaw = scene[block_slice(block)]
    place = place_of(scene, block)
    fits_either_way = BLOCK_SIZES[BLOCKS[block]][0] < WIDEST_GRASP
    if place == IN_DRAWER:
        if scene[DRAWER] < DRAWER_OPEN or not DRAWER_LEFT < x < DRAWER_RIGHT:
            return
        upright, leaning = True, y < DRAWER_LEANING
    elif place == IN_SLIDER:
        upright, leaning = False, compartment_open(scene, x) and y < SLIDER_BACK
    else:
        if not in_reach(x, y) or y > 0.02:
            return
        upright, leaning = clear_of_handle(scene, block), not clear_of_handle(scene, block)
    if upright:
        for around in (yaw, yaw + math.pi / 2) if fits_either_way else (yaw,):
            hand_yaw = grasp_yaw(around)
            if place != IN_DRAWER or _fits_drawer(y, hand_yaw, scene[DRAWER]):
                yield Grasp(hand_yaw)
    nearest = grasp_yaw(yaw, quarter=fits_either_way)
    if leaning and abs(nearest - YAW) < LEANING_TURN:
        yield Grasp(nearest, LEANING)


def _fits_drawer(y: float, hand_yaw: float, drawer: float) -> bool:
    """Whether both open fingers of an upright hand are between the table's edge and the front of the drawer."""
    span = max(0.01, FINGER_SPAN * abs(math.cos(hand_yaw)))
    return y + span < TABLE_EDGE - 0.005 and y - span > DRAWER_FRONT - drawer + 0.005


def fingers_clear(scene: np.ndarray, block: int, yaw: float) -> bool:
    """Whether no other block is where the open fingers come down about a block at this yaw of the hand."""
    x, y, z = scene[block_slice(block)][:3]
    for other in others(block):
        ox, oy, oz, _, _, other_yaw = scene[block_slice(other)]
        if oz < z - 0.03:
            continue
        length, width, _ = BLOCK_SIZES[BLOCKS[other]]
        for side in (-FINGER_PLACE, FINGER_PLACE):
            dx, dy = x + side * math.sin(yaw) - ox, y - side * math.cos(yaw) - oy
            along = dx * math.cos(other_yaw) + dy * math.sin(other_yaw)
            across = dy * math.cos(other_yaw) - dx * math.sin(other_yaw)
            if abs(along) < length / 2 + FINGER_ROOM and abs(across) < width / 2 + FINGER_ROOM:
                return False
    return True
