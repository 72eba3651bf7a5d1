"""A scripted player: does tasks in a kitchen and keeps what a policy would have seen and what it did."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from beso.envs.kitchen.demonstrations.controller import Pose, errors
from beso.envs.kitchen.demonstrations.segments import ANY, Scene, Segment
from beso.envs.kitchen.demonstrations.skills import SKILLS
from beso.envs.kitchen.simulator import KitchenEnv

LIMIT = 280  # actions, the environment's usual length
DETOUR_PROBABILITY = 0.35
DETOUR_SPREAD = np.array([0.06, 0.04, 0.06])  # m
SPEED_FACTOR = (0.85, 1.15)
LARGEST_TREMOR = 0.15  # standard deviation, in units of actions
TREMOR_MEMORY = 0.8  # share of the tremor that is left after a step; 0.6 of new noise keeps its size
ATTEMPTS = 3
MISTAKE_PROBABILITY = 0.25  # of a first attempt
MISTAKE = (0.02, 0.04)  # m


def direction(rng: np.random.Generator) -> np.ndarray:
    """A vector (3,) of length 1, all directions equally likely."""
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


class Player:
    """One episode.

    A tremor moves the arm, a first-order autoregressive noise. What is kept is what the player wants in the state that
    the tremor led to, not what the arm does (Laskey et al. 2017, DART): the way back, and no noise.

    Args:
        env: the kitchen; it is reset.
        rng: for the modes, the places, the mistakes, the speed and the tremor.

    Attributes:
        observations: (30,) each, noisy; one more than actions.
        actions: (9,) float32 each, without the tremor.
        completed: tasks that the environment counts as done, in order.
        done: (7,) booleans for each observation, what is done in it.
        modes: (task, mode) of every attempt.
        made_good: tasks whose first attempt failed after a mistake and that a later attempt did.
        pictures: of every state, where the kitchen draws; else None.
    """

    def __init__(self, env: KitchenEnv, rng: np.random.Generator) -> None:
        self._env, self._rng = env, rng
        observation, info = env.reset(seed=int(rng.integers(2**62)))
        self._scene = Scene(env)
        self._speed, self._tremor_size = rng.uniform(*SPEED_FACTOR), rng.uniform(0, LARGEST_TREMOR)
        self._tremor = np.zeros(7)
        self.observations, self.actions, self.done = [observation], list[np.ndarray](), [env.done()]
        self.completed: tuple[int, ...] = info["tasks"]
        self.modes: list[tuple[int, str]] = []
        self.made_good: list[int] = []
        self.pictures: list[Any] = [env.render()]

    def do(
        self, task: int, mode: str | None = None, attempts: int = ATTEMPTS, mistake: np.ndarray | None = None
    ) -> bool:
        """Do one task, trying again if it is not done afterwards; whether it is.

        Args:
            task: its number.
            mode: one of the skill's; None draws one for each attempt.
            attempts: at most so many.
            mistake: metres (3,) from the thing to where the first attempt takes it to be; None draws it. Later attempts
                make none.
        """
        self._scene.mistake = self._mistake() if mistake is None else mistake
        mistaken = bool(self._scene.mistake.any())
        for attempt in range(attempts):
            drawn = mode or SKILLS[task].draw_mode(self._rng)
            self.modes.append((task, drawn))
            self._follow(SKILLS[task].movement(self._scene, self._rng, drawn))
            self._scene.mistake = np.zeros(3)
            if self.done[-1][task]:
                if mistaken and attempt:
                    self.made_good.append(task)
                return True
        return False

    def _mistake(self) -> np.ndarray:
        """Nothing, or now and then a vector in a random direction."""
        if self._rng.random() >= MISTAKE_PROBABILITY:
            return np.zeros(3)
        return self._rng.uniform(*MISTAKE) * direction(self._rng)

    def _follow(self, segments: Iterable[Segment]) -> None:
        for segment in segments:
            if segment.is_approach and self._rng.random() < DETOUR_PROBABILITY:
                self._move(self._detour(segment))
            self._move(segment)

    def _detour(self, segment: Segment) -> Segment:
        """A movement to a place near the start of a skill, so that skills are entered from many sides."""
        start = segment.target()
        place = start.position + self._rng.uniform(-DETOUR_SPREAD, DETOUR_SPREAD) + [0, -0.06, 0]
        pose = Pose(place, start.rotation)
        return replace(segment, target=lambda: pose, near=0.06, aligned=ANY, longest=20)

    def _move(self, segment: Segment) -> None:
        for _ in range(segment.longest):
            target = segment.target()
            distance, rotation = (np.linalg.norm(error) for error in errors(target, self._scene.hand()))
            arrived = segment.until() if segment.until else distance < segment.near and rotation < segment.aligned
            if arrived or len(self.actions) == LIMIT:
                return
            speed, turn = self._speed * segment.speed, self._speed * segment.turn
            force = segment.force() if segment.force else None
            action = self._scene.arm.action(target, segment.fingers, speed, turn, force)
            self._tremor = TREMOR_MEMORY * self._tremor + 0.6 * self._tremor_size * self._rng.standard_normal(7)
            disturbed = action.copy()
            disturbed[:7] = np.clip(action[:7] + self._tremor, -1, 1)
            self._act(action.astype(np.float32), disturbed.astype(np.float32))

    def _act(self, wanted: np.ndarray, disturbed: np.ndarray) -> None:
        observation, _, _, _, info = self._env.step(disturbed)
        self.actions.append(wanted)
        self.observations.append(observation)
        self.done.append(self._env.done())
        self.pictures.append(self._env.render())
        self.completed = info["tasks"]
