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
from beso.errors import UserError
from beso.files import sha256

FILES = {
    "observations": "multimodal_push_observations",
    "actions": "multimodal_push_actions",
    "masks": "multimodal_push_masks",
    "tasks": "onehot_goals",
}


def load(folder: Path) -> PlayDataset:
    """Read the published demonstrations.

    Raises:
        UserError: a file is missing or damaged, shapes do not fit together, a mask is not a run of ones followed by
            zeros, or a value is not finite.
    """
    paths = {name: published.find(folder, stem) for name, stem in FILES.items()}
    arrays = {name: published.read(path) for name, path in paths.items()}
    masks = arrays["masks"]
    if masks.ndim != 2:
        raise UserError(f"{paths['masks']} has shape {masks.shape}, expected (demonstrations, steps)")
    widths = {"observations": SPEC.observation_size, "actions": SPEC.action_size, "tasks": len(SPEC.tasks)}
    for name, width in widths.items():
        if arrays[name].shape != (*masks.shape, width):
            raise UserError(f"{paths[name]} has shape {arrays[name].shape}, expected {(*masks.shape, width)}")
    if masks.shape[1] > LONGEST:
        raise UserError(f"{paths['masks']} has {masks.shape[1]} steps a demonstration, expected at most {LONGEST}")
    episodes = [
        Episode(
            arrays["observations"][i, :length].astype(np.float32),
            arrays["actions"][i, :length].astype(np.float32),
            published.first_entries(arrays["tasks"][i, :length]),
        )
        for i, length in enumerate(published.lengths(masks, paths["masks"]))
    ]
    meta = {"source": "published block push", "files": {path.name: sha256(path) for path in paths.values()}}
    return assemble(episodes, SPEC, meta)
