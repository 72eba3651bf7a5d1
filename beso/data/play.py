"""Play datasets: flat arrays of whole episodes, one after another.

    observations.npy   (steps, observation_size)  float32, or frames (steps, size, size, 3) uint8, see below
    actions.npy        (steps, action_size)       float32
    tasks.npy          (steps, number of tasks)   uint8, 1 where a task is completed for the first time
    episode_ends.npy   (episodes,)                int64, index one past each episode's last step
    meta.json          source, counts, versions, SHA-256 of the arrays

Episode e is steps [ends[e-1], ends[e]). Row t holds the observation at t and the action taken there.

Observations are frames where policies train an encoder too (beso.images.finetuned): meta.json has then an entry
"finetune" with the frames' size and the SHA-256 of the encoder's description, which lies beside the arrays.
"""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from beso.data.spec import PlaySpec
from beso.errors import UserError
from beso.files import check_sha256, read_json, replacing, sha256, write_json

ARRAYS = ("observations", "actions", "tasks", "episode_ends")


@dataclass(frozen=True)
class Episode:
    """One recorded episode of T steps.

    Attributes:
        observations, actions, tasks: (T, O), (T, A), and first completions of tasks (T, K).
        failed_takes: how often its demonstrator failed and began anew.
    """

    observations: np.ndarray
    actions: np.ndarray
    tasks: np.ndarray
    failed_takes: int = 0


@dataclass(frozen=True)
class PlayDataset:
    """A play dataset in memory (memory-mapped when loaded). See the module for the arrays."""

    observations: np.ndarray
    actions: np.ndarray
    tasks: np.ndarray
    episode_ends: np.ndarray
    meta: dict[str, Any]

    def __len__(self) -> int:
        """Number of episodes."""
        return len(self.episode_ends)

    @property
    def frame_size(self) -> int | None:
        """Height and width where observations are frames, pixels."""
        return self.meta.get("finetune", {}).get("frame_size")

    @property
    def episode_starts(self) -> np.ndarray:
        """Index of each episode's first step, (episodes,)."""
        return np.concatenate([[0], self.episode_ends[:-1]])

    @property
    def lengths(self) -> np.ndarray:
        """Steps of each episode, (episodes,)."""
        return self.episode_ends - self.episode_starts

    def completed(self, episode: int) -> tuple[int, ...]:
        """Tasks completed in an episode, in order of their first completion."""
        steps, tasks = np.nonzero(self.tasks[self.episode_starts[episode] : self.episode_ends[episode]])
        return tuple(int(task) for task in tasks[np.argsort(steps, kind="stable")])


def assemble(episodes: Iterable[Episode], spec: PlaySpec, meta: dict[str, Any]) -> PlayDataset:
    """Join episodes into one dataset and check it."""
    episodes = list(episodes)
    if len(episodes) < 2:
        raise UserError(f"{meta.get('source')}: {len(episodes)} episodes, at least two are needed")
    dataset = PlayDataset(
        observations=np.concatenate([e.observations for e in episodes]).astype(np.float32),
        actions=np.concatenate([e.actions for e in episodes]).astype(np.float32),
        tasks=np.concatenate([e.tasks for e in episodes]).astype(np.uint8),
        episode_ends=np.cumsum([len(e.actions) for e in episodes]).astype(np.int64),
        meta=meta,
    )
    check(dataset, spec, meta.get("source", "recorded episodes"))
    return dataset


def check(dataset: PlayDataset, spec: PlaySpec, where: str) -> None:
    """Check shapes, lengths and values.

    Raises:
        UserError: naming the array, the place and what is wrong with it.
    """
    steps, size = len(dataset.observations), dataset.frame_size
    shapes: dict[str, tuple[int, ...]] = {
        "observations": (steps, spec.observation_size) if size is None else (steps, size, size, 3),
        "actions": (steps, spec.action_size),
        "tasks": (steps, len(spec.tasks)),
    }
    for name, expected in shapes.items():
        array = getattr(dataset, name)
        if array.shape != expected:
            raise UserError(f"{where}: {name} has shape {array.shape}, expected {expected}")
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            step = int(np.argwhere(~np.isfinite(array).all(axis=1))[0, 0])
            raise UserError(f"{where}: {name} has a value that is not finite (NaN or infinity), first at step {step}")
    ends = dataset.episode_ends
    if len(ends) == 0 or ends[-1] != steps or (np.diff(ends, prepend=0) <= 0).any():
        raise UserError(f"{where}: episode_ends does not rise from above 0 to the number of steps, {steps}")


def save(dataset: PlayDataset, folder: Path, beside: Iterable[Path] = ()) -> None:
    """Write a dataset as a folder, atomically, with copies of some files beside it."""
    with replacing(folder) as temporary:
        temporary.mkdir()
        for name in ARRAYS:
            write_npy(temporary / f"{name}.npy", getattr(dataset, name))
        for path in beside:
            shutil.copyfile(path, temporary / path.name)
        counts = {"episodes": len(dataset), "steps": len(dataset.observations)}
        digests = {name: sha256(temporary / f"{name}.npy") for name in ARRAYS}
        write_json(temporary / "meta.json", {**dataset.meta, "counts": counts, "sha256": digests})


def load(folder: Path, spec: PlaySpec) -> PlayDataset:
    """Read and check a dataset; the arrays are memory-mapped.

    Raises:
        UserError: the folder is missing, a file is missing, truncated or altered, or a check fails.
    """
    if not (folder / "meta.json").is_file():
        raise UserError(f"{folder} is not a play dataset: it has no meta.json; run `dvc repro collect` first")
    meta = read_json(folder / "meta.json")
    digests = meta.get("sha256", {})
    arrays = {}
    for name in ARRAYS:
        arrays[name] = read_npy(folder / f"{name}.npy")
        check_sha256(folder / f"{name}.npy", digests.get(name), "meta.json")
    dataset = PlayDataset(**arrays, meta=meta)
    check(dataset, spec, str(folder))
    return dataset


def write_npy(path: Path, array: np.ndarray) -> None:
    """Write one .npy file; unlike numpy.save, a full disk is reported as such."""
    write_npy_parts(path, array.shape, array.dtype, [array])


def write_npy_parts(path: Path, shape: tuple[int, ...], dtype: npt.DTypeLike, parts: Iterable[np.ndarray]) -> None:
    """Write one .npy file of this shape, part by part along its first axis."""
    header = {"descr": np.lib.format.dtype_to_descr(np.dtype(dtype)), "fortran_order": False, "shape": shape}
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        for part in parts:
            file.write(np.ascontiguousarray(part, dtype=dtype).data)


def read_npy(path: Path) -> np.ndarray:
    """Memory-map one .npy file without unpickling anything.

    Raises:
        UserError: the file is missing, truncated, or not a plain array.
    """
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(array, np.ndarray):
            raise ValueError("it is an archive of several")
        return array
    except FileNotFoundError:
        raise UserError(f"{path} is missing") from None
    except (ValueError, EOFError, OSError) as error:
        raise UserError(f"{path} is truncated or is not a .npy array of numbers ({error})") from None


def data_digest(dataset: PlayDataset) -> str:
    """One string that changes when any array does, or the encoder that is trained on."""
    digests = [dataset.meta["sha256"][name] for name in ARRAYS]
    if dataset.frame_size is not None:
        digests.append(dataset.meta["finetune"]["encoder"])
    return "-".join(digest[:16] for digest in digests)


def split_episodes(episodes: int, train_fraction: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Indices of training and held-out episodes, in random order; at least one of each."""
    order = rng.permutation(episodes)
    count = min(max(int(train_fraction * episodes), 1), episodes - 1)
    return order[:count], order[count:]
