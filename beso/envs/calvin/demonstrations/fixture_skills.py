"""Scripted skills on the fixtures of the table: drawer, door, button and switch.

Waypoints are offsets in metres from the live place of a handle.
"""

from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from beso.envs.calvin.demonstrations.hand import DOWN, Hand, Motion, Place
from beso.envs.calvin.simulator.observations import CLOSE, DRAWER, LED, SLIDE, SWITCH
from beso.envs.calvin.simulator.table import DRAWER_TRAVEL, SLIDE_TRAVEL, SWITCH_TRAVEL

BUTTON_TOP = np.array([-0.12, -0.12, 0.486])
SWITCH_DIRECTION = np.array([0.0, 0.5, 0.866])  # in which its joint grows: upward and away
# A hand that points straight down cannot reach the switch; tilted outward it can.
SWITCH_TILT, SWITCH_YAW = (DOWN[0] - 0.7, DOWN[1]), 2.2
DRAWER_TOUCH: Final = (0.06, 0.0, 0.0)  # m to each side, along a handle, where it can be touched as well
SWITCH_TOUCH: Final = (0.02, 0.0, 0.0)
SLIDE_TOUCH: Final = (0.0, 0.006, 0.0104)  # the bar leans by 60 degrees
BUTTON_TOUCH: Final = (0.01, 0.0, 0.0)
END: Final = 0.01  # m; this near the end of its travel a joint counts as moved


def drawer_handle(drawer: float) -> np.ndarray:
    """Middle of the drawer's handle, (3,) metres, for its joint position."""
    return np.array([0.18, -0.25 - drawer, 0.36])


def slide_handle(slide: float) -> np.ndarray:
    """Middle of the door's handle, (3,) metres, for its joint position."""
    return np.array([0.04 - slide, 0.006, 0.565])


def switch_handle(switch: float) -> np.ndarray:
    """Middle of the switch's bar, (3,) metres, for its joint position."""
    return np.array([0.3, 0.0189, 0.5284]) + SWITCH_DIRECTION * switch


def _from(
    hand: Hand, handle: Callable[[float], np.ndarray], joint: int, touch: tuple[float, float, float]
) -> Callable[[float, float, float], Place]:
    """offset(x, y, z) -> the place at that offset from where the hand believes a handle, wherever it has moved to."""
    shift = hand.mistake + hand.manner.touch * np.array(touch)
    return lambda x, y, z: lambda: handle(hand.joint(joint)) + shift + (x, y, z)


def open_drawer(hand: Hand, amount: float = 0.2) -> Motion:
    """Hook the closed fingers behind the handle and pull the drawer out by `amount`, metres."""
    at = _from(hand, drawer_handle, DRAWER, DRAWER_TOUCH)
    goal = min(DRAWER_TRAVEL - END, hand.joint(DRAWER) + amount)
    hand.grip = CLOSE
    yield from hand.go(at(0, -0.06, 0.16 + hand.manner.height), tolerance=0.03)
    yield from hand.go(at(0, 0.038, 0.10), tolerance=0.015)
    yield from hand.go(at(0, 0.038, 0), tolerance=0.015)
    yield from hand.go(at(0, -0.06, 0), speed=0.6, tolerance=0.005, until=lambda: hand.joint(DRAWER) > goal)
    yield from hand.go(at(0, 0.03, 0.12), tolerance=0.02)


def close_drawer(hand: Hand, amount: float = DRAWER_TRAVEL) -> Motion:
    """Push the drawer's handle in by `amount`, metres."""
    at = _from(hand, drawer_handle, DRAWER, DRAWER_TOUCH)
    goal = max(END, hand.joint(DRAWER) - amount)
    hand.grip = CLOSE
    yield from hand.go(at(0, -0.07, 0.14 + hand.manner.height), tolerance=0.03)
    yield from hand.go(at(0, -0.07, 0.01), tolerance=0.02)
    yield from hand.go(at(0, 0.03, 0.01), speed=0.6, tolerance=0.005, until=lambda: hand.joint(DRAWER) < goal)
    yield from hand.go(at(0, -0.08, 0.06), tolerance=0.03)


def move_slider(hand: Hand, left: bool, amount: float = SLIDE_TRAVEL) -> Motion:
    """Push the door's handle to the left or right by `amount`, metres."""
    at = _from(hand, slide_handle, SLIDE, SLIDE_TOUCH)
    side = 1 if left else -1  # of the handle, on which the hand stands
    start = hand.joint(SLIDE)
    goal = min(SLIDE_TRAVEL - END, start + amount) if left else max(END, start - amount)
    hand.grip = CLOSE
    yield from hand.go(at(0.07 * side, -0.08, 0.04 + hand.manner.height), tolerance=0.03)
    yield from hand.go(at(0.07 * side, -0.005, 0), tolerance=0.02)
    yield from hand.go(
        at(-0.06 * side, -0.005, 0),
        speed=0.6,
        tolerance=0.005,
        limit=70,
        until=lambda: side * (hand.joint(SLIDE) - goal) > 0,
    )
    yield from hand.go(at(0.05 * side, -0.10, 0.04), tolerance=0.03)


def press_button(hand: Hand) -> Motion:
    """Press the button until the led changes, and go straight up: hovering lower would press it again."""
    led = hand.joint(LED)
    top = BUTTON_TOP + hand.mistake + hand.manner.touch * np.array(BUTTON_TOUCH)
    hand.grip = CLOSE
    yield from hand.go(top + (0, 0, 0.08 + hand.manner.height), tolerance=0.02)
    yield from hand.go(top + (0, 0, -0.03), speed=0.5, tolerance=0.003, limit=40, until=lambda: hand.joint(LED) != led)
    yield from hand.go(top + (0, 0, 0.08), tolerance=0.02)


def move_switch(hand: Hand, on: bool) -> Motion:
    """Push the switch's bar up (on) or down (off)."""
    at = _from(hand, switch_handle, SWITCH, SWITCH_TOUCH)
    ways = {  # before the bar, at the bar, through the bar
        True: ((-0.02, -0.08, -0.01), (0, -0.02, -0.035), (0, 0.03, 0.06)),
        False: ((-0.01, -0.05, 0.07), (0, -0.005, 0.045), (0, -0.01, -0.06)),
    }
    before, touch, through = ways[on]
    side, goal = (1, SWITCH_TRAVEL - END) if on else (-1, END)
    turned = partial(hand.go, yaw=SWITCH_YAW, tilt=SWITCH_TILT)
    hand.grip = CLOSE
    yield from turned(at(*before), tolerance=0.03)
    yield from turned(at(*touch), tolerance=0.02)
    yield from turned(at(*through), speed=0.6, tolerance=0.005, until=lambda: side * (hand.joint(SWITCH) - goal) > 0)
    yield from turned(at(-0.03, -0.10, 0.03), tolerance=0.03)
