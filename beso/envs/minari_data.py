"""Minari datasets: play of any environment, written and read; and how such a dataset is opened.

    FOLDER/beso/<environment>-v0/data/    with MINARI_DATASETS_PATH=FOLDER: minari.load_dataset("beso/<environment>-v0")

An episode of T steps has, as Minari wants it, T actions and T + 1 observations. Play does not record the observation
after the last action: the last one stands twice.

    observations   (T + 1, O)  float32
    actions        (T, A)      float32
    infos/tasks    (T + 1, K)  uint8, 1 where a task is done for the first time; the last row is zero
    infos/goal     (T + 1, G, O)  float32, the episode's last states, the same in every row: evaluation's kind of goal
    rewards        (T,)        how many tasks the action completed
    terminations, truncations  (T,)  False; the last truncation is True: the recording ends

metadata.json has the tasks' names, and in "play" what the play's meta.json says. The package h5py is imported when a
dataset is opened, minari when one is written: it would make the environment that a file names, which can be any code.
"""

import importlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from beso.data.play import Episode, PlayDataset, assemble
from beso.data.spec import PlaySpec
from beso.envs import published
from beso.errors import UserError
from beso.files import read_json, replacing, sha256

HDF5, METADATA = "main_data.hdf5", "metadata.json"
NAMESPACE = "beso"
NEEDS = "needs the packages minari and h5py: install this project with its extra [minari]"
DESCRIPTION = (
    "Play of the environment {}. The observation after an episode's last action is not recorded: the last one stands "
    "twice. infos/tasks tells where a task is done for the first time, infos/goal is the episode's last states."
)


class Recorded(NamedTuple):
    """What an episode of a Minari dataset holds of play; None where it has something else, or nothing."""

    observations: np.ndarray | None
    actions: np.ndarray | None
    tasks: np.ndarray | None


class Opened(NamedTuple):
    """A Minari dataset: its folder, its episodes, and its metadata.json."""

    folder: Path
    episodes: list[Recorded]
    metadata: dict[str, Any]

    @property
    def path(self) -> Path:
        """The file with the episodes."""
        return self.folder / HDF5

    @property
    def digests(self) -> dict[str, str]:
        """The SHA-256 of the files, by name."""
        return {name: sha256(self.folder / name) for name in (HDF5, METADATA)}

    @property
    def exported(self) -> bool:
        """Whether `write` wrote it."""
        play = self.metadata.get("play")
        return isinstance(play, dict) and isinstance(play.get("source"), str)


def opened(folder: Path) -> Opened | None:
    """The Minari dataset in a folder, or in `data` below it; None if there is none.

    Raises:
        UserError: the files are damaged, or the package is not installed.
    """
    place = next((place for place in (folder, folder / "data") if (place / HDF5).is_file()), None)
    if place is None:
        return None
    path = place / HDF5
    try:
        with importlib.import_module("h5py").File(path, "r") as file:
            names = [f"episode_{i}" for i in range(len(file))]
            episodes = [_recorded(file[name], f"{path}: {name}") for name in names]
    except ImportError as error:
        raise UserError(f"{path} is a Minari dataset; reading it {NEEDS} ({error})") from None
    except UserError:
        raise
    except Exception as error:  # damage shows in many kinds of exception, some with many lines
        raise UserError(f"{path} is damaged or no Minari dataset ({type(error).__name__})") from None
    metadata = read_json(place / METADATA)
    if metadata.get("total_episodes") != len(episodes):
        raise UserError(f"{path} has {len(episodes)} episodes; {METADATA} says {metadata.get('total_episodes')!r:.20}")
    return Opened(place, episodes, metadata)


def _recorded(group: Any, where: str) -> Recorded:
    """The arrays of an episode; observations that have parts are represented by `observation`."""
    observations = _array(group, "observations", where)
    if observations is None:
        observations = _array(group, "observations/observation", where)
    return Recorded(observations, _array(group, "actions", where), _array(group, "infos/tasks", where))


def _array(group: Any, name: str, where: str) -> np.ndarray | None:
    found = group.get(name)
    if not hasattr(found, "nbytes"):
        return None
    size = found.id.get_storage_size()
    if found.dtype.kind not in "biuf" or found.nbytes > size + published.MARGIN:
        raise UserError(f"{where}: {name} is damaged: {found.dtype} {found.shape} in {size} bytes")
    return np.asarray(found[()])


def read(dataset: Opened, spec: PlaySpec, largest: Mapping[str, float]) -> PlayDataset:
    """The play that `write` wrote: the same arrays.

    Args:
        largest: see `published.check`.

    Raises:
        UserError: it is other data, or of another environment, or a check fails.
    """
    said = dataset.metadata
    if not dataset.exported or said.get("tasks") != list(spec.tasks):
        raise UserError(f"{dataset.folder / METADATA} is not that of play of {spec.name} that `beso export` wrote")
    found = []
    for i, recorded in enumerate(dataset.episodes):
        where = f"{dataset.path}: demonstration {i}"
        arrays = [array for array in recorded if array is not None and array.ndim == 2]
        if len(arrays) < len(recorded):
            raise UserError(f"{where}: observations, actions and infos/tasks must be arrays with a row a step")
        observations, actions, tasks = arrays
        episode = observations[:-1], actions, tasks[:-1]
        published.check(episode, spec, largest, where, may_fail=True)
        found.append(Episode(*episode))
    kept = {key: value for key, value in said["play"].items() if key not in ("sha256", "counts", "finetune")}
    return assemble(found, spec, {**kept, "files": dataset.digests})


def write(dataset: PlayDataset, spec: PlaySpec, environment: str, folder: Path) -> str:
    """Write play as a Minari dataset below `folder`, atomically; a dataset of that name is replaced.

    Args:
        environment: its name in gymnasium's registry. It is made once, for its spaces.

    Returns:
        The dataset's name.

    Raises:
        UserError: observations are frames, or the packages are not installed.
    """
    if dataset.frame_size is not None:
        raise UserError(f"play of {spec.name} is frames: Minari would compress them with loss")
    try:
        minari, storage = importlib.import_module("minari"), importlib.import_module("minari.dataset.minari_storage")
        buffer = importlib.import_module("minari.data_collector").EpisodeBuffer
        importlib.import_module("h5py")
    except ImportError as error:
        raise UserError(f"writing a Minari dataset {NEEDS} ({error})") from None
    env, name = importlib.import_module("gymnasium").make(environment), f"{NAMESPACE}/{spec.name}-v0"
    spaces = _space(env.observation_space, dataset.observations), _space(env.action_space, dataset.actions)
    env.close()
    versions = dataset.meta.get("versions", {})
    with replacing((folder / name).resolve()) as temporary:  # h5py is given the path twice if it is relative
        temporary.mkdir()
        written = storage.MinariStorage.new(temporary / "data", *spaces, env_spec=env.spec, data_format="hdf5")
        written.update_metadata(
            {
                "dataset_id": name,
                "minari_version": minari.__version__,
                "algorithm_name": str(dataset.meta.get("source", "unknown")),
                "author": {"beso"},
                "description": DESCRIPTION.format(environment),
                "requirements": [f"{package}=={version}" for package, version in versions.items()],
                "tasks": list(spec.tasks),
                "play": dataset.meta,
            }
        )
        written.update_episodes(buffer(**episode) for episode in _episodes(dataset, spec.goal_window))
    return name


def _episodes(dataset: PlayDataset, goal_window: int) -> Iterator[dict[str, Any]]:
    for start, end in zip(dataset.episode_starts, dataset.episode_ends, strict=True):
        observations, tasks = np.array(dataset.observations[start:end]), np.array(dataset.tasks[start:end])
        after = np.concatenate([tasks[1:], np.zeros_like(tasks[:1])])  # what is done in the state after each action
        goal = observations[-goal_window:]
        ends = np.arange(start, end) == end - 1
        yield {
            "observations": np.concatenate([observations, observations[-1:]]),
            "actions": np.array(dataset.actions[start:end]),
            "rewards": after.sum(axis=1, dtype=np.float64),
            "terminations": np.zeros_like(ends),
            "truncations": ends,
            "infos": {
                "tasks": np.concatenate([tasks, np.zeros_like(tasks[:1])]),
                "goal": np.broadcast_to(goal, (len(observations) + 1, *goal.shape)),
            },
        }


def _space(space: Any, array: np.ndarray) -> Any:
    """The environment's space in the play's type, wide enough for it; without bounds where play is features."""
    box = importlib.import_module("gymnasium").spaces.Box
    if space.shape != array.shape[1:]:
        return box(-np.inf, np.inf, array.shape[1:], array.dtype)
    low, high = np.minimum(space.low, array.min(axis=0)), np.maximum(space.high, array.max(axis=0))
    return box(low.astype(array.dtype), high.astype(array.dtype), dtype=array.dtype)
