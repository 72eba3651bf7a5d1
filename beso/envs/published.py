"""Reading published play data: padded arrays of demonstrations, as .npy or .pth files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from beso.data.store import read_npy
from beso.errors import UserError


def padded(
    folder: Path, files: Mapping[str, str], widths: Mapping[str, int], longest: int, axes: tuple[str, str]
) -> tuple[dict[str, np.ndarray], dict[str, Path]]:
    """Arrays of demonstrations padded to one length, and the files that they came from, by name.

    Args:
        files: stems of the files; "masks" is among them.
        widths: sizes of the last axis of all others.
        longest: the largest number of steps.
        axes: what the first two axes are: "demonstrations" and "steps", in one order or the other.

    Raises:
        UserError: a file is missing or damaged, or shapes do not fit together.
    """
    paths = {name: find(folder, stem) for name, stem in files.items()}
    arrays = {name: read(path) for name, path in paths.items()}
    shape, where = arrays["masks"].shape, paths["masks"]
    if len(shape) != 2:
        raise UserError(f"{where} has shape {shape}, expected ({', '.join(axes)})")
    for name, width in widths.items():
        if arrays[name].shape != (*shape, width):
            raise UserError(f"{paths[name]} has shape {arrays[name].shape}, expected {(*shape, width)}")
    steps = shape[axes.index("steps")]
    if steps > longest:
        raise UserError(f"{where} has {steps} steps a demonstration, expected at most {longest}")
    return arrays, paths


def find(folder: Path, stem: str) -> Path:
    """The .npy or .pth file of that stem.

    Raises:
        UserError: there is neither.
    """
    for suffix in (".npy", ".pth"):
        if (folder / (stem + suffix)).is_file():
            return folder / (stem + suffix)
    raise UserError(f"{folder / stem}.npy is missing (nor is there a .pth file of that name)")


def read(path: Path) -> np.ndarray:
    """One array; a .pth file is read without unpickling code.

    Raises:
        UserError: the file is damaged, or holds something else.
    """
    if path.suffix == ".npy":
        return read_npy(path)
    try:
        tensor = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds, with advice that does not belong here
        raise UserError(f"{path} is damaged or holds more than plain tensors ({type(error).__name__})") from None
    if not isinstance(tensor, torch.Tensor):
        raise UserError(f"{path} holds a {type(tensor).__name__}, expected one tensor")
    return tensor.detach().numpy()


def lengths(masks: np.ndarray, path: Path) -> np.ndarray:
    """Steps of each demonstration, (N,), from masks (N, T) that are ones followed by zeros.

    Args:
        path: where the masks came from, for messages.

    Raises:
        UserError: a mask is something else.
    """
    counts = (masks > 0).sum(axis=1)
    bad = np.nonzero((counts == 0) | ((masks > 0) != (np.arange(masks.shape[1]) < counts[:, None])).any(axis=1))[0]
    if len(bad):
        raise UserError(f"{path}: the mask of demonstration {bad[0]} is not ones followed by zeros")
    return counts


def first_entries(onehot: np.ndarray) -> np.ndarray:
    """Keep only the first 1 of each column of (T, K)."""
    hot = onehot > 0
    return (hot & (hot.cumsum(axis=0) == 1)).astype(np.uint8)
