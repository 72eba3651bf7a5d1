"""A snapshot of the table from which tasks are judged: joints, lights, blocks and who touches whom."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

ROBOT: Final = "robot"
TABLE: Final = "table"
FLOOR: Final = "floor"


@dataclass(frozen=True)
class BlockState:
    """One block.

    Attributes:
        position: xyz, metres.
        quaternion: orientation, xyzw.
        velocity: linear xyz in m/s, then angular xyz in rad/s.
        touched: bodies that it touches: ROBOT, TABLE, FLOOR or names of blocks.
        touched_links: links of the table that it touches, such as "plank_link".
    """

    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    velocity: tuple[float, ...]
    touched: frozenset[str]
    touched_links: frozenset[str]

    @property
    def speed(self) -> float:
        """The largest component of its velocity, in m/s and rad/s alike."""
        return float(np.abs(self.velocity).max())


@dataclass(frozen=True)
class TableState:
    """The whole table.

    Attributes:
        slide, drawer: joint positions, metres.
        lightbulb, led: whether they are on.
        blocks: by name.
        touched_by_robot: bodies that the robot touches.
    """

    slide: float
    drawer: float
    lightbulb: bool
    led: bool
    blocks: Mapping[str, BlockState]
    touched_by_robot: frozenset[str]
