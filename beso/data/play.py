"""Play datasets: flat arrays of whole episodes, one after another (beso.data.store).

    observations.npy   (steps, observation_size)  float32, or frames (steps, size, size, 3) uint8, see below
    actions.npy        (steps, action_size)       float32
    tasks.npy          (steps, number of tasks)   uint8, 1 where a task is completed for the first time
    episode_ends.npy   (episodes,)                int64, index one past each episode's last step
    meta.json          source, counts, versions, SHA-256 of the arrays

Episode e is steps [ends[e-1], ends[e]). Row t holds the observation at t and the action taken there.

Observations are frames where policies train an encoder too (beso.encoders.finetuned): meta.json has then an entry
"finetune" with the frames' size and the SHA-256 of the encoder's description, which lies beside the arrays.
"""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from beso.data import store
from beso.data.spec import PlaySpec
from beso.data.store import Column
from beso.errors import UserError

MISSING = "is not a play dataset: it has no meta.json; run `dvc repro collect` first"
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
    def labelled(self) -> bool:
        """Whether it is known which tasks are completed; most published play does not tell, and `tasks` is zero."""
        return self.meta.get("labelled", True) is not False

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
    """Check shapes, types, lengths and values.

    Raises:
        UserError: naming the array, the place and what is wrong with it.
    """
    size = dataset.frame_size
    columns = {
        "observations": Column((size, size, 3), "uint8") if size else Column((spec.observation_size,), "float32"),
        "actions": Column((spec.action_size,), "float32"),
        "tasks": Column((len(spec.tasks),), "uint8"),
    }
    arrays = {name: getattr(dataset, name) for name in ARRAYS}
    store.check(arrays, columns, where)
    for name in columns:
        if arrays[name].dtype.kind == "f" and not np.isfinite(arrays[name]).all():
            step = int(np.argwhere(~np.isfinite(arrays[name]).all(axis=1))[0, 0])
            raise UserError(f"{where}: {name} has a value that is not finite (NaN or infinity), first at step {step}")
    if (dataset.tasks > 1).any():
        raise UserError(f"{where}: tasks hold {dataset.tasks.max()}, expected 0 and 1")


def save(dataset: PlayDataset, folder: Path, beside: Iterable[Path] = ()) -> None:
    """Write a dataset as a folder, atomically, with copies of some files beside it."""
    meta = {**dataset.meta, "counts": {"episodes": len(dataset), "steps": len(dataset.observations)}}
    with store.writing(folder, meta) as temporary:
        for name in ARRAYS:
            store.write_npy(temporary / f"{name}.npy", getattr(dataset, name))
        for path in beside:
            shutil.copyfile(path, temporary / path.name)


def load(folder: Path, spec: PlaySpec, verify: bool = True) -> PlayDataset:
    """Read and check a dataset; the arrays are memory-mapped.

    Args:
        verify: compare the SHA-256 of every array, which reads all of it.

    Raises:
        UserError: the folder is missing, a file is missing, truncated or altered, or a check fails.
    """
    arrays, meta = store.read(folder, ARRAYS, MISSING, verify)
    dataset = PlayDataset(**arrays, meta=_checked(meta, folder))
    check(dataset, spec, str(folder))
    return dataset


def read_digest(folder: Path) -> str:
    """The `data_digest` of a dataset, from its description alone. Raises UserError as `load` does."""
    _, meta = store.read(folder, ARRAYS, MISSING, verify=False)
    nothing = np.empty(0)
    return data_digest(PlayDataset(nothing, nothing, nothing, nothing, _checked(meta, folder)))


def _checked(meta: dict[str, Any], folder: Path) -> dict[str, Any]:
    finetune = meta.get("finetune", {"frame_size": 1, "encoder": ""})
    size, encoder = (finetune.get(key) if isinstance(finetune, dict) else None for key in ("frame_size", "encoder"))
    if type(size) is not int or size < 1 or not isinstance(encoder, str):
        raise UserError(f"{folder / store.META} is damaged: finetune must have frame_size and encoder")
    return meta


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
