"""The seven skills of the scripted player, each with the ways in which it can be done.

A skill is a generator of segments. It looks at the kitchen when it starts and between segments, so that it works from
wherever the things and the hand have come to be. Places are relative to the things' own marked points, metres in world
coordinates (x right, y towards the wall, z up); every number that is drawn has its range beside it.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from beso.envs.kitchen import spec
from beso.envs.kitchen.demonstrations.controller import Pose, hand_rotation
from beso.envs.kitchen.demonstrations.segments import CLOSED, OPEN, Scene, Segment, approach, hold, reach, retreat

Movement = Callable[[Scene, np.random.Generator, str], Iterator[Segment]]


@dataclass(frozen=True)
class Skill:
    """How one task is done: the movement, and the modes it is drawn from with their probabilities."""

    movement: Movement
    modes: tuple[str, ...]
    probabilities: tuple[float, ...]

    def draw_mode(self, rng: np.random.Generator) -> str:
        """One of the modes."""
        return str(rng.choice(self.modes, p=self.probabilities))


def _turned(vector: np.ndarray, angle: float) -> np.ndarray:
    """A vector (3,) turned about the vertical."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


def microwave(scene: Scene, rng: np.random.Generator, mode: str) -> Iterator[Segment]:
    """Grip the door's handle and pull it round its hinge."""
    hinge = scene.body("microdoorroot").position
    height, yaw, opening = rng.uniform(0.02, 0.08), rng.uniform(-0.28, -0.12), rng.uniform(0.68, 0.9)
    handle = Pose(scene.site("microhandle_site"), hand_rotation(yaw)).moved(0.01, 0, height)

    def pull() -> Pose:
        ahead = hinge + _turned(scene.site("microhandle_site") - hinge, -0.16)
        rotation = hand_rotation(yaw + 0.45 * scene.coordinate(22))
        return Pose(ahead, rotation).moved(0, 0, height)

    yield approach(handle.moved(rng.uniform(-0.01, 0.03), -0.15, rng.uniform(0, 0.04)), OPEN)
    yield reach(handle, OPEN, near=0.015, speed=0.035)
    yield hold(handle, CLOSED, 3, speed=0.03)
    yield Segment(pull, CLOSED, speed=0.04, until=lambda: scene.coordinate(22) < -opening, longest=30)
    yield hold(scene.hand().moved(0.02, -0.02, 0), OPEN, 2)
    yield retreat(Pose(scene.hand().position, hand_rotation(-0.1)).moved(0.06, -0.10, 0), near=0.04)


def kettle(scene: Scene, rng: np.random.Generator, mode: str) -> Iterator[Segment]:
    """Grip one of the two posts of the kettle's handle, lift it, carry it to the back of the stove, put it down."""
    side = {"left post": -1, "right post": 1}[mode]
    # The right post needs more yaw: with less the wrist runs into its limit.
    yaw = rng.uniform(0.3, 0.5) if mode == "left post" else rng.uniform(0.35, 0.55)
    height, lift = rng.uniform(-0.08, -0.06), rng.uniform(0.07, 0.09)  # a lower lift drags it and turns it
    body = scene.body("kettle")
    post_position = scene.site("kettle_site") + body.rotation @ [side * 0.092, 0, height]
    post = Pose(post_position, hand_rotation(yaw)).moved(side * 0.006, 0, 0)  # a little outside, off the kettle
    there = post.moved(-0.23 - body.position[0], 0.73 - body.position[1], 0)

    yield approach(post.moved(-0.01, -0.15, rng.uniform(0, 0.03)), OPEN)
    yield reach(post, OPEN, near=0.015, longest=10, speed=0.035)
    yield hold(post, CLOSED, 3, speed=0.03)
    yield Segment(lambda: post.moved(0, 0.01, lift), CLOSED, speed=0.03, near=0.015, longest=6)
    yield Segment(lambda: there.moved(0.02, -0.24, lift), CLOSED, speed=0.035, longest=12)  # clear of the microwave
    yield Segment(lambda: there.moved(0, -0.1, lift), CLOSED, speed=0.035, longest=12)
    yield Segment(lambda: there, CLOSED, speed=0.03, longest=10)
    yield hold(scene.hand().moved(0, 0, -0.01), OPEN, 3)
    away = Pose(scene.hand().position, post.rotation).moved(0, -0.2, 0)
    yield retreat(away, longest=8, speed=0.045)


def knob(site: str, coordinate: int) -> Movement:
    """The skill of turning one knob, a vertical bar whose upper end goes to the right.

    The fingers grip the bar, at its middle or near its upper end, and the hand rolls and goes round with it. Pushing
    one end with closed fingers fails in half of the attempts with the knob 2 cm off; gripping the bottom burner's lower
    end slips off.

    Args:
        site: the knob's marked point.
        coordinate: index of its angle, which falls from 0.
    """

    def movement(scene: Scene, rng: np.random.Generator, mode: str) -> Iterator[Segment]:
        angle = rng.uniform(0.85, 1.05)  # it counts as turned from 0.62 on, and no longer above 1.18
        yaw, pitch = rng.uniform(0, 0.15), rng.uniform(0, 0.15)
        radius = rng.uniform(0.002, 0.01) if mode == "middle" else rng.uniform(0.02, 0.03)
        centre = scene.site(site)

        def grip(roll: float) -> Pose:
            along = np.array([np.sin(roll), 0, np.cos(roll)])
            return Pose(centre + radius * along, hand_rotation(yaw, pitch, roll)).moved(0, -0.045, 0)

        def turn() -> Pose:
            return grip(min(2.0, 0.8 - scene.coordinate(coordinate)))  # with less lead the bar opens the fingers

        start = grip(0.0)
        yield approach(start.moved(0, -0.13, rng.uniform(-0.03, 0.03)), OPEN)
        yield reach(start, OPEN, near=0.015, aligned=0.25)
        yield hold(start, CLOSED, 3, speed=0.03)
        yield Segment(turn, CLOSED, speed=0.03, turn=0.25, until=lambda: scene.coordinate(coordinate) < -angle)
        yield hold(scene.hand(), OPEN, 2)
        yield retreat(scene.hand().moved(0, -0.13, 0), fingers=0.02, near=0.04)

    return movement


def light_switch(scene: Scene, rng: np.random.Generator, mode: str) -> Iterator[Segment]:
    """Push the switch to the left between the open fingers, the hand pointing up, more or less.

    A finger that is level slips off above or below the switch.
    """
    switch = scene.site("light_site")
    pitch = rng.uniform(0.75, 0.9) if mode == "slanted" else rng.uniform(1.1, 1.25)
    yaw, height = rng.uniform(0, 0.2), rng.uniform(-0.023, -0.017)
    pressure, angle = rng.uniform(30, 45), rng.uniform(0.6, 0.68)
    start = Pose(switch, hand_rotation(yaw, pitch)).moved(0, 0, height)
    end = Pose(start.position, hand_rotation(yaw + 0.1, pitch)).moved(-0.13, 0, 0)

    yield approach(start.moved(0.01, -0.12, rng.uniform(-0.03, 0.03)), OPEN)
    yield reach(start, OPEN, near=0.015, longest=10)
    yield Segment(
        lambda: end,
        OPEN,
        speed=0.025,
        until=lambda: scene.coordinate(17) < -angle,
        force=lambda: np.array([-pressure, 0, 0]),
        longest=18,
    )
    yield retreat(Pose(scene.hand().position, hand_rotation(0.0, 0.1)).moved(0.02, -0.13, 0.02))


def slide_cabinet(scene: Scene, rng: np.random.Generator, mode: str) -> Iterator[Segment]:
    """Push the door to the right by its handle: between the open fingers, or with the closed hand from its left."""
    yaw, pitch = rng.uniform(0.3, 0.5), rng.uniform(0.2, 0.5)
    height, travel = rng.uniform(-0.08, -0.02), rng.uniform(0.3, 0.4)
    if mode == "around":
        fingers, pushing, left, lead = OPEN, 0.02, 0.0, 0.12
    else:
        fingers, pushing, left, lead = CLOSED, CLOSED, -0.06, 0.09
    start = Pose(scene.site("slide_site"), hand_rotation(yaw, pitch)).moved(left, 0, height)

    def push() -> Pose:
        rotation = hand_rotation(yaw + 1.2 * scene.coordinate(19), pitch)
        return Pose(scene.site("slide_site"), rotation).moved(lead, 0, height)

    yield approach(start.moved(-0.02, -0.14, -0.03), fingers, near=0.035, aligned=0.4, longest=50)
    yield reach(start, fingers, near=0.02, aligned=0.35)
    yield Segment(push, pushing, speed=0.035, until=lambda: scene.coordinate(19) > travel)
    yield retreat(scene.hand().moved(0, -0.12, -0.04))


def hinge_cabinet(scene: Scene, rng: np.random.Generator, mode: str) -> Iterator[Segment]:
    """Grip the right door's handle and pull it round its hinge."""
    hinge = scene.body("hingerightdoor").position
    yaw, pitch = rng.uniform(-0.1, 0.1), rng.uniform(0.1, 0.3)
    height, opening = rng.uniform(-0.09, -0.04), rng.uniform(1.25, 1.4)
    rotation = hand_rotation(yaw, pitch)
    handle = Pose(scene.site("hinge_site2"), rotation).moved(0, 0, height)

    def pull() -> Pose:
        ahead = hinge + _turned(scene.site("hinge_site2") - hinge, 0.2)
        return Pose(ahead, rotation).moved(0, 0, height)

    yield approach(handle.moved(0, -0.14, -0.03), OPEN, near=0.035, aligned=0.4, longest=50)
    yield reach(handle, OPEN, near=0.02)
    yield hold(handle, CLOSED, 3, speed=0.03)
    yield Segment(pull, CLOSED, speed=0.04, until=lambda: scene.coordinate(21) > opening, longest=30)
    yield hold(scene.hand(), OPEN, 3)
    yield retreat(scene.hand().moved(0, -0.1, -0.05))


ONE_WAY = (("pull",), (1.0,))
KNOB_WAYS = (("middle", "upper end"), (0.5, 0.5))
PUSH_WAYS = (("around", "beside"), (0.5, 0.5))
LIGHT_WAYS = (("slanted", "steep"), (0.5, 0.5))

SKILLS = {
    spec.MICROWAVE: Skill(microwave, *ONE_WAY),
    spec.KETTLE: Skill(kettle, ("left post", "right post"), (0.5, 0.5)),
    spec.BOTTOM_BURNER: Skill(knob("knob2_site", 11), *KNOB_WAYS),
    spec.TOP_BURNER: Skill(knob("knob4_site", 15), *KNOB_WAYS),
    spec.LIGHT_SWITCH: Skill(light_switch, *LIGHT_WAYS),
    spec.SLIDE_CABINET: Skill(slide_cabinet, *PUSH_WAYS),
    spec.HINGE_CABINET: Skill(hinge_cabinet, *ONE_WAY),
}
