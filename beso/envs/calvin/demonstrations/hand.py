"""A hand that walks between waypoints: the controller under all scripted skills.

A skill is a generator of actions (7,). Whoever plays it carries out each action before asking for the next one, so
that the skill sees the table as it has become.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from beso.envs.calvin.simulator.arm import ANGLE_STEP, POSITION_STEP
from beso.envs.calvin.simulator.observations import (
    CLOSE,
    GRIPPER_WIDTH,
    OPEN,
    TCP_EULER,
    TCP_POSITION,
    block_slice,
    wrap,
)
from beso.envs.calvin.simulator.play_table import PlayTable

Motion = Iterator[np.ndarray]
Place = Callable[[], np.ndarray]  # a waypoint that may move while the hand is on its way, (3,) metres

DOWN: Final = (np.pi, 0.0)  # roll and pitch of a hand that points down
YAW: Final = 1.5  # of the neutral pose: the fingers open along x
FINGER_STEPS: Final = 8  # within which the fingers have come to a stop
STOPPED: Final = 0.001  # m; change of the gripper's width in a step
BOWED: Final = 0.1  # m; a way that is longer, seen from above, is bowed
PATIENCE: Final = 8  # steps for which a hand that was sent as far as its waypoint may stay away from it
SAFE_HEIGHT: Final = 0.58  # m; above everything that stands on the table


@dataclass(frozen=True)
class Manner:
    """How a hand moves.

    Attributes:
        pace: factor on speeds.
        height: m, added to the heights at which it hovers.
        bow: by how much of the way that is left it aims to the side of it, and above it, while that is long.
        touch: where along a thing it is touched, from -1 to 1.
    """

    pace: float = 1.0
    height: float = 0.0
    bow: tuple[float, float] = (0.0, 0.0)
    touch: float = 0.0

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "Manner":
        """A manner as different people have it."""
        bow = rng.uniform(-0.4, 0.4), rng.uniform(0.0, 0.3)
        return cls(rng.uniform(0.5, 1.5), rng.uniform(0.0, 0.03), bow, rng.uniform(-1.0, 1.0))


class Hand:
    """The arm of a table, led by waypoints.

    Args:
        table: the table, which someone else steps.
        manner: how it moves; may be replaced between skills.

    Attributes:
        mistake: metres (3,) from each thing to where the hand takes it to be; may be replaced between skills.
    """

    def __init__(self, table: PlayTable, manner: Manner | None = None) -> None:
        self.table = table
        self.manner = manner or Manner()
        self.mistake = np.zeros(3)
        self.grip = OPEN

    @property
    def position(self) -> np.ndarray:
        """Where the tcp is, (3,) metres."""
        return self.table.robot_obs()[TCP_POSITION]

    @property
    def yaw(self) -> float:
        """The yaw that the hand is told to have, radians."""
        return float(self.table.arm.target_euler[2])

    @property
    def tilt(self) -> tuple[float, float]:
        """The roll and pitch that the hand is told to have, radians."""
        roll, pitch, _ = self.table.arm.target_euler
        return float(roll), float(pitch)

    def joint(self, index: int) -> float:
        """An entry of the scene: SLIDE, DRAWER, ..., LED."""
        return float(self.table.fixtures.observation()[index])

    def block(self, block: int) -> np.ndarray:
        """Pose of a block as the hand believes it: xyz and euler xyz, (6,)."""
        pose = self.table.scene_obs()[block_slice(block)]
        pose[:3] += self.mistake
        return pose

    def close(self) -> Motion:
        """Close the gripper where it is."""
        self.grip = CLOSE
        yield from self._move_fingers()

    def open(self) -> Motion:
        """Open the gripper where it is."""
        self.grip = OPEN
        yield from self._move_fingers()

    def _move_fingers(self) -> Motion:
        """Wait until the fingers have come to a stop."""
        width = np.inf
        for action in self.wait(FINGER_STEPS):
            yield action
            before, width = width, self.table.robot_obs()[GRIPPER_WIDTH]
            if abs(width - before) < STOPPED:
                return

    def wait(self, steps: int) -> Motion:
        """Stay here, and come back if moved."""
        place, angles = self.table.arm.target_position, self.table.arm.target_euler
        for _ in range(steps):
            yield self._action(place, angles)

    def rise(self, height: float = SAFE_HEIGHT) -> Motion:
        """Go straight up to `height`, metres, if the hand is lower."""
        x, y, z = self.position
        yield from self.go((x, y, max(z, height)), yaw=self.yaw, tolerance=0.02)

    def go(
        self,
        place: Place | tuple[float, ...] | np.ndarray,
        yaw: float = YAW,
        tilt: tuple[float, float] = DOWN,
        speed: float = 0.8,
        tolerance: float = 0.01,
        limit: int = 60,
        until: Callable[[], bool] | None = None,
    ) -> Motion:
        """Move to a waypoint, and give up where something stops the hand.

        Args:
            place: where to, fixed or moving, xyz in metres.
            yaw, tilt: orientation to have there, radians.
            speed: largest component of the actions' translation, at most 1, at a pace of 1.
            tolerance: metres from the waypoint at which the hand has arrived, if it is turned to within 0.1 rad.
            limit: the hand gives up after as many steps at a pace of 1.
            until: the motion also ends when this is true after an action.
        """
        target = place if callable(place) else (lambda: np.asarray(place))
        wanted = np.array([*tilt, yaw])
        speed = min(1.0, speed * self.manner.pace)
        late = 0
        for _ in range(round(limit / min(1.0, self.manner.pace))):
            yield self._action(self._bowed(target()) if until is None else target(), wanted, speed)
            if until is not None and until():
                return
            robot = self.table.robot_obs()
            turned = abs(wrap(robot[TCP_EULER][2] - yaw)) < 0.1
            if turned and np.linalg.norm(robot[TCP_POSITION] - target()) < tolerance:
                return
            late += bool(np.abs(self.table.arm.target_position - target()).max() < POSITION_STEP)
            if turned and late > PATIENCE:
                return

    def _bowed(self, place: np.ndarray) -> np.ndarray:
        """Where to aim in order to come to a place in the hand's manner, (3,) metres."""
        way = place - self.table.arm.target_position
        length = np.hypot(way[0], way[1])
        if length < BOWED:
            return place
        side, up = self.manner.bow
        return place + (-side * way[1], side * way[0], up * length)

    def _action(self, place: np.ndarray, angles: np.ndarray, speed: float = 1.0) -> np.ndarray:
        """The action (7,) that brings the hand closer to xyz `place` and euler xyz `angles`."""
        shift = (place - self.table.arm.target_position) / POSITION_STEP
        shift = shift * min(1.0, speed / max(np.abs(shift).max(), 1e-9))
        turn = angles - self.table.arm.target_euler
        # Yaw is not wrapped: the shorter way round would run the wrist into its limit.
        turn[:2] = wrap(turn[:2])
        return np.array([*shift, *np.clip(turn / ANGLE_STEP, -1, 1), self.grip])
