"""The scripted controller that makes the block-push demonstrations.

A finite-state controller after the oriented push oracle of Florence et al. (2022) in the multimodal variant of
Shafiullah et al. (2022): walk behind a block, turn it until a face looks at the target, push; after the first block
return along the way it came and do the same with the second one. Which block goes first and to which target is drawn
once an episode from four equally likely plans; this is what makes the data multimodal.
"""

import functools
import math
from typing import Any

import numpy as np

from beso.core.seeding import generator
from beso.data.play import Episode
from beso.envs.block_push.simulator.environment import PAIRS, BlockPushEnv
from beso.envs.block_push.spec import LONGEST

PLANS = (  # ((first block, its target), (second block, its target))
    ((0, 0), (1, 1)),
    ((0, 1), (1, 0)),
    ((1, 0), (0, 1)),
    ((1, 1), (0, 0)),
)
STEP_SECONDS = 0.1
WALK_SPEED, PUSH_SPEED, ORIENT_SPEED = 0.30, 0.35, 0.15  # m/s
BEHIND, NEXT_TO, TOUCHING = 0.05, 0.03, 0.01  # metres from the block's centre, on the far side from the target
ARRIVED = 0.001  # m
SWITCH_DISTANCE = 0.04  # m; the first block counts as delivered
ORIENT_ABOVE, ORIENTED_BELOW = 0.2, 0.03  # rad
ORIENT_RADIUS, ORIENT_LEAD = 0.025, 0.2  # m, rad


class BlockPushDemonstrator:
    """Controller for one episode.

    Args:
        plan: a row of PLANS.
    """

    def __init__(self, plan: tuple[tuple[int, int], tuple[int, int]]) -> None:
        self._plan = plan
        self._delivered = False
        self._phase = "walk_behind"
        self._origin: np.ndarray | None = None
        self._first_behind: np.ndarray | None = None

    @classmethod
    def draw(cls, rng: np.random.Generator) -> "BlockPushDemonstrator":
        """A controller with a random plan."""
        return cls(PLANS[rng.integers(len(PLANS))])

    def action(self, observation: np.ndarray) -> np.ndarray:
        """The next displacement of the effector's target, (2,) float32 metres, for a 16-d observation."""
        blocks, targets = observation[[[0, 1], [3, 4]]], observation[[[10, 11], [13, 14]]]
        first_block, first_target = self._plan[0]
        if not self._delivered and _distance(blocks[first_block], targets[first_target]) < SWITCH_DISTANCE:
            self._delivered = True
            self._phase = "return_behind"
        index, target_index = self._plan[int(self._delivered)]
        block, target, effector = blocks[index], targets[target_index], observation[8:10]
        yaw = observation[3 * index + 2]
        if self._origin is None:
            self._origin = effector.copy()

        direction = (target - block) / _distance(target, block)
        yaw_error = _wrap_quarter(math.atan2(direction[1], direction[0]) - yaw)
        turned = abs(yaw_error) > ORIENT_ABOVE
        behind = block - BEHIND * direction

        # The phases are tried in this order and a change takes effect at once, so that one call may pass through
        # several; the last one that ran decides the movement. This is the published controller's behaviour.
        speed, move = PUSH_SPEED, np.zeros(2)
        if self._phase == "walk_behind":
            speed, move = WALK_SPEED, behind - effector
            if _length(move) < ARRIVED:
                self._phase = "approach"
                if self._first_behind is None:
                    self._first_behind = behind.copy()
        if self._phase == "return_behind":
            if self._first_behind is None:
                self._first_behind = self._origin
            speed, move = WALK_SPEED, self._first_behind - effector
            if _length(move) < ARRIVED:
                self._phase = "return_to_origin"
        if self._phase == "return_to_origin":
            speed, move = WALK_SPEED, self._origin - effector
            if _length(move) < ARRIVED:
                self._phase = "walk_behind"
        if self._phase == "approach":
            move = block - NEXT_TO * direction - effector
            if _length(move) < ARRIVED:
                self._phase = "push"
            if turned:
                self._phase = "orient_left" if yaw_error > 0 else "orient_right"
        if self._phase == "push":
            move = block - TOUCHING * direction - effector
            if turned:
                self._phase = "walk_behind"
        if self._phase in ("orient_left", "orient_right"):
            speed = ORIENT_SPEED
            sign = 1 if self._phase == "orient_left" else -1
            outward = (effector - block) / _distance(effector, block)
            move = block + ORIENT_RADIUS * _rotate(outward, sign * ORIENT_LEAD) - effector
            if sign * yaw_error < ORIENTED_BELOW:
                self._phase = "walk_behind"

        length, longest = _length(move), speed * STEP_SECONDS
        if length > longest:
            move = move / length * longest
        return move.astype(np.float32)


def _length(vector: np.ndarray) -> float:
    return math.hypot(vector[0], vector[1])


def _distance(a: np.ndarray, b: np.ndarray) -> float:
    return math.hypot(a[0] - b[0], a[1] - b[1])


def _wrap_quarter(angle: float) -> float:
    """The angle modulo a quarter turn, in [-pi/4, pi/4]: a cube looks the same after a quarter turn."""
    return math.remainder(angle, math.pi / 2)


def _rotate(vector: np.ndarray, angle: float) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1]])


RECORDING_TOLERANCE = 0.04  # m; the published demonstrations were stopped at this distance, evaluation uses 0.05
RECORDING_LIMIT = LONGEST - 1  # actions; 1-2 % of the episodes run into it and are kept, as in the published set


def record(seed: int, index: int) -> Episode:
    """Record demonstration `index` of the data set with root seed `seed`.

    The published recipe: up to 200 actions, and one more row with the last observation and the action the controller
    would have taken there.
    """
    return _play(_recording_environment(), seed, index)[0]


def film(seed: int) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Pictures of the first demonstration, and what they show (beso.envs.protocol.Filmer)."""
    env = BlockPushEnv(render_mode="rgb_array", tolerance=RECORDING_TOLERANCE)
    _, pictures = _play(env, seed, 0)
    env.close()
    return pictures, {"demonstration": 0, "shows": "the arm pushes each block into a target"}


def _play(env: BlockPushEnv, seed: int, index: int) -> tuple[Episode, list[Any]]:
    """A demonstration; and a picture of every state, where the environment draws, else None."""
    rng = generator(seed, "block_push demonstration", index)
    demonstrator = BlockPushDemonstrator.draw(rng)
    observation, _ = env.reset(seed=int(rng.integers(2**62)))
    observations, actions = [observation], [demonstrator.action(observation)]
    pictures: list[Any] = [env.render()]
    completed: list[tuple[int, int]] = []  # (step, pair)
    terminated = False
    while not terminated and len(actions) <= RECORDING_LIMIT:
        observation, _, terminated, _, info = env.step(actions[-1])
        completed += [(len(actions), pair) for pair in info["tasks"][len(completed) :]]
        observations.append(observation)
        pictures.append(env.render())
        actions.append(demonstrator.action(observation))
    tasks = np.zeros((len(actions), PAIRS), dtype=np.uint8)
    for step, pair in completed:
        tasks[step, pair] = 1
    return Episode(np.array(observations, dtype=np.float32), np.array(actions), tasks), pictures


@functools.cache
def _recording_environment() -> BlockPushEnv:
    """One environment a process; an episode depends on its reset alone, not on those played before."""
    return BlockPushEnv(tolerance=RECORDING_TOLERANCE)
