"""Scripted skills on blocks where they stand: push, rotate, lift, push into the drawer."""

import math
from typing import Final

import numpy as np

from beso.envs.calvin.demonstrations.hand import DOWN, SAFE_HEIGHT, YAW, Hand, Motion
from beso.envs.calvin.observations import BLOCKS, CLOSE, OPEN
from beso.envs.calvin.simulator.table import BLOCK_SIZES

PUSH_HEIGHT: Final = 0.462  # m, of the finger tips beside a block
BEHIND: Final = 0.075  # m from a block's centre to where a push starts
WIDEST_GRASP: Final = 0.065  # m; the gripper opens to 0.08
# Fingers that point away under the cabinet's top; a hand that points down would need 0.1 m of room on either side.
SLIDER_TILT: Final = (DOWN[0], -0.5)
SLIDER_FRONT: Final = (-0.06, 0.60)  # y and z before the cabinet, from where its floor is reached over the edge


def push(hand: Hand, block: int, right: bool, distance: float = 0.13) -> Motion:
    """Push a block along x by `distance`, metres, with closed fingers."""
    side = 1 if right else -1
    x, y, _ = hand.block(block)[:3]
    hand.grip = CLOSE
    yield from hand.go((x - BEHIND * side, y, 0.55 + hand.manner.height), tolerance=0.02)
    yield from hand.go((x - BEHIND * side, y, PUSH_HEIGHT))
    yield from hand.go(
        (x + (distance - 0.02) * side, y, PUSH_HEIGHT),
        speed=0.5,
        tolerance=0.005,
        limit=70,
        until=lambda: (hand.block(block)[0] - x) * side > distance,
    )
    yield from hand.rise(0.55)


def push_into_drawer(hand: Hand, block: int) -> Motion:
    """Push a block over the table's front edge; the drawer must be open below."""
    x, y, _ = hand.block(block)[:3]
    hand.grip = CLOSE
    yield from hand.go((x, y + 0.07, 0.55 + hand.manner.height), tolerance=0.02)
    yield from hand.go((x, y + 0.07, PUSH_HEIGHT), limit=40)
    yield from hand.go(
        (x, -0.215, PUSH_HEIGHT), speed=0.5, tolerance=0.005, limit=70, until=lambda: hand.block(block)[2] < 0.42
    )
    yield from hand.rise(0.56)


def grasp_yaw(yaw: float, near: float = YAW, quarter: bool = False) -> float:
    """The yaw of the hand, nearest to `near`, at which its fingers close on a block of this yaw, radians.

    The fingers close on the block's short sides, or with `quarter` on either pair of sides.
    """
    turns = 4 if quarter else 2
    return near + math.remainder(turns * (yaw - near), 2 * math.pi) / turns


def slider_grasp_yaw(block: int, yaw: float) -> float:
    """The same in the cabinet, where the hand has room along x alone: blocks that fit are gripped by either sides."""
    return grasp_yaw(yaw, quarter=BLOCK_SIZES[BLOCKS[block]][0] < WIDEST_GRASP)


def grasp(hand: Hand, block: int, yaw: float, tilt: tuple[float, float] = DOWN) -> Motion:
    """Close the fingers about a block."""
    x, y, z = hand.block(block)[:3]
    hand.grip = OPEN
    # A tilted hand comes and goes along its own axis.
    back = np.array([0.0, math.tan(tilt[1]), 1.0]) * (0.08 + hand.manner.height)
    yield from hand.go((x, y, z) + back, yaw=yaw, tilt=tilt, tolerance=0.015)
    yield from hand.go((x, y, z), yaw=yaw, tilt=tilt, tolerance=0.008, limit=40)
    yield from hand.close()


def lift(hand: Hand, block: int, height: float = 0.1) -> Motion:
    """Grasp a block that stands free above and raise it by `height`, metres."""
    yield from grasp(hand, block, grasp_yaw(hand.block(block)[5]))
    x, y, z = hand.position
    yield from hand.go((x, y, z + height), yaw=hand.yaw, speed=0.5)


def lift_from_slider(hand: Hand, block: int) -> Motion:
    """Lift a block from the cabinet's floor; the hand comes and goes through the opening in front."""
    y, z = SLIDER_FRONT
    yaw = slider_grasp_yaw(block, hand.block(block)[5])
    hand.grip = OPEN
    yield from hand.rise()
    yield from hand.go((hand.block(block)[0], y, z), yaw=yaw, tilt=SLIDER_TILT, tolerance=0.03)
    yield from grasp(hand, block, yaw, SLIDER_TILT)
    x, y, z = hand.position
    yield from hand.go((x, y - 0.03, z + 0.07), yaw=yaw, tilt=SLIDER_TILT, speed=0.5)


def lift_from_drawer(hand: Hand, block: int) -> Motion:
    """Lift a block out of the drawer."""
    hand.grip = OPEN
    yield from hand.rise()
    yield from lift(hand, block, 0.16)


def rotate(hand: Hand, block: int, left: bool, degrees: float = 80.0) -> Motion:
    """Grasp a block, turn it about z while it hovers just above the table, and put it down again."""
    side = 1 if left else -1
    near = YAW - 0.6 * side  # leaves room to turn before the wrist's limit
    yield from grasp(hand, block, grasp_yaw(hand.block(block)[5], near))
    yaw = hand.yaw
    turned = yaw + side * np.deg2rad(degrees)
    x, y, z = hand.position
    yield from hand.go((x, y, z + 0.012), yaw=yaw, speed=0.3, limit=10)
    yield from hand.go((x, y, z + 0.012), yaw=turned)
    yield from hand.go((x, y, z), yaw=turned, speed=0.3, limit=15)
    yield from hand.open(5)
    yield from hand.go((x, y, z + 0.1), yaw=turned)


def drop_in_mid_air(hand: Hand) -> Motion:
    """Give up a grasp that missed: open the fingers and rise."""
    yield from hand.open(4)
    yield from hand.rise(SAFE_HEIGHT)
