"""Import of the published block-push demonstrations (Cui et al. 2023, `multimodal_push_fixed_target`).

N demonstrations padded to T steps:

    multimodal_push_observations.npy   (N, T, 16)
    multimodal_push_actions.npy        (N, T, 2)
    multimodal_push_masks.npy          (N, T), 1 for the steps of the demonstration, then 0
    onehot_goals.pth                   (N, T, 4), 1 at the first entry of each (block, target) pair

Each array may be a .npy or a .pth file of that stem. Or a Minari dataset that `beso export` wrote.
"""

import math
from pathlib import Path

from beso.data.play import Episode, PlayDataset, assemble
from beso.envs import minari_data, published
from beso.envs.block_push.spec import LONGEST, SPEC
from beso.files import sha256

FILES = {
    "observations": "multimodal_push_observations",
    "actions": "multimodal_push_actions",
    "masks": "multimodal_push_masks",
    "tasks": "onehot_goals",
}
# Metres and radians; an action is at most what the environment's action space allows.
LARGEST = {"observations": 2 * math.pi, "actions": 0.1 + 1e-6}
WIDTHS = {"observations": SPEC.observation_size, "actions": SPEC.action_size, "tasks": len(SPEC.tasks)}


def load(folder: Path) -> PlayDataset:
    """Read the published demonstrations.

    Raises:
        UserError: a file is missing or damaged, shapes do not fit together, a mask is not a run of ones followed by
            zeros, or a demonstration is not one of block push (beso.envs.published.check).
    """
    if dataset := minari_data.opened(folder):
        return minari_data.read(dataset, SPEC, LARGEST)
    arrays, paths = published.padded(folder, FILES, WIDTHS, LONGEST, ("demonstrations", "steps"))
    episodes = []
    for i, length in enumerate(published.lengths(arrays["masks"], paths["masks"])):
        observations, actions, tasks = (arrays[name][i, :length] for name in ("observations", "actions", "tasks"))
        where = f"{folder}: demonstration {i}"
        published.check((observations, actions, tasks), SPEC, LARGEST, where, may_fail=bool(length == LONGEST))
        episodes.append(Episode(observations, actions, published.first_entries(tasks)))
    meta = {"source": "published block push", "files": {path.name: sha256(path) for path in paths.values()}}
    return assemble(episodes, SPEC, meta)
