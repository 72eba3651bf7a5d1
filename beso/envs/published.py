"""Reading published play data: padded arrays of demonstrations, as .npy or .pth files; and the checks of all importers.

Whatever the source, a demonstration is checked before its numbers become those of a play dataset: `check`.
"""

import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

from beso.checks import numbers
from beso.data.spec import PlaySpec
from beso.data.store import read_npy
from beso.errors import UserError

SUFFIXES = (".npy", ".pth")
NUMPYS = {torch.bool, torch.uint8, torch.int8, torch.int16, torch.int32, torch.int64}
NUMPYS |= {torch.float16, torch.float32, torch.float64}
MARGIN = 1 << 20  # bytes that a .pth file may unpack to beyond its own size


class NothingError(UserError):
    """A folder holds none of the files."""


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
    if not any((folder / (stem + suffix)).is_file() for stem in files.values() for suffix in SUFFIXES):
        wanted = ", ".join(files.values())
        raise NothingError(f"{folder} holds no demonstrations: `folder` must hold {wanted} (.npy or .pth)")
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
        UserError: there is neither, or there are both.
    """
    found = [path for suffix in SUFFIXES if (path := folder / (stem + suffix)).is_file()]
    if len(found) > 1:
        raise UserError(f"{folder / stem} is there as .npy and as .pth: one of them must go")
    if not found:
        raise UserError(f"{folder / stem}.npy is missing (nor is there a .pth file of that name)")
    return found[0]


def read(path: Path) -> np.ndarray:
    """One array; a .pth file is read without unpickling code.

    Raises:
        UserError: the file is damaged, or holds something else.
    """
    if path.suffix == ".npy":
        return read_npy(path)
    size = path.stat().st_size
    try:
        if zipfile.is_zipfile(path):
            with zipfile.ZipFile(path) as archive:
                unpacked = sum(member.file_size for member in archive.infolist())
            if unpacked > size + MARGIN:
                raise UserError(f"{path} is damaged: its {size} bytes would unpack to {unpacked}")
        tensor = torch.load(path, map_location="cpu", weights_only=True)
    except UserError:
        raise
    except Exception as error:  # torch raises many kinds, with advice that does not belong here
        raise UserError(f"{path} is damaged or holds more than plain tensors ({type(error).__name__})") from None
    if not isinstance(tensor, torch.Tensor):
        raise UserError(f"{path} holds a {type(tensor).__name__}, expected one tensor")
    form = "nested" if tensor.is_nested else tensor.layout
    for kind, allowed in ((form, {torch.strided}), (tensor.device.type, {"cpu"}), (tensor.dtype, NUMPYS)):
        if kind not in allowed:
            raise UserError(f"{path} holds a tensor of {kind}, expected plain real numbers".replace("torch.", ""))
    if tensor.numel() * tensor.element_size() > size:
        raise UserError(f"{path} is damaged: {tensor.numel()} numbers in {size} bytes")
    return tensor.detach().resolve_neg().numpy()


def lengths(masks: np.ndarray, path: Path) -> np.ndarray:
    """Steps of each demonstration, (N,), from masks (N, T) that are ones followed by zeros.

    Args:
        path: where the masks came from, for messages.

    Raises:
        UserError: a mask is something else.
    """
    counts = (masks == 1).sum(axis=1)
    bad = np.nonzero((counts == 0) | (masks != (np.arange(masks.shape[1]) < counts[:, None])).any(axis=1))[0]
    if len(bad):
        raise UserError(f"{path}: the mask of demonstration {bad[0]} is not ones followed by zeros")
    return counts


def check(
    episode: tuple[np.ndarray, np.ndarray, np.ndarray],
    spec: PlaySpec,
    largest: Mapping[str, float],
    where: str,
    may_fail: bool = False,
) -> None:
    """Check one demonstration, as it is in its file.

    Args:
        episode: observations (T, O), actions (T, A), and labels of tasks (T, K), zeros and ones.
        largest: what the numbers of "observations" and "actions" reach at most, up or down.
        where: what it is, for messages.
        may_fail: it need not complete a task: it ran into its limit.

    Raises:
        UserError: lengths or widths differ, a number is not real, not finite or out of range, a label is neither 0 nor
            1, or no task is completed.
    """
    steps = len(episode[0])
    widths = {"observations": spec.observation_size, "actions": spec.action_size, "tasks": len(spec.tasks)}
    for array, (name, width) in zip(episode, widths.items(), strict=True):
        within(f"{where}: {name}", numbers(f"{where}: {name}", array, (steps, width)), largest.get(name, 1))
    labels = episode[2]
    if not np.isin(labels, (0, 1)).all():
        raise UserError(f"{where}: tasks hold {labels[~np.isin(labels, (0, 1))][0]}, expected 0 and 1")
    if not labels.any() and not may_fail:
        raise UserError(f"{where}: no task is completed")


def within(what: str, array: np.ndarray, largest: float) -> None:
    """Raise UserError if finite numbers reach beyond `largest`, up or down."""
    worst = max(float(array.max(initial=0)), -float(array.min(initial=0)))
    if worst > largest:
        raise UserError(f"{what} reach {worst:.6g}, expected at most {largest:g}")


def first_entries(onehot: np.ndarray) -> np.ndarray:
    """Keep only the first 1 of each column of (T, K)."""
    hot = onehot > 0
    return (hot & (hot.cumsum(axis=0) == 1)).astype(np.uint8)
