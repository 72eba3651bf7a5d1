"""Scripted play: one skill after another on the same table, without resets."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from beso.envs.calvin.demonstrations.block_skills import drop_in_mid_air
from beso.envs.calvin.demonstrations.grasps import find_grasp
from beso.envs.calvin.demonstrations.hand import YAW, Hand, Manner, Motion
from beso.envs.calvin.demonstrations.layout import LOST, ON_TABLE, place_of
from beso.envs.calvin.demonstrations.placing_skills import carry_clear, neutral
from beso.envs.calvin.demonstrations.repertoire import Skill, with_block, with_free_hand
from beso.envs.calvin.simulator.observations import BLOCKS, FIXTURES, SLIDE, block_slice
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.calvin.simulator.spawn import draw_fixtures, draw_scene
from beso.envs.calvin.simulator.state import ROBOT
from beso.envs.calvin.simulator.table import SLIDE_TRAVEL
from beso.envs.calvin.simulator.tasks import completed, names_of

# Of the gaps between skills. A policy is started from the neutral pose and has the arm there in its goal image; it has
# to have seen play come and go there. Wandering says nothing about goals, and confuses policies (docs/fidelity.md).
REST_SHARE, DETOUR_SHARE = 0.7, 0.05
DETOUR_LOW, DETOUR_HIGH = np.array([-0.15, -0.32, 0.58]), np.array([0.25, -0.15, 0.68])  # tcp, metres
BALANCE = 2.0  # a family played once more than another is this many times less likely to come next
SHARES = {"push": 3.0, "rotate": 2.0}  # of families; these have six tasks each, and blocks can seldom be pushed
FAILURE = 2  # a skill that is given up counts as so many more
ATTEMPTS = 3
MISTAKE_SHARE = 0.25  # of first attempts with a free hand
MISTAKE = (0.02, 0.04)  # m


@dataclass(frozen=True)
class Segment:
    """A stretch of play with one aim; tasks are judged against the table's state at its beginning."""

    family: str
    motion: Motion


class Player:
    """Chooses what to do next on a table and does it in ever new manners.

    Families of skills are chosen about equally often, as far as the table's state allows. Left to equal chances among
    what is possible, blocks would gather in drawer and cabinet, and play would be nothing but fixtures.

    Some first attempts are made at a wrong place. What fails is tried again, if it still can be done.

    Args:
        table: the table, already reset, which someone else steps.
        rng: source of all choices.
    """

    def __init__(self, table: PlayTable, rng: np.random.Generator) -> None:
        self.table, self.rng = table, rng
        self.hand = Hand(table)
        self._held: int | None = None
        self._rested = True  # the arm starts at its neutral pose
        self._families: Counter[str] = Counter()
        self._variants: Counter[tuple[str, str]] = Counter()
        self._last: Skill | None = None  # what is being done, until it has succeeded or is given up
        self._attempts = 0
        self._start = table.state()  # of the last attempt

    def next_segment(self) -> Segment:
        """What to do now; to be called when the last segment's motion has ended."""
        self.hand.manner, self.hand.mistake = Manner.draw(self.rng), np.zeros(3)
        if self._held is not None and not self._holds(self._held):
            self._held = None
            return Segment("recover", drop_in_mid_air(self.hand))
        skills = self._possible()
        if self._last is not None and self._failed(self._last):
            if self._attempts < ATTEMPTS and _kind(self._last) in map(_kind, skills):
                return self._attempt(self._last)
            self._count(self._last, FAILURE)
        self._last, self._attempts = None, 0
        if self._held is None and not self._rested and self.rng.random() < REST_SHARE:
            self._rested = True
            return Segment("rest", neutral(self.hand))
        if self.rng.random() < DETOUR_SHARE:
            return Segment("detour", self._detour())
        if not skills:  # a block hangs in the gripper, and there is no room for it anywhere
            self._held = None
            return Segment("recover", drop_in_mid_air(self.hand))
        if self._held is None and self.rng.random() < MISTAKE_SHARE:
            self.hand.mistake = self._mistake()
        return self._attempt(self._choose(skills))

    def _attempt(self, skill: Skill) -> Segment:
        self._last, self._attempts, self._start = skill, self._attempts + 1, self.table.state()
        self._held, self._rested = skill.held, False
        return Segment(skill.family, skill.motion(self.hand))

    def _failed(self, skill: Skill) -> bool:
        """Whether the last attempt, at this skill, did not complete its task."""
        return skill.task is not None and skill.task not in names_of(completed(self._start, self.table.state()))

    def _mistake(self) -> np.ndarray:
        """A vector (3,) in a random direction, metres."""
        direction = self.rng.standard_normal(3)
        return self.rng.uniform(*MISTAKE) * direction / np.linalg.norm(direction)

    def _possible(self) -> list[Skill]:
        scene = self.table.scene_obs()
        if self._held is None:
            return with_free_hand(scene, self.rng)
        return with_block(scene, self._held, self.rng)

    def _choose(self, skills: list[Skill]) -> Skill:
        family = self._draw(sorted({skill.family for skill in skills}), self._families)
        members = {skill.variant: skill for skill in skills if skill.family == family}
        counts = Counter({variant: self._variants[family, variant] for variant in members})
        skill = members[self._draw(sorted(members), counts)]
        self._count(skill)
        return skill

    def _draw(self, names: Sequence[str], counts: Counter[str]) -> str:
        """One of the names, rather one that came seldom."""
        weights = np.array([BALANCE ** (-counts[name] / SHARES.get(name, 1.0)) for name in names])
        return names[self.rng.choice(len(names), p=weights / weights.sum())]

    def _count(self, skill: Skill, times: int = 1) -> None:
        self._families[skill.family] += times
        self._variants[_kind(skill)] += times

    def _holds(self, block: int) -> bool:
        return self.table.state().blocks[BLOCKS[block]].touched == {ROBOT}

    def _detour(self) -> Motion:
        """Wander to some place above the table."""
        yaw, tilt = self.hand.yaw, self.hand.tilt
        place = self.rng.uniform(DETOUR_LOW, DETOUR_HIGH)
        if self._held is None:
            yield from self.hand.rise()
            yield from self.hand.go(place, yaw=YAW + self.rng.uniform(-0.5, 0.5), tolerance=0.03)
        else:
            yield from carry_clear(self.hand)
            yield from self.hand.go(place, yaw=yaw, tilt=tilt, tolerance=0.03)


def _kind(skill: Skill) -> tuple[str, str]:
    return skill.family, skill.variant


def draw_start(rng: np.random.Generator) -> np.ndarray:
    """A scene_obs (24,) to start play from: CALVIN's rule, fixtures at random.

    Left out are scenes without a block on the table, and with a block that cannot be grasped wherever the door is.
    """
    while True:
        scene = draw_scene(rng, draw_fixtures(rng))
        places = [place_of(scene, block) for block in range(len(BLOCKS))]
        if ON_TABLE in places and all(_graspable_once_open(scene, block) for block in range(len(BLOCKS))):
            return scene


def _graspable_once_open(scene: np.ndarray, block: int) -> bool:
    opened = scene.copy()
    opened[FIXTURES][SLIDE] = 0.0 if scene[block_slice(block)][0] < -0.1 else SLIDE_TRAVEL
    return find_grasp(opened, block) is not None


def block_lost(table: PlayTable) -> bool:
    """Whether a block fell off the table."""
    scene = table.scene_obs()
    return any(place_of(scene, block) == LOST for block in range(len(BLOCKS)))
