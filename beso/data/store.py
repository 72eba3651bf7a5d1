"""Folders of arrays: what play datasets, raw play, packed frames and trials have in common on disk.

    <name>.npy   an array each, memory-mapped when read; nothing is unpickled
    meta.json    what the writer says of them, and their SHA-256 by name

Rows are steps of whole episodes, one after another; `episode_ends` has the index one past each episode's last step.
A stage verifies the SHA-256 of what it reads once; the jobs that it starts need not do it again.
"""

import math
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from beso.errors import UserError
from beso.files import check_sha256, read_json, replacing, sha256, write_json

META: Final = "meta.json"
ENDS: Final = "episode_ends"


class Column(NamedTuple):
    """An array with a row a step: the shape of a row, None for any size, and the type of its numbers."""

    row: tuple[int | None, ...]
    dtype: str


@contextmanager
def writing(folder: Path, meta: dict[str, Any]) -> Iterator[Path]:
    """Yield a temporary folder for the arrays; `folder` appears when all is written, or not at all.

    Args:
        meta: for meta.json; it gets the SHA-256 of the arrays, "sha256".
    """
    with replacing(folder) as temporary:
        temporary.mkdir()
        yield temporary
        meta["sha256"] = digests(temporary, (path.stem for path in temporary.glob("*.npy")))
        write_json(temporary / META, meta)


def digests(folder: Path, names: Iterable[str]) -> dict[str, str]:
    """The SHA-256 of some arrays of a folder, by name."""
    return {name: sha256(folder / f"{name}.npy") for name in names}


def read(
    folder: Path, names: Iterable[str] | None, missing: str, verify: bool = True, description: str = META
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays by name, memory-mapped, and the description beside them.

    Args:
        names: of the arrays; None is all that the description names.
        missing: what to say of a folder without description.
        verify: compare the SHA-256 of every array, which reads all of it.
        description: the file's name.

    Raises:
        UserError: a file is missing, truncated or altered.
    """
    path = folder / description
    if not path.is_file():
        raise UserError(f"{folder} {missing}")
    meta = read_json(path)
    known = meta.get("sha256")
    names = known if names is None else names
    if not isinstance(known, dict) or not all(isinstance(known.get(name), str) for name in names or ()):
        raise UserError(f"{path} is damaged: sha256 must hold the SHA-256 of every array")
    arrays = {name: read_npy(folder / f"{name}.npy") for name in names or ()}
    for name in arrays if verify else ():
        check_sha256(folder / f"{name}.npy", known[name], description)
    return arrays, meta


def check(arrays: Mapping[str, np.ndarray], columns: Mapping[str, Column], where: str) -> None:
    """Check shapes and types of columns, and that episodes follow one another to their last row.

    Raises:
        UserError: naming the array, and what is wrong with it.
    """
    steps = len(arrays[next(iter(columns))]) if arrays[next(iter(columns))].ndim else 0
    for name, (row, dtype) in columns.items():
        array = arrays[name]
        free = array.shape[1:] if array.ndim == 1 + len(row) else row
        expected = (steps, *(there if size is None else size for size, there in zip(row, free, strict=True)))
        if array.shape != expected or array.dtype != dtype:
            raise UserError(f"{where}: {name} holds {array.dtype} {array.shape}, expected {dtype} {expected}")
    ends = arrays[ENDS]
    rising = ends.ndim == 1 and ends.dtype == np.int64 and len(ends) > 0 and (np.diff(ends, prepend=0) > 0).all()
    if not rising or ends[-1] != steps:
        raise UserError(f"{where}: {ENDS} does not rise from above 0 to the number of steps, {steps}")


def read_npz(path: Path, names: Iterable[str], largest: int) -> dict[str, np.ndarray]:
    """Some arrays of an .npz file, without unpickling anything.

    Args:
        largest: bytes that an array may have; what its header says is compared before it is read.

    Raises:
        UserError: the file is missing or damaged, has no array of a name, or one that is too large or not of real
            numbers.
    """
    found = {}
    try:
        with zipfile.ZipFile(path) as archive:
            members = set(archive.namelist())
            for name in names:
                if f"{name}.npy" not in members:
                    raise UserError(f"{path} has no array of this name: {name}")
                with archive.open(f"{name}.npy") as file:
                    version = np.lib.format.read_magic(file)
                    headers = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
                    shape, _, dtype = headers[version](file)
                if dtype.kind not in "biuf" or math.prod(shape) * dtype.itemsize > largest:
                    kind = f"real numbers, {largest} bytes at most"
                    raise UserError(f"{path}: {name} holds {dtype} {shape}, expected {kind}")
                with archive.open(f"{name}.npy") as file:
                    found[name] = np.lib.format.read_array(file, allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"{path} is missing") from None
    except UserError:
        raise
    except Exception as error:  # zipfile, zlib and numpy raise many kinds, some with advice to unpickle the file
        raise UserError(f"{path} is truncated or is not an .npz file ({type(error).__name__})") from None
    return found


def write_npy(path: Path, array: np.ndarray) -> None:
    """Write one .npy file; unlike numpy.save, a full disk is reported as such."""
    write_npy_parts(path, array.shape, array.dtype, [array])


def write_npy_parts(path: Path, shape: tuple[int, ...], dtype: npt.DTypeLike, parts: Iterable[np.ndarray]) -> None:
    """Write one .npy file of this shape, part by part along its first axis."""
    with path.open("wb") as file:
        _write_header(file, shape, np.dtype(dtype))
        for part in parts:
            file.write(np.ascontiguousarray(part, dtype=dtype).data)


def _write_header(file: BinaryIO, shape: tuple[int, ...], dtype: np.dtype) -> None:
    header = {"descr": np.lib.format.dtype_to_descr(dtype), "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, header)


class GrowingArray:
    """A .npy file that rows are appended to. Its header leaves room for any number of rows and is written twice."""

    def __init__(self, path: Path, dtype: str) -> None:
        self._file: BinaryIO = path.open("wb")
        self._dtype = np.dtype(dtype)
        self._row: tuple[int, ...] | None = None
        self.rows = 0

    def append(self, array: np.ndarray) -> None:
        """Append rows, all of one shape."""
        if self._row is None:
            self._row = array.shape[1:]
            _write_header(self._file, (0, *self._row), self._dtype)
        if array.shape[1:] != self._row:
            raise ValueError(f"rows of shape {array.shape[1:]} after rows of shape {self._row}")
        self._file.write(np.ascontiguousarray(array, dtype=self._dtype).data)
        self.rows += len(array)

    def close(self) -> None:
        """Write what is left; the file is whole only now."""
        if self._row is not None:
            end = self._file.tell()
            self._file.seek(0)
            _write_header(self._file, (self.rows, *self._row), self._dtype)
            # Appended rows follow the first header, so the second must be as long.
            if self._file.tell() + self.rows * self._dtype.itemsize * int(np.prod(self._row)) != end:
                raise RuntimeError("numpy wrote two headers of unequal length")
        self._file.close()


def read_npy(path: Path) -> np.ndarray:
    """Memory-map one .npy file without unpickling anything.

    Raises:
        UserError: the file is missing, truncated, or not an array of real numbers.
    """
    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except FileNotFoundError:
        raise UserError(f"{path} is missing") from None
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror or error})") from None
    except Exception:  # numpy raises many kinds, some with advice to unpickle the file
        raise UserError(f"{path} is truncated or is not a .npy array of numbers") from None
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
        kind = array.dtype if isinstance(array, np.ndarray) else "several arrays"
        raise UserError(f"{path} is not a .npy array of numbers: it holds {kind}")
    return array
