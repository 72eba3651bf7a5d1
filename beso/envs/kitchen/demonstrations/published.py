"""Import of human demonstrations of the kitchen from a local folder, in either of two published forms.

The relay demonstrations as conditional behaviour transformers use them (Cui et al. 2023, after Gupta et al. 2019): N
demonstrations padded to T steps, time first. Each array may be a .npy or a .pth file of that stem.

    observations_seq   (T, N, 60)  30 numbers as the simulator has them, then a goal that is not used
    actions_seq        (T, N, 9)
    existence_mask     (T, N)      1 for the steps of the demonstration, then 0
    onehot_goals       (T, N, 7)   1 at the task that is being done; a task's last 1 is taken for its completion

Or a Minari dataset of FrankaKitchen-v1 (D4RL/kitchen/...): the folder that holds main_data.hdf5, or its parent. Its
observations have velocities, which are left out; what is done when is read off the observations. One that `beso export`
wrote is read as it is.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from beso.checks import numbers
from beso.data.play import Episode, PlayDataset, assemble
from beso.envs import minari_data, published
from beso.envs.kitchen.spec import OBJECTS, ROBOT, SPEC, done
from beso.envs.minari_data import HDF5, Opened, Recorded
from beso.errors import UserError
from beso.files import sha256

FILES = {
    "observations": "observations_seq",
    "actions": "actions_seq",
    "masks": "existence_mask",
    "tasks": "onehot_goals",
}
WIDTHS = {"observations": 60, "actions": SPEC.action_size, "tasks": len(SPEC.tasks)}
COLUMNS = (  # of onehot_goals
    "bottom burner",
    "top burner",
    "light switch",
    "slide cabinet",
    "hinge cabinet",
    "microwave",
    "kettle",
)
LONGEST = 409  # steps of the longest published demonstration

FRANKA_KITCHEN_WIDTH = 59

# rad or m: the widest bound in the robot's and kitchen's configuration is 10.57
LARGEST = {"observations": 11.0, "actions": 1.0 + 1e-6}


def load(folder: Path) -> PlayDataset:
    """Read published demonstrations, relay arrays or a Minari dataset, whichever the folder holds.

    Raises:
        UserError: a file is missing or damaged, shapes do not fit together, a mask is not a run of ones followed by
            zeros, a value is not finite or out of range, or the package that reads the files is not installed.
    """
    if dataset := minari_data.opened(folder):
        return _load_minari(dataset)
    try:
        return _load_relay(folder)
    except published.NothingError:
        raise UserError(
            f"{folder} holds no demonstrations: `folder` must hold {', '.join(FILES.values())} (.npy or .pth), or be a "
            f"Minari dataset of FrankaKitchen-v1 in HDF5 format, with data/{HDF5}"
        ) from None


def _load_relay(folder: Path) -> PlayDataset:
    arrays, paths = published.padded(folder, FILES, WIDTHS, LONGEST, ("steps", "demonstrations"))
    columns = [COLUMNS.index(task) for task in SPEC.tasks]
    episodes = []
    for i, length in enumerate(published.lengths(arrays["masks"].T, paths["masks"])):
        observations, actions, tasks = (arrays[name][:length, i] for name in ("observations", "actions", "tasks"))
        observations = observations[:, : SPEC.observation_size]
        published.check((observations, actions, tasks), SPEC, LARGEST, f"{folder}: demonstration {i}")
        # A task is completed at its last 1.
        episodes.append(Episode(observations, actions, published.first_entries(tasks[::-1, columns])[::-1]))
    files = {path.name: sha256(path) for path in paths.values()}
    return assemble(episodes, SPEC, {"source": "published relay kitchen", "files": files})


def _load_minari(dataset: Opened) -> PlayDataset:
    if dataset.exported:
        return minari_data.read(dataset, SPEC, LARGEST)
    episodes = list(_minari_episodes(dataset.episodes, dataset.path))
    return assemble(episodes, SPEC, {"source": "Minari kitchen", "files": dataset.digests})


def _minari_episodes(recorded: list[Recorded], path: Path) -> Iterator[Episode]:
    for i, episode in enumerate(recorded):
        where = f"{path}: demonstration {i}"
        if episode.observations is None or episode.actions is None:
            raise UserError(f"{where} has not the observations and actions of FrankaKitchen-v1")
        # One observation more than actions: the last one, in which nothing was done, is left out.
        expected = (len(episode.actions) + 1 if episode.actions.ndim else None, FRANKA_KITCHEN_WIDTH)
        states = numbers(f"{where}: observations", episode.observations, expected)[:-1]
        coordinates = np.concatenate([states[:, ROBOT], states[:, OBJECTS]], axis=1)
        tasks = done(coordinates)
        published.check((coordinates, episode.actions, tasks), SPEC, LARGEST, where)
        yield Episode(coordinates, episode.actions, published.first_entries(tasks))
