"""What a skill is made of: stretches of movement towards a pose that may depend on the state of the kitchen."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beso.envs.kitchen.demonstrations.controller import Arm, Pose
from beso.envs.kitchen.simulator import KitchenEnv

OPEN, CLOSED = 0.04, 0.0  # m, each finger's distance from the middle
ANY = np.inf  # a tolerance


class Scene:
    """What a skill may look at: the state of a kitchen.

    Attributes:
        mistake: metres (3,) from where marked points are to where they are believed to be.
    """

    def __init__(self, env: KitchenEnv) -> None:
        self._data = env.data
        self.mistake = np.zeros(3)
        self.arm = Arm(env.model, env.data)

    def hand(self) -> Pose:
        """The pose of the hand."""
        return self.arm.pose()

    def site(self, name: str) -> np.ndarray:
        """Where a marked point is believed to be (3,), metres."""
        return np.asarray(self._data.site(name).xpos + self.mistake)

    def body(self, name: str) -> Pose:
        """The pose of a body."""
        body = self._data.body(name)
        return Pose(body.xpos.copy(), body.xmat.reshape(3, 3).copy())

    def coordinate(self, index: int) -> float:
        """One of the simulator's 30 coordinates, radians or metres."""
        return float(self._data.qpos[index])


@dataclass(frozen=True)
class Segment:
    """One stretch of movement.

    It ends when `until` says so or, without it, when the hand is near the target, and after `longest` steps at most.

    Attributes:
        target: the pose to go to; asked anew at every step.
        fingers: each finger's distance from the middle, metres.
        speed, turn: largest movement of the hand in a step, metres and radians.
        near, aligned: tolerances, metres and radians.
        longest: steps.
        until: whether what the movement is for has been reached.
        force: newtons (3,) to press with.
        is_approach: a free movement to a skill's start, before which the hand may wander.
    """

    target: Callable[[], Pose]
    fingers: float
    speed: float
    turn: float = 0.12
    near: float = 0.03
    aligned: float = ANY
    longest: int = 25
    until: Callable[[], bool] | None = None
    force: Callable[[], np.ndarray] | None = None
    is_approach: bool = False


def approach(pose: Pose, fingers: float, near: float = 0.03, aligned: float = 0.35, longest: int = 40) -> Segment:
    """Go through free space to where a skill starts."""
    return Segment(lambda: pose, fingers, speed=0.045, near=near, aligned=aligned, longest=longest, is_approach=True)


def reach(
    pose: Pose, fingers: float, near: float, aligned: float = 0.3, longest: int = 12, speed: float = 0.03
) -> Segment:
    """Go carefully to where something is touched."""
    return Segment(lambda: pose, fingers, speed, near=near, aligned=aligned, longest=longest)


def hold(pose: Pose, fingers: float, steps: int, speed: float = 0.02) -> Segment:
    """Stay for a number of steps, so that the fingers can open or close (about three steps)."""
    return Segment(lambda: pose, fingers, speed, near=0.0, longest=steps)


def retreat(pose: Pose, fingers: float = OPEN, near: float = 0.03, longest: int = 6, speed: float = 0.04) -> Segment:
    """Leave, so that the way to the next skill is a straight line through free space."""
    return Segment(lambda: pose, fingers, speed, near=near, longest=longest)
