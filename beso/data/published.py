"""Import of published play data from a local folder.

Block push (Cui et al. 2023, `multimodal_push_fixed_target`), N demonstrations padded to T steps:

    multimodal_push_observations.npy   (N, T, 16)
    multimodal_push_actions.npy        (N, T, 2)
    multimodal_push_masks.npy          (N, T), 1 for the steps of the demonstration, then 0
    onehot_goals.pth                   (N, T, 4), 1 at the first entry of each (block, target) pair

Each array may be a .npy or a .pth file of that stem.
"""

from pathlib import Path

import numpy as np
import torch

from beso.data.play import Episode, PlayDataset, assemble, read_npy
from beso.data.spec import PlaySpec
from beso.errors import UserError
from beso.files import sha256

BLOCK_PUSH_FILES = {
    "observations": "multimodal_push_observations",
    "actions": "multimodal_push_actions",
    "masks": "multimodal_push_masks",
    "tasks": "onehot_goals",
}


def load_block_push(folder: Path, spec: PlaySpec) -> PlayDataset:
    """Read the published block-push demonstrations.

    Raises:
        UserError: a file is missing or damaged, shapes do not fit together, a mask is not a run of ones followed by
            zeros, or a value is not finite.
    """
    paths = {name: _find(folder, stem) for name, stem in BLOCK_PUSH_FILES.items()}
    arrays = {name: _read(path) for name, path in paths.items()}
    masks = arrays["masks"]
    if masks.ndim != 2:
        raise UserError(f"{paths['masks']} has shape {masks.shape}, expected (demonstrations, steps)")
    widths = {"observations": spec.observation_size, "actions": spec.action_size, "tasks": len(spec.tasks)}
    for name, width in widths.items():
        if arrays[name].shape != (*masks.shape, width):
            raise UserError(f"{paths[name]} has shape {arrays[name].shape}, expected {(*masks.shape, width)}")
    if masks.shape[1] > spec.longest:
        raise UserError(f"{paths['masks']} has {masks.shape[1]} steps a demonstration, expected at most {spec.longest}")
    lengths = (masks > 0).sum(axis=1)
    bad = np.nonzero((lengths == 0) | ((masks > 0) != (np.arange(masks.shape[1]) < lengths[:, None])).any(axis=1))[0]
    if len(bad):
        raise UserError(f"{paths['masks']}: the mask of demonstration {bad[0]} is not ones followed by zeros")
    episodes = [
        Episode(
            arrays["observations"][i, :length].astype(np.float32),
            arrays["actions"][i, :length].astype(np.float32),
            _first_entries(arrays["tasks"][i, :length]),
        )
        for i, length in enumerate(lengths)
    ]
    meta = {"source": "published block push", "files": {path.name: sha256(path) for path in paths.values()}}
    return assemble(episodes, spec, meta)


def _first_entries(onehot: np.ndarray) -> np.ndarray:
    """Keep only the first 1 of each column."""
    hot = onehot > 0
    return (hot & (hot.cumsum(axis=0) == 1)).astype(np.uint8)


def _find(folder: Path, stem: str) -> Path:
    for suffix in (".npy", ".pth"):
        if (folder / (stem + suffix)).is_file():
            return folder / (stem + suffix)
    raise UserError(f"{folder / stem}.npy is missing (nor is there a .pth file of that name)")


def _read(path: Path) -> np.ndarray:
    """One array; a .pth file is read without unpickling code."""
    if path.suffix == ".npy":
        return read_npy(path)
    try:
        tensor = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds, with advice that does not belong here
        raise UserError(f"{path} is damaged or holds more than plain tensors ({type(error).__name__})") from None
    if not isinstance(tensor, torch.Tensor):
        raise UserError(f"{path} holds a {type(tensor).__name__}, expected one tensor")
    return tensor.detach().numpy()


IMPORTERS = {"block_push": load_block_push}
