"""CALVIN's own layout of data sets: one .npz file a frame.

    episode_0000000.npz, ...   rgb_static (200, 200, 3) uint8, robot_obs (15,), scene_obs (24,), rel_actions (7,),
                               actions (7,), and pictures of other cameras, which are not read
    ep_start_end_ids.npy       (episodes, 2) numbers of each episode's first and last frame

This is the contents of the folder `training` or `validation` of a data set of github.com/mees/calvin.
"""

import itertools
import math
import os
import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
from tqdm import tqdm

from beso.checks import numbers
from beso.data.store import read_npy, read_npz, write_npy
from beso.envs.calvin.demonstrations.raw import BATCH, RawPlay, writing
from beso.envs.calvin.simulator import tasks
from beso.envs.calvin.simulator.observations import ACTION_SIZE, ROBOT_SIZE, SCENE_SIZE
from beso.envs.published import within
from beso.errors import UserError
from beso.files import replacing

STATE_SIZES: Final = {
    "robot_obs": ROBOT_SIZE,
    "scene_obs": SCENE_SIZE,
    "rel_actions": ACTION_SIZE,
    "actions": ACTION_SIZE,
}
# Metres and radians; relative actions are in units of the largest step.
LARGEST: Final = {"robot_obs": 4 * math.pi, "scene_obs": 4 * math.pi, "rel_actions": 1.0 + 1e-6, "actions": 4 * math.pi}
FRAME_KEY: Final = "rgb_static"
LARGEST_FRAME: Final = 3 * 4096**2  # bytes
SCENE_INFO: Final = "scene_info.npy"
SCENE: Final = "D"  # the one that is simulated here
DIGITS: Final = 7


@dataclass(frozen=True)
class Layout:
    """The frames of a folder: (first, last) number of every episode, and how many digits the files' names have."""

    folder: Path
    episodes: tuple[tuple[int, int], ...]
    digits: int

    def path(self, number: int) -> Path:
        """The file of one frame."""
        return self.folder / f"episode_{number:0{self.digits}d}.npz"


def layout(folder: Path) -> Layout:
    """Find out which frames a folder has, and check that none is missing.

    Raises:
        UserError: there is no such data set, its list of episodes is damaged, or a frame is missing.
    """
    index = folder / "ep_start_end_ids.npy"
    if not index.is_file():
        hint = "the folder must be `training` or `validation` of a CALVIN data set"
        if folder.name in ("training", "validation"):
            hint = f"{folder} must hold a CALVIN data set's list of episodes, and its frames episode_*.npz"
        raise UserError(f"{index} is missing; {hint}")
    for scene in sorted(scenes(folder) - {SCENE}):
        raise UserError(f"{folder / SCENE_INFO} names frames of scene {scene}, expected scene {SCENE} alone")
    bounds = read_npy(index)
    if bounds.ndim != 2 or bounds.shape[1] != 2 or bounds.dtype.kind not in "iu" or len(bounds) == 0:
        raise UserError(f"{index} holds {bounds.dtype} {bounds.shape}, expected whole numbers (episodes, 2)")
    episodes = tuple(sorted((int(first), int(last)) for first, last in bounds))
    for first, last in episodes:
        if not 0 <= first <= last:
            raise UserError(f"{index}: an episode from frame {first} to {last}; the first must not exceed the last")
    for (_, last), (first, _) in itertools.pairwise(episodes):
        if first <= last:
            raise UserError(f"{index}: an episode starts at frame {first} before another ends at {last}")
    with os.scandir(folder) as entries:
        present = {entry.name for entry in entries if entry.is_file(follow_symlinks=False) or entry.is_symlink()}
    names = [re.fullmatch(r"episode_(\d+)\.npz", name) for name in present]
    digits = {len(match.group(1)) for match in names if match}
    found = Layout(folder, episodes, digits.pop() if len(digits) == 1 else DIGITS)
    for first, last in episodes:
        for number in range(first, last + 1):
            if found.path(number).name not in present:
                raise UserError(f"{found.path(number)} is missing, a frame of the episode from {first} to {last}")
    return found


def scenes(folder: Path) -> set[str]:
    """The scenes that a folder's frames are of, as far as it tells: its scene_info.npy is a pickle, read as text."""
    path = folder / SCENE_INFO
    found = re.findall(rb"calvin_scene_([A-Z])", path.read_bytes()) if path.is_file() else []
    return {name.decode() for name in found}


def starts(found: Layout) -> dict[bytes, str]:
    """The files of the episodes' first frames, by what is in them."""
    first = [found.path(number) for number, _ in found.episodes]
    return {b"".join(row.tobytes() for row in read_frame(path, None).values()): str(path) for path in first}


def read_frame(path: Path, size: int | None) -> dict[str, np.ndarray]:
    """Read what is needed of one frame.

    Args:
        path: the .npz file.
        size: height and width that the picture is brought to, pixels; None leaves it as it is.

    Raises:
        UserError: the file is truncated, a key is missing, or an array has another shape.
    """
    found = read_npz(path, (FRAME_KEY, *STATE_SIZES), LARGEST_FRAME)
    for key, width in STATE_SIZES.items():
        what = f"{path}: {key}"
        within(what, numbers(what, found[key], (width,)), LARGEST[key])
    frame = found.pop(FRAME_KEY)
    if frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3 or frame.shape[0] != frame.shape[1]:
        raise UserError(f"{path}: {FRAME_KEY} is {frame.dtype} {frame.shape}, expected uint8 (size, size, 3)")
    if size is not None and frame.shape[:2] != (size, size):
        frame = cv2.resize(frame, (size, size), interpolation=cv2.INTER_AREA)
    return {"frames": frame, **found}


def convert(layouts: Sequence[Layout], target: Path, size: int | None, workers: int, meta: Mapping[str, Any]) -> None:
    """Bring data in CALVIN's layout into the form of `raw`, episode by episode, folder after folder.

    Its tasks are unknown, so the column `tasks` stays zero, and each episode is one segment; meta.json says so.

    Args:
        layouts: of the folders, `training` or `validation`.
        target: the folder to write.
        size: height and width of the frames written, pixels; None keeps those of the files.
        workers: how many files are read at a time.
        meta: entries for meta.json.

    Raises:
        UserError: see `read_frame`; frames of unequal sizes.
    """
    frames = sum(last - first + 1 for found in layouts for first, last in found.episodes)
    progress = tqdm(total=frames, desc="convert", unit="frame", disable=None)
    with writing(target, {"labelled": False, **meta}) as writer, ThreadPoolExecutor(workers) as pool, progress:
        shape = None
        for found, (first, last) in [(part, bounds) for part in layouts for bounds in part.episodes]:
            for start in range(first, last + 1, BATCH):
                paths = [found.path(number) for number in range(start, min(start + BATCH, last + 1))]
                rows = list(pool.map(partial(read_frame, size=size), paths))
                shape = shape or rows[0]["frames"].shape
                for path, row in zip(paths, rows, strict=True):
                    if row["frames"].shape != shape:
                        raise UserError(f"{path}: a frame of shape {row['frames'].shape}, those before have {shape}")
                segment_starts = np.zeros(len(rows))
                segment_starts[0] = start == first
                columns = {key: np.stack([row[key] for row in rows]) for key in ("frames", *STATE_SIZES)}
                columns["tasks"] = np.zeros((len(rows), len(tasks.NAMES)))
                writer.append({**columns, "segment_starts": segment_starts})
                progress.update(len(rows))
            writer.end_episode()


def export(play: RawPlay, folder: Path) -> None:
    """Write play in CALVIN's layout, atomically. Tasks and segments have no place there and are left out."""
    with replacing(folder) as temporary:
        temporary.mkdir()
        steps = int(play.episode_ends[-1])
        for i in range(steps):
            states = {key: getattr(play, key)[i].astype(np.float64) for key in STATE_SIZES}
            arrays: dict[str, Any] = {FRAME_KEY: np.asarray(play.frames[i]), **states}
            np.savez_compressed(temporary / f"episode_{i:0{DIGITS}d}.npz", **arrays)
        bounds = np.array([(rows.start, rows.stop - 1) for rows in play.episodes()], dtype=np.int64)
        write_npy(temporary / "ep_start_end_ids.npy", bounds)
        write_npy(temporary / "ep_lens.npy", bounds[:, 1] - bounds[:, 0] + 1)
