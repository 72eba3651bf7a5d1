"""Recorded scripted play: what the published data set is to CALVIN, for the play table of this project.

An episode is a stretch of play without a reset. Episode `index` of the recording with root seed `seed` depends on these
two numbers alone.

A tremor moves the arm, a first-order autoregressive noise. What is recorded is what the hand wants in the state that
the tremor led to, not what the arm does (Laskey et al. 2017, DART): the way back, and no noise.
"""

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from beso.core.seeding import generator
from beso.envs.calvin.demonstrations.player import Player, Segment, block_lost, draw_start
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import ACTION_SIZE, GRIPPER_COMMAND, TCP_EULER, TCP_POSITION
from beso.envs.calvin.simulator.play_table import PlayTable

LARGEST_TREMOR = 0.3  # standard deviation, in units of actions
TREMOR_MEMORY = 0.8  # share of the tremor that is left after a step; 0.6 of new noise keeps its size
TREMOR_SHAPE = np.array([1.0, 1.0, 1.0, 0.3, 0.3, 0.3, 0.0])  # of translation, rotation and gripper


@dataclass(frozen=True)
class Step:
    """One row of the data: what was seen and what was then done.

    Attributes:
        frame: (size, size, 3) uint8 RGB of the static camera, before the action.
        robot_obs: (15,) state of the arm, before the action.
        scene_obs: (24,) state of the table, before the action.
        rel_action: (7,) the relative action that the hand wants, without the tremor. In the published data it is the
            displacement that followed; the command is what policies have to give.
        action: (7,) tcp xyz, euler xyz and gripper command that followed, as published.
        tasks: (34,) uint8, 1 for each task that is done from this row to its segment's end, but not in the row before.
        segment_start: whether a segment starts here. Tasks are judged against the state in its first row.
        family: what the player was up to.
    """

    frame: np.ndarray
    robot_obs: np.ndarray
    scene_obs: np.ndarray
    rel_action: np.ndarray
    action: np.ndarray
    tasks: np.ndarray
    segment_start: bool
    family: str


def record(seed: int, index: int, length: int, size: int | None) -> Iterator[Step]:
    """Play episode `index` and yield its steps.

    Args:
        seed, index: root seed and number of the episode.
        length: its number of steps. It is shorter if a block falls off the table.
        size: height and width of the frames, pixels; None: frames stay empty, (0, 0, 3).
    """
    table = _recording_table()
    rng = generator(seed, "calvin play", index)
    table.reset(draw_start(rng))
    player = Player(table, rng)
    recorded = 0
    while recorded < length and not block_lost(table):
        steps = _record_segment(table, player.next_segment(), _tremor(rng), length - recorded, size)
        recorded += len(steps)
        yield from steps


def _tremor(rng: np.random.Generator) -> Iterator[np.ndarray]:
    """What moves the arm besides its actions, (7,) a step; how strongly is drawn once."""
    spread, tremor = rng.uniform(0, LARGEST_TREMOR) * TREMOR_SHAPE, np.zeros(ACTION_SIZE)
    while True:
        tremor = TREMOR_MEMORY * tremor + 0.6 * spread * rng.standard_normal(ACTION_SIZE)
        yield tremor


def _record_segment(
    table: PlayTable, segment: Segment, tremor: Iterator[np.ndarray], length: int, size: int | None
) -> list[Step]:
    """The steps of one segment, at most `length`, with labels; they are known only at its end."""
    start = table.state()
    steps: list[Step] = []
    done: list[np.ndarray] = [np.zeros(len(tasks.NAMES), dtype=bool)]  # in each row, and after the last one
    frame, robot_obs, scene_obs = _observe(table, size)
    for rel_action, shake in zip(segment.motion, tremor, strict=False):
        table.step(rel_action + shake)
        done.append(tasks.completed(start, table.state()))
        after = _observe(table, size)
        action = np.array([*after[1][TCP_POSITION], *after[1][TCP_EULER], after[1][GRIPPER_COMMAND]])
        no_labels = np.zeros(len(tasks.NAMES), dtype=np.uint8)
        steps.append(Step(frame, robot_obs, scene_obs, rel_action, action, no_labels, not steps, segment.family))
        frame, robot_obs, scene_obs = after
        if len(steps) == length:
            break
    return [replace(step, tasks=labels) for step, labels in zip(steps, _labels(np.array(done)), strict=False)]


def _labels(done: np.ndarray) -> np.ndarray:
    """Where tasks came to be done for good.

    Args:
        done: (T + 1, 34) booleans, for each row and after the last one.

    Returns:
        (T, 34) uint8. A task that is done only after the last row is labelled in the last row.
    """
    for_good = np.logical_and.accumulate(done[::-1])[::-1]
    first = for_good & ~np.concatenate([np.zeros_like(done[:1]), for_good[:-1]])
    labels = first[:-1].copy()
    if len(labels):
        labels[-1] |= first[-1]
    return labels.astype(np.uint8)


def _observe(table: PlayTable, size: int | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    frame = np.empty((0, 0, 3), dtype=np.uint8) if size is None else table.picture(size)
    return frame, table.robot_obs(), table.scene_obs()


@functools.cache
def _recording_table() -> PlayTable:
    """One table a process; an episode depends on its reset alone, not on those played before."""
    return PlayTable()
