"""Packed frames: every frame of a play dataset at one size, with what goes with them, on disk (beso.data.store).

    frames.npy         (steps, size, size, 3)  uint8 RGB
    actions.npy        (steps, A)              float32, as policies shall give them
    tasks.npy          (steps, K)              uint8, 1 where a task is completed
    states.npy         (steps, S)              float32, the simulator's state; only the probe reads it
    episode_ends.npy   (episodes,)             int64, index one past each episode's last step
    meta.json          source, held-out episodes, channel statistics, SHA-256 of the arrays

Frames are read and written a block at a time, so that memory does not grow with their number.
"""

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from beso.data import store
from beso.data.store import Column
from beso.errors import UserError
from beso.files import replacing

FRAMES: Final = Column((None, None, 3), "uint8")
COLUMNS: Final[Mapping[str, Column]] = {
    "actions": Column((None,), "float32"),
    "tasks": Column((None,), "uint8"),
    "states": Column((None,), "float32"),
}
ARRAYS: Final = ("frames", *COLUMNS, "episode_ends")
BLOCK: Final = 256  # frames


class FrameFile:
    """Rows of a .npy file, read when asked for. A memory map would keep all that was ever read in memory.

    Raises:
        UserError: the file is missing, truncated, or not an array of RGB frames.
    """

    def __init__(self, path: Path) -> None:
        array = store.read_npy(path)
        if array.ndim != 4 or array.shape[3] != 3 or array.dtype != np.uint8 or not array.flags["C_CONTIGUOUS"]:
            raise UserError(f"{path} holds {array.dtype} {array.shape}, expected uint8 frames (steps, H, W, 3)")
        self.shape: tuple[int, ...] = array.shape
        self._start: int = getattr(array, "offset")  # noqa: B009 (of memory maps, which store.read_npy's type does not tell)
        self._row_bytes = int(np.prod(array.shape[1:]))
        self._file = path.open("rb")

    def __len__(self) -> int:
        """Number of frames."""
        return self.shape[0]

    def read(self, rows: np.ndarray) -> np.ndarray:
        """The frames of some rows, (len(rows), H, W, 3)."""
        frames = np.empty((len(rows), *self.shape[1:]), dtype=np.uint8)
        for frame, row in zip(frames, rows, strict=True):
            self._fill(frame, int(row))
        return frames

    def blocks(self, start: int = 0, stop: int | None = None) -> Iterator[np.ndarray]:
        """The frames from `start` to before `stop`, at most BLOCK at a time."""
        stop = len(self) if stop is None else stop
        for first in range(start, stop, BLOCK):
            frames = np.empty((min(BLOCK, stop - first), *self.shape[1:]), dtype=np.uint8)
            self._fill(frames, first)
            yield frames

    def _fill(self, frames: np.ndarray, row: int) -> None:
        if os.preadv(self._file.fileno(), [frames.data], self._start + row * self._row_bytes) != frames.nbytes:
            raise UserError(f"{self._file.name} is truncated")


@dataclass(frozen=True)
class PackedPlay:
    """Packed frames and what goes with them. See the module for the arrays."""

    frames: FrameFile
    actions: np.ndarray
    tasks: np.ndarray
    states: np.ndarray
    episode_ends: np.ndarray
    meta: dict[str, Any]

    def __len__(self) -> int:
        """Number of steps."""
        return len(self.frames)

    @property
    def held_out(self) -> np.ndarray:
        """Which steps belong to held-out episodes, (steps,) booleans."""
        return held_out_steps(self.episode_ends, self.meta["held_out_episodes"])

    @property
    def ends(self) -> np.ndarray:
        """One past the last step of each step's episode, (steps,)."""
        return np.repeat(self.episode_ends, np.diff(self.episode_ends, prepend=0))


def held_out_steps(episode_ends: np.ndarray, episodes: Sequence[int]) -> np.ndarray:
    """Which steps belong to some episodes, (steps,) booleans."""
    chosen = np.isin(np.arange(len(episode_ends)), episodes)
    return np.repeat(chosen, np.diff(episode_ends, prepend=0))


def pack(
    source: FrameFile,
    columns: Mapping[str, np.ndarray],
    episode_ends: np.ndarray,
    held_out: Sequence[int],
    size: int,
    folder: Path,
    meta: Mapping[str, Any],
) -> dict[str, Any]:
    """Bring frames to one size and write a folder of packed frames, atomically.

    Args:
        source: square frames, at least as large.
        columns: arrays by the names in COLUMNS.
        held_out: episodes that no encoder is trained on; the statistics are those of the others.
        size: height and width, pixels. Each is the mean over the area it covers.
        meta: entries for meta.json.

    Returns:
        The contents of meta.json.

    Raises:
        UserError: frames are smaller than `size` or not square.
    """
    steps, height, width, _ = source.shape
    if height != width or height < size:
        raise UserError(f"frames of {height} x {width} pixels cannot be packed as {size} x {size}")
    statistics = _ChannelStatistics()
    training = ~held_out_steps(episode_ends, held_out)

    def resized() -> Iterator[np.ndarray]:
        first = 0
        for block in source.blocks():
            frames = resize(block, size)
            statistics.add(frames[training[first : first + len(frames)]])
            first += len(frames)
            yield frames

    description = {
        **meta,
        "held_out_episodes": [int(episode) for episode in held_out],
        "counts": {"episodes": len(episode_ends), "steps": steps},
        "size": size,
    }
    with store.writing(folder, description) as temporary:
        store.write_npy_parts(temporary / "frames.npy", (steps, size, size, 3), np.uint8, resized())
        for name in COLUMNS:
            store.write_npy(temporary / f"{name}.npy", columns[name])
        store.write_npy(temporary / "episode_ends.npy", episode_ends)
        description["mean"], description["std"] = statistics.result()
    return description


def resize(frames: np.ndarray, size: int) -> np.ndarray:
    """Frames (B, H, W, 3) brought to (B, size, size, 3) by OpenCV's INTER_AREA."""
    if frames.shape[1:3] == (size, size):
        return frames
    import cv2  # machines that only train may lack it

    return np.stack([cv2.resize(frame, (size, size), interpolation=cv2.INTER_AREA) for frame in frames])


class _ChannelStatistics:
    """Mean and standard deviation of red, green and blue in [0, 1]; sums of whole numbers, so exact in any order."""

    def __init__(self) -> None:
        self._count = 0
        self._sums = np.zeros((2, 3), dtype=np.uint64)

    def add(self, frames: np.ndarray) -> None:
        for channel in range(3):
            counts = np.bincount(frames[..., channel].ravel(), minlength=256).astype(np.uint64)
            values = np.arange(256, dtype=np.uint64)
            self._sums[:, channel] += np.array([(counts * values).sum(), (counts * values**2).sum()], dtype=np.uint64)
        self._count += frames[..., 0].size

    def result(self) -> tuple[list[float], list[float]]:
        mean = self._sums[0] / self._count
        std = np.sqrt(np.maximum(self._sums[1] / self._count - mean**2, 1.0))  # one grey level for constant frames
        return (mean / 255).tolist(), (std / 255).tolist()


def write_samples(frames: FrameFile, path: Path, rows: int = 4, columns: int = 8) -> None:
    """Write some frames, from the first to the last, side by side as one PNG."""
    chosen = frames.read(np.linspace(0, len(frames) - 1, rows * columns).astype(int))
    sheet = np.concatenate([np.concatenate(list(chosen[r * columns : (r + 1) * columns]), axis=1) for r in range(rows)])
    import cv2

    # OpenCV's files are blue, green, red.
    encoded = cv2.imencode(".png", cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR))[1]
    with replacing(path) as temporary:
        temporary.write_bytes(encoded.tobytes())


def load(folder: Path, verify: bool = True) -> PackedPlay:
    """Read and check packed frames; `verify` compares the SHA-256 of every array.

    Raises:
        UserError: a file is missing, truncated or altered, or arrays do not fit together.
    """
    missing = "holds no packed frames: it has no meta.json; run `dvc repro preprocess` first"
    arrays, meta = store.read(folder, ARRAYS, missing, verify)
    store.check(arrays, {"frames": FRAMES, **COLUMNS}, str(folder))
    absent = [key for key in ("size", "mean", "std", "held_out_episodes") if key not in meta]
    if absent:
        raise UserError(f"{folder / store.META} is damaged: it has no {absent[0]!r}")
    del arrays["frames"]
    return PackedPlay(frames=FrameFile(folder / "frames.npy"), **arrays, meta=meta)
