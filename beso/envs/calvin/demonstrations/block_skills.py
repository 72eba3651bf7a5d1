"""Scripted skills on blocks where they stand: push, rotate, lift, push into the drawer."""

import math
from functools import partial
from typing import Final

import numpy as np

from beso.envs.calvin.demonstrations.grasps import LEANING, Grasp, find_grasp, grasp_yaw
from beso.envs.calvin.demonstrations.hand import SAFE_HEIGHT, YAW, Hand, Motion
from beso.envs.calvin.demonstrations.layout import BEHIND
from beso.envs.calvin.simulator.observations import CLOSE, OPEN

PUSH_HEIGHT: Final = 0.462  # m, of the finger tips beside a block
PUSH_TOUCH: Final = 0.006  # m from a block's middle, at most, where it is pushed
SLIDER_FRONT: Final = (-0.06, 0.60)  # y and z before the cabinet, from where its floor is reached over the edge


def push(hand: Hand, block: int, right: bool, distance: float = 0.13) -> Motion:
    """Push a block along x by `distance`, metres, with closed fingers."""
    side = 1 if right else -1
    x, y, _ = hand.block(block)[:3]
    y += PUSH_TOUCH * hand.manner.touch
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


def take(hand: Hand, block: int, grasp: Grasp) -> Motion:
    """Close the fingers about a block."""
    x, y, z = hand.block(block)[:3]
    hand.grip = OPEN
    go = partial(hand.go, yaw=grasp.yaw, tilt=grasp.tilt)
    # A leaning hand comes along its own axis.
    back = np.array([0.0, math.tan(grasp.tilt[1]), 1.0]) * (0.08 + hand.manner.height)
    yield from go((x, y, z) + back, tolerance=0.015)
    yield from go((x, y, z), tolerance=0.008, limit=40)
    yield from hand.close()


def lift(hand: Hand, block: int, height: float = 0.1) -> Motion:
    """Grasp a block that stands on the table, on another block or in the drawer, and raise it by `height`, metres."""
    scene = hand.table.scene_obs()
    yield from take(hand, block, find_grasp(scene, block) or Grasp(grasp_yaw(hand.block(block)[5])))
    x, y, z = hand.position
    yield from hand.go((x, y, z + height), yaw=hand.yaw, tilt=hand.tilt, speed=0.5)


def lift_from_slider(hand: Hand, block: int) -> Motion:
    """Lift a block from the cabinet's floor; the hand comes and goes through the opening in front."""
    y, z = SLIDER_FRONT
    grasp = find_grasp(hand.table.scene_obs(), block) or Grasp(grasp_yaw(hand.block(block)[5]), LEANING)
    go = partial(hand.go, yaw=grasp.yaw, tilt=grasp.tilt)
    hand.grip = OPEN
    yield from hand.rise()
    yield from go((hand.block(block)[0], y, z), tolerance=0.03)
    yield from take(hand, block, grasp)
    x, y, z = hand.position
    yield from go((x, y - 0.03, z + 0.07), speed=0.5)


def lift_from_drawer(hand: Hand, block: int) -> Motion:
    """Lift a block out of the drawer."""
    hand.grip = OPEN
    yield from hand.rise()
    scene = hand.table.scene_obs()
    grasp = find_grasp(scene, block) or Grasp(grasp_yaw(hand.block(block)[5]))
    yield from take(hand, block, grasp)
    x, y, z = hand.position
    if grasp.tilt == LEANING:
        yield from hand.go((x, y - 0.04, z + 0.07), yaw=hand.yaw, tilt=hand.tilt, speed=0.5)
    yield from hand.go((x, y - 0.04, z + 0.16), yaw=hand.yaw, tilt=hand.tilt, speed=0.5)


def rotate(hand: Hand, block: int, left: bool, degrees: float = 80.0) -> Motion:
    """Grasp a block, turn it about z while it hovers just above the table, and put it down again."""
    side = 1 if left else -1
    near = YAW - 0.6 * side  # leaves room to turn before the wrist's limit
    yield from take(hand, block, Grasp(grasp_yaw(hand.block(block)[5], near)))
    yaw = hand.yaw
    turned = yaw + side * np.deg2rad(degrees)
    x, y, z = hand.position
    yield from hand.go((x, y, z + 0.012), yaw=yaw, speed=0.3, limit=10)
    yield from hand.go((x, y, z + 0.012), yaw=turned)
    yield from hand.go((x, y, z), yaw=turned, speed=0.3, limit=15)
    yield from hand.open()
    yield from hand.go((x, y, z + 0.1), yaw=turned)


def drop_in_mid_air(hand: Hand) -> Motion:
    """Give up a grasp that missed: open the fingers and rise."""
    yield from hand.open()
    yield from hand.rise(SAFE_HEIGHT)
