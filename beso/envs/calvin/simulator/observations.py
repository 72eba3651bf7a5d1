"""Where things stand in the two state vectors, in the order of the published data set (Mees et al. 2022).

robot_obs, 15 numbers (metres, radians):

    0-2 tcp xyz    3-5 tcp euler xyz    6 width of the gripper    7-13 arm joints    14 last gripper command, +1 or -1

scene_obs, 24 numbers:

    0 slide    1 drawer    2 button    3 switch (joint positions, metres)    4 lightbulb    5 led (0 or 1)
    6-11 red block    12-17 blue block    18-23 pink block (xyz, euler xyz)

The tcp (tool centre point) lies between the finger tips.
"""

from typing import Final

import numpy as np

ROBOT_SIZE: Final = 15
TCP_POSITION, TCP_EULER = slice(0, 3), slice(3, 6)
GRIPPER_WIDTH: Final = 6
ARM_JOINTS = slice(7, 14)
GRIPPER_COMMAND: Final = 14

SCENE_SIZE: Final = 24
SLIDE, DRAWER, BUTTON, SWITCH, LIGHTBULB, LED = range(6)
FIXTURES = slice(0, 6)
BLOCKS: Final = ("block_red", "block_blue", "block_pink")

ACTION_SIZE: Final = 7
OPEN, CLOSE = 1.0, -1.0  # gripper commands


def block_slice(block: int) -> slice:
    """Where block number `block` of BLOCKS stands in scene_obs: xyz, euler xyz."""
    return slice(6 + 6 * block, 12 + 6 * block)


def wrap(angle: np.ndarray) -> np.ndarray:
    """Angles, radians, brought into [-pi, pi)."""
    return (angle + np.pi) % (2 * np.pi) - np.pi
