"""Play with pictures on disk: flat arrays of whole episodes, one after another.

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
from typing import TYPE_CHECKING, Any, BinaryIO, Final

import numpy as np

from beso.data.play import read_npy, write_npy
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import ACTION_SIZE, ROBOT_SIZE, SCENE_SIZE
from beso.errors import UserError
from beso.files import check_sha256, read_json, replacing, sha256, write_json

if TYPE_CHECKING:
    from beso.envs.calvin.demonstrations.scripted import Step

COLUMNS: Final[Mapping[str, tuple[tuple[int, ...], str]]] = {  # shape of a row, dtype; that of a frame is free
    "frames": ((), "uint8"),
    "robot_obs": ((ROBOT_SIZE,), "float32"),
    "scene_obs": ((SCENE_SIZE,), "float32"),
    "rel_actions": ((ACTION_SIZE,), "float32"),
    "actions": ((ACTION_SIZE,), "float32"),
    "tasks": ((len(tasks.NAMES),), "uint8"),
    "segment_starts": ((), "uint8"),
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
        self._columns = {name: _GrowingArray(folder / f"{name}.npy", dtype) for name, (_, dtype) in COLUMNS.items()}
        self._ends: list[int] = []

    def append(self, columns: Mapping[str, np.ndarray]) -> None:
        """Append rows: an array for each of COLUMNS, all of equal length."""
        if len({len(columns[name]) for name in COLUMNS}) != 1:
            raise ValueError(f"columns of unequal length: { {name: len(columns[name]) for name in COLUMNS} }")
        for name, array in self._columns.items():
            array.append(columns[name])

    def end_episode(self) -> None:
        """Say that the episode ended with the last row."""
        steps = self._columns["frames"].rows
        if steps == (self._ends[-1] if self._ends else 0):
            raise ValueError("an episode without a step")
        self._ends.append(steps)

    def close(self) -> None:
        """Write what is left; the arrays are whole only now."""
        for array in self._columns.values():
            array.close()
        write_npy(self._folder / "episode_ends.npy", np.array(self._ends, dtype=np.int64))


class _GrowingArray:
    """A .npy file that rows are appended to. Its header leaves room for any number of rows and is written twice."""

    def __init__(self, path: Path, dtype: str) -> None:
        self._file: BinaryIO = path.open("wb")
        self._dtype = np.dtype(dtype)
        self._row: tuple[int, ...] | None = None
        self.rows = 0

    def append(self, array: np.ndarray) -> None:
        if self._row is None:
            self._row = array.shape[1:]
            self._write_header()
        if array.shape[1:] != self._row:
            raise ValueError(f"rows of shape {array.shape[1:]} after rows of shape {self._row}")
        self._file.write(np.ascontiguousarray(array, dtype=self._dtype).data)
        self.rows += len(array)

    def close(self) -> None:
        if self._row is not None:
            end = self._file.tell()
            self._file.seek(0)
            self._write_header()
            # Appended rows follow the first header, so the second must be as long.
            if self._file.tell() + self.rows * self._dtype.itemsize * int(np.prod(self._row)) != end:
                raise RuntimeError("numpy wrote two headers of unequal length")
        self._file.close()

    def _write_header(self) -> None:
        assert self._row is not None
        description = np.lib.format.dtype_to_descr(self._dtype)
        header = {"descr": description, "fortran_order": False, "shape": (self.rows, *self._row)}
        np.lib.format.write_array_header_1_0(self._file, header)


@contextmanager
def writing(folder: Path, meta: Mapping[str, Any]) -> Iterator[Writer]:
    """Write play into `folder`, which appears when all is written, or not at all. meta.json gets `meta` and more.

    Raises:
        UserError: nothing was written.
    """
    with replacing(folder) as temporary:
        temporary.mkdir()
        writer = Writer(temporary)
        try:
            yield writer
        finally:
            writer.close()
        ends = read_npy(temporary / "episode_ends.npy")
        if not len(ends):
            raise UserError(f"{folder}: no episode to write")
        versions = {name: importlib.metadata.version(name) for name in ("numpy", "pybullet")}
        counts = {"episodes": len(ends), "steps": int(ends[-1])}
        digests = {name: sha256(temporary / f"{name}.npy") for name in ARRAYS}
        write_json(temporary / "meta.json", {**meta, "versions": versions, "counts": counts, "sha256": digests})


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
    if not (folder / "meta.json").is_file():
        raise UserError(f"{folder} is not raw CALVIN play: it has no meta.json")
    meta = read_json(folder / "meta.json")
    arrays = {name: read_npy(folder / f"{name}.npy") for name in ARRAYS}
    _check(arrays, folder)
    for name in ARRAYS if verify else ():
        check_sha256(folder / f"{name}.npy", meta.get("sha256", {}).get(name), "meta.json")
    return RawPlay(**arrays, meta=meta)


def _check(arrays: Mapping[str, np.ndarray], folder: Path) -> None:
    ends = arrays["episode_ends"]
    if ends.ndim != 1 or len(ends) == 0 or (np.diff(ends, prepend=0) <= 0).any():
        raise UserError(f"{folder / 'episode_ends.npy'} does not rise from above 0")
    steps = int(ends[-1])
    for name, (row, dtype) in COLUMNS.items():
        array = arrays[name]
        if name == "frames":
            row = (*array.shape[1:3], 3)
        if array.shape != (steps, *row) or array.dtype != dtype:
            raise UserError(f"{folder / name}.npy holds {array.dtype} {array.shape}, expected {dtype} {(steps, *row)}")
