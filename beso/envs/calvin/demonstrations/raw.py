"""Play with pictures on disk: flat arrays of whole episodes, one after another (beso.data.store).

    frames.npy          (steps, size, size, 3)  uint8, RGB of the static camera
    robot_obs.npy       (steps, 15)             float32
    scene_obs.npy       (steps, 24)             float32
    rel_actions.npy     (steps, 7)              float32
    actions.npy         (steps, 7)              float32
    tasks.npy           (steps, 34)             uint8
    segment_starts.npy  (steps,)                uint8
    episode_ends.npy    (episodes,)             int64, index one past each episode's last step
    meta.json           where it comes from, counts, versions, SHA-256 of the arrays

What the columns mean is told at `scripted.Step`. Arrays are memory-mapped when read and appended to when written, so
that neither the writer nor the reader holds more than a few hundred frames.
"""

from __future__ import annotations

import importlib.metadata
import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from beso.data import store
from beso.data.store import Column, GrowingArray
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import ACTION_SIZE, ROBOT_SIZE, SCENE_SIZE
from beso.errors import UserError

if TYPE_CHECKING:
    from beso.envs.calvin.demonstrations.scripted import Step

COLUMNS: Final[Mapping[str, Column]] = {
    "frames": Column((None, None, 3), "uint8"),
    "robot_obs": Column((ROBOT_SIZE,), "float32"),
    "scene_obs": Column((SCENE_SIZE,), "float32"),
    "rel_actions": Column((ACTION_SIZE,), "float32"),
    "actions": Column((ACTION_SIZE,), "float32"),
    "tasks": Column((len(tasks.NAMES),), "uint8"),
    "segment_starts": Column((), "uint8"),
}
ARRAYS: Final = (*COLUMNS, "episode_ends")
BATCH: Final = 256  # rows that are written or copied at a time


@dataclass(frozen=True)
class RawPlay:
    """Play with pictures, memory-mapped. See the module for the arrays."""

    frames: np.ndarray
    robot_obs: np.ndarray
    scene_obs: np.ndarray
    rel_actions: np.ndarray
    actions: np.ndarray
    tasks: np.ndarray
    segment_starts: np.ndarray
    episode_ends: np.ndarray
    meta: dict[str, Any]

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self.episode_ends)

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """What is packed with the frames (beso.images.frames): states are robot_obs, then scene_obs."""
        states = np.concatenate([self.robot_obs, self.scene_obs], axis=1)
        return {"actions": self.rel_actions, "tasks": self.tasks, "states": states}

    def episodes(self) -> Iterator[slice]:
        """The rows of each episode."""
        starts = [0, *self.episode_ends[:-1].tolist()]
        return (slice(start, int(end)) for start, end in zip(starts, self.episode_ends, strict=True))


class Writer:
    """Appends rows to the arrays of a folder; made by `writing`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._columns = {name: GrowingArray(folder / f"{name}.npy", dtype) for name, (_, dtype) in COLUMNS.items()}
        self.ends: list[int] = []

    def append(self, columns: Mapping[str, np.ndarray]) -> None:
        """Append rows: an array for each of COLUMNS, all of equal length."""
        if len({len(columns[name]) for name in COLUMNS}) != 1:
            raise ValueError(f"columns of unequal length: { {name: len(columns[name]) for name in COLUMNS} }")
        for name, array in self._columns.items():
            array.append(columns[name])

    def end_episode(self) -> None:
        """Say that the episode ended with the last row."""
        steps = self._columns["frames"].rows
        if steps == (self.ends[-1] if self.ends else 0):
            raise ValueError("an episode without a step")
        self.ends.append(steps)

    def close(self) -> None:
        """Write what is left; the arrays are whole only now."""
        for array in self._columns.values():
            array.close()
        store.write_npy(self._folder / "episode_ends.npy", np.array(self.ends, dtype=np.int64))


@contextmanager
def writing(folder: Path, meta: Mapping[str, Any]) -> Iterator[Writer]:
    """Write play into `folder`, which appears when all is written, or not at all. meta.json gets `meta` and more.

    Raises:
        UserError: nothing was written.
    """
    described = dict(meta)
    with store.writing(folder, described) as temporary:
        writer = Writer(temporary)
        try:
            yield writer
        finally:
            writer.close()
        if not writer.ends:
            raise UserError(f"{folder}: no episode to write")
        described["versions"] = {name: importlib.metadata.version(name) for name in ("numpy", "pybullet")}
        described["counts"] = {"episodes": len(writer.ends), "steps": writer.ends[-1]}


def write(episodes: Iterable[Iterable[Step]], folder: Path, meta: Mapping[str, Any]) -> None:
    """Write recorded episodes, step by step as they come."""
    with writing(folder, meta) as writer:
        for episode in episodes:
            steps = iter(episode)
            while batch := list(itertools.islice(steps, BATCH)):
                writer.append(_columns(batch))
            writer.end_episode()


def _columns(steps: Sequence[Step]) -> dict[str, np.ndarray]:
    return {
        "frames": np.stack([step.frame for step in steps]),
        "robot_obs": np.stack([step.robot_obs for step in steps]),
        "scene_obs": np.stack([step.scene_obs for step in steps]),
        "rel_actions": np.stack([step.rel_action for step in steps]),
        "actions": np.stack([step.action for step in steps]),
        "tasks": np.stack([step.tasks for step in steps]),
        "segment_starts": np.array([step.segment_start for step in steps]),
    }


def join(parts: Iterable[Path], folder: Path, meta: Mapping[str, Any]) -> None:
    """Write one folder with the episodes of several, in their order: how episodes recorded in parallel come together.

    Raises:
        UserError: a part is missing or damaged, or its frames are of another size.
    """
    size = None
    with writing(folder, meta) as writer:
        for part in parts:
            play = load(part)
            size = size or play.frames.shape[1:]
            if play.frames.shape[1:] != size:
                raise UserError(f"{part}: frames of shape {play.frames.shape[1:]}, those before have {size}")
            for rows in play.episodes():
                for start in range(rows.start, rows.stop, BATCH):
                    batch = slice(start, min(start + BATCH, rows.stop))
                    writer.append({name: getattr(play, name)[batch] for name in COLUMNS})
                writer.end_episode()


def load(folder: Path, verify: bool = True) -> RawPlay:
    """Read and check play; `verify` compares the SHA-256 of every array, which reads all frames once.

    Raises:
        UserError: a file is missing, truncated or altered, or an array has the wrong shape or dtype.
    """
    arrays, meta = store.read(folder, ARRAYS, "is not raw CALVIN play: it has no meta.json", verify)
    store.check(arrays, COLUMNS, str(folder))
    height, width = arrays["frames"].shape[1:3]
    if height != width:
        raise UserError(f"{folder}: frames are {height} x {width} pixels, expected square ones")
    return RawPlay(**arrays, meta=meta)
