"""Folders of arrays: what is written, and what of a damaged folder is refused in one line."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from beso.data import store
from beso.errors import UserError
from beso.files import sha256

COLUMNS = {"rows": store.Column((None, 2), "float32"), "marks": store.Column((), "uint8")}


@pytest.fixture
def folder(tmp_path):
    meta = {"source": "here"}
    with store.writing(tmp_path / "arrays", meta) as temporary:
        store.write_npy(temporary / "rows.npy", np.ones((3, 4, 2), dtype=np.float32))
        store.write_npy(temporary / "marks.npy", np.zeros(3, dtype=np.uint8))
        store.write_npy(temporary / "episode_ends.npy", np.array([1, 3]))
    return tmp_path / "arrays"


def read(folder, **options):
    return store.read(folder, [*COLUMNS, "episode_ends"], "is no such folder", **options)


def refused(message, function, *arguments, **options):
    with pytest.raises(UserError, match=message) as caught:
        function(*arguments, **options)
    assert len(str(caught.value).splitlines()) == 1
    assert "allow_pickle" not in str(caught.value)


def test_what_is_written_is_read_memory_mapped(folder):
    arrays, meta = read(folder)
    store.check(arrays, COLUMNS, "here")
    assert isinstance(arrays["rows"], np.memmap)
    assert meta["source"] == "here"
    assert meta["sha256"] == {path.stem: sha256(path) for path in folder.glob("*.npy")}


def test_nothing_is_left_of_a_folder_that_was_not_written_whole(tmp_path):
    with pytest.raises(RuntimeError), store.writing(tmp_path / "arrays", {}):
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_altered_arrays_are_noticed_where_they_are_verified(folder):
    store.write_npy(folder / "marks.npy", np.ones(3, dtype=np.uint8))
    refused("marks.npy is not the file that meta.json describes", read, folder)
    assert read(folder, verify=False)[0]["marks"].all()


@pytest.mark.parametrize("digests", [5, None, [], {}, {"rows": 5, "marks": 5, "episode_ends": 5}])
def test_a_description_without_digests_is_refused(folder, digests):
    (folder / "meta.json").write_text(json.dumps({"sha256": digests}))
    refused("meta.json is damaged: sha256 must hold the SHA-256 of every array", read, folder)


@pytest.mark.parametrize(
    ("name", "array", "message"),
    [
        ("rows", np.ones((3, 4, 3), dtype=np.float32), r"rows holds float32 \(3, 4, 3\), expected float32 \(3, 4, 2\)"),
        ("rows", np.ones((3, 4, 2)), r"rows holds float64 \(3, 4, 2\), expected float32 \(3, 4, 2\)"),
        ("rows", np.float32(1), r"rows holds float32 \(\), expected"),
        ("marks", np.ones(2, dtype=np.uint8), r"marks holds uint8 \(2,\), expected uint8 \(3,\)"),
        ("episode_ends", np.array([1.0, 3.0]), "episode_ends does not rise"),
        ("episode_ends", np.array([[1, 3]]), "episode_ends does not rise"),
        ("episode_ends", np.array([3, 3]), "episode_ends does not rise"),
        ("episode_ends", np.array([1, 4]), "episode_ends does not rise"),
        ("episode_ends", np.array([], dtype=np.int64), "episode_ends does not rise"),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(folder, name, array, message):
    arrays = {**read(folder)[0], name: array}
    refused(message, store.check, arrays, COLUMNS, "here")


@pytest.mark.parametrize("array", [np.array(["a"]), np.array([1j]), np.array([None]), np.array(["2020"], "datetime64")])
def test_what_is_no_array_of_real_numbers_is_refused(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    refused(r"a\.npy is .*not a \.npy array of numbers", store.read_npy, tmp_path / "a.npy")


@pytest.mark.filterwarnings("ignore:overflow encountered")
def test_a_header_that_tells_of_more_than_the_file_holds_allocates_nothing(tmp_path):
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (1 << 60,)})
    refused(r"a\.npy is truncated", store.read_npy, tmp_path / "a.npy")


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """The bytes of a .npy and of an .npz file, and where to write others."""
    folder = tmp_path_factory.mktemp("good")
    np.save(folder / "a.npy", np.arange(6.0))
    np.savez_compressed(folder / "a.npz", a=np.arange(6.0))
    return folder, (folder / "a.npy").read_bytes(), (folder / "a.npz").read_bytes()


changes = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 255)), max_size=4)


@pytest.mark.filterwarnings("ignore")
@settings(max_examples=150, deadline=None)
@given(changes=changes, cut=st.integers(0, 400), packed=st.booleans())
def test_a_changed_file_is_read_or_refused_in_one_line(good, changes, cut, packed):
    folder, *files = good
    content = bytearray(files[packed])
    for place, value in changes:
        content[place % len(content)] = value
    path = folder / f"changed.np{'yz'[packed]}"
    path.write_bytes(content[: len(content) - cut % 50])
    message = ""
    try:
        if packed:
            store.read_npz(path, ["a"], 1 << 20)
        else:
            np.array(store.read_npy(path))
    except UserError as error:
        message = str(error)
    assert len(message.splitlines()) <= 1
    assert "pickle" not in message
