"""Import of the published block-push demonstrations (Cui et al. 2023, `multimodal_push_fixed_target`).

N demonstrations padded to T steps:

    multimodal_push_observations.npy   (N, T, 16)
    multimodal_push_actions.npy        (N, T, 2)
    multimodal_push_masks.npy          (N, T), 1 for the steps of the demonstration, then 0
    onehot_goals.pth                   (N, T, 4), 1 at the first entry of each (block, target) pair

Each array may be a .npy or a .pth file of that stem.
"""

from pathlib import Path

import numpy as np

from beso.data.play import Episode, PlayDataset, assemble
from beso.envs import published
from beso.envs.block_push.spec import LONGEST, SPEC
from beso.files import sha256

FILES = {
    "observations": "multimodal_push_observations",
    "actions": "multimodal_push_actions",
    "masks": "multimodal_push_masks",
    "tasks": "onehot_goals",
}
WIDTHS = {"observations": SPEC.observation_size, "actions": SPEC.action_size, "tasks": len(SPEC.tasks)}


def load(folder: Path) -> PlayDataset:
    """Read the published demonstrations.

    Raises:
        UserError: a file is missing or damaged, shapes do not fit together, a mask is not a run of ones followed by
            zeros, or a value is not finite.
    """
    arrays, paths = published.padded(folder, FILES, WIDTHS, LONGEST, ("demonstrations", "steps"))
    episodes = [
        Episode(
            arrays["observations"][i, :length].astype(np.float32),
            arrays["actions"][i, :length].astype(np.float32),
            published.first_entries(arrays["tasks"][i, :length]),
        )
        for i, length in enumerate(published.lengths(arrays["masks"], paths["masks"]))
    ]
    meta = {"source": "published block push", "files": {path.name: sha256(path) for path in paths.values()}}
    return assemble(episodes, SPEC, meta)
