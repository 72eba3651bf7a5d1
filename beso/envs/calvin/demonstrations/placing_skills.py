"""Scripted skills for a block that hangs in the gripper: on the table, on another block, into slider or drawer.

The hand keeps the tilt that it had when it grasped the block, so that the block comes down flat.
"""

from functools import partial
from typing import Final

from beso.envs.calvin.demonstrations.hand import YAW, Hand, Motion
from beso.envs.calvin.simulator.observations import DRAWER, OPEN, SLIDE
from beso.envs.calvin.simulator.table import SLIDE_TRAVEL

CARRYING_HEIGHT: Final = 0.60  # m; a block in the fingers clears those on the table
CLEAR_Y: Final = -0.06  # y before the cabinet
LEFT_COMPARTMENT, RIGHT_COMPARTMENT = -0.24, 0.06  # x of their middles


def open_compartment(slide: float) -> float:
    """x of the middle of the compartment that the door leaves open."""
    return LEFT_COMPARTMENT if slide < SLIDE_TRAVEL / 2 else RIGHT_COMPARTMENT


def drawer_middle(drawer: float) -> float:
    """y of the middle of the part of the drawer that is outside the table."""
    return -(0.18 + 0.157 + drawer) / 2


def carry_clear(hand: Hand) -> Motion:
    """Raise the block, and bring it out of the cabinet if it is there."""
    go = partial(hand.go, tilt=hand.tilt)
    x, y, _ = hand.position
    yield from go((x, y, CARRYING_HEIGHT), yaw=hand.yaw, tolerance=0.02)
    if y > 0:
        yield from go((x, CLEAR_Y, CARRYING_HEIGHT), yaw=hand.yaw, tolerance=0.03)


def put_on_table(hand: Hand, x: float, y: float) -> Motion:
    """Put the block down at (x, y), metres."""
    go = partial(hand.go, tilt=hand.tilt)
    yield from carry_clear(hand)
    yield from go((x, y, 0.56), tolerance=0.015)
    yield from go((x, y, 0.466), speed=0.5, tolerance=0.008, limit=30)
    yield from hand.open()
    yield from go((x, y, 0.57))


def place_in_drawer(hand: Hand, x: float = 0.16) -> Motion:
    """Lower the block into the open drawer at x, metres, and let it go."""
    go = partial(hand.go, tilt=hand.tilt)
    yield from carry_clear(hand)
    y = drawer_middle(hand.joint(DRAWER))
    yield from go((x, y, 0.55 + hand.manner.height), tolerance=0.015)
    yield from go((x, y, 0.385), limit=30)
    yield from hand.open()
    yield from go((x, y, 0.56))


def place_in_slider(hand: Hand) -> Motion:
    """Put the block into the compartment that the door leaves open."""
    go = partial(hand.go, tilt=hand.tilt)
    x = open_compartment(hand.joint(SLIDE))
    yield from carry_clear(hand)
    yield from go((x, -0.05, 0.60), tolerance=0.015)
    yield from go((x, 0.075, 0.56), tolerance=0.015)
    yield from go((x, 0.085, 0.485), limit=30)
    yield from hand.open()
    yield from go((x, 0.06, 0.58), tolerance=0.02)
    yield from go((x, -0.08, 0.60), tolerance=0.03)


def stack(hand: Hand, below: int) -> Motion:
    """Put the block onto another one."""
    go = partial(hand.go, tilt=hand.tilt)
    yield from carry_clear(hand)
    x, y, z = hand.block(below)[:3]
    yaw = hand.yaw
    yield from go((x, y, 0.59 + hand.manner.height), yaw=yaw)
    yield from go((x, y, z + 0.045), yaw=yaw, speed=0.4, tolerance=0.006, limit=30)
    yield from hand.open()
    yield from go((x, y, 0.60), yaw=yaw)


def neutral(hand: Hand) -> Motion:
    """Go back to where episodes start, with an open gripper."""
    yield from hand.rise()
    hand.grip = OPEN
    yield from hand.go((0.026, -0.231, 0.571), yaw=YAW, tolerance=0.02)
