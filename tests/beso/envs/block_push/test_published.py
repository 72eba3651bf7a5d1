"""Import of files in the published layout: demonstrations first, padded with zeros."""

import pathlib
import zipfile

import numpy as np
import pytest
import torch

from beso.envs.block_push.demonstrations.published import load
from beso.envs.block_push.spec import LONGEST
from beso.errors import UserError
from beso.files import sha256

LENGTHS = [5, 8, 3]
STEPS = 8
NAMES = ("multimodal_push_observations", "multimodal_push_actions", "multimodal_push_masks", "onehot_goals")


@pytest.fixture
def arrays():
    rng = np.random.default_rng(0)
    masks = (np.arange(STEPS) < np.array(LENGTHS)[:, None]).astype(np.float64)
    tasks = np.zeros((3, STEPS, 4), dtype=np.float32)
    tasks[:, 1, 2] = tasks[:, 2, 1] = 1
    tasks[0, 4, 2] = 1  # left and entered again: not a first completion
    observations = rng.standard_normal((3, STEPS, 16)) * masks[..., None]
    actions = rng.uniform(-0.1, 0.1, (3, STEPS, 2)) * masks[..., None]
    return dict(zip(NAMES, (observations, actions, masks, tasks), strict=True))


@pytest.fixture
def write(arrays, tmp_path):
    """write(**changes) -> folder with the files; None leaves one out."""

    def write(**changes):
        for name, array in {**arrays, **changes}.items():
            if array is None:
                continue
            if name == "onehot_goals":
                torch.save(torch.from_numpy(array), tmp_path / f"{name}.pth")
            else:
                np.save(tmp_path / f"{name}.npy", array)
        return tmp_path

    return write


def refused(message, folder, spec):
    with pytest.raises(UserError, match=message) as caught:
        load(folder)
    assert len(str(caught.value).splitlines()) == 1


def test_reads_the_steps_of_every_demonstration_and_no_padding(write, arrays, spec):
    data = load(write())
    assert data.lengths.tolist() == LENGTHS
    for i, length in enumerate(LENGTHS):
        steps = slice(data.episode_starts[i], data.episode_ends[i])
        assert np.array_equal(data.observations[steps], arrays[NAMES[0]][i, :length].astype(np.float32))
        assert np.array_equal(data.actions[steps], arrays[NAMES[1]][i, :length].astype(np.float32))
        assert data.completed(i) == (2, 1)
        assert data.tasks[steps].sum() == 2, "the second entry of a pair is not a completion"


def test_the_description_names_the_files_and_their_digests(write, spec):
    folder = write()
    files = load(folder).meta["files"]
    assert files == {path.name: sha256(path) for path in folder.iterdir()}


def test_every_array_may_be_a_pth_file(write, arrays, spec):
    folder = write()
    expected = load(folder)
    for name in NAMES[:3]:
        (folder / f"{name}.npy").unlink()
        torch.save(torch.from_numpy(arrays[name]), folder / f"{name}.pth")
    data = load(folder)
    assert np.array_equal(data.observations, expected.observations)
    assert np.array_equal(data.episode_ends, expected.episode_ends)


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_file_is_refused(write, spec, name):
    refused(rf"{name}.npy is missing \(nor is there a .pth", write(**{name: None}), spec)


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        (NAMES[0], (3, STEPS, 10)),
        (NAMES[0], (STEPS, 3, 16)),
        (NAMES[1], (3, STEPS, 3)),
        (NAMES[1], (3, STEPS - 1, 2)),
        (NAMES[2], (3, STEPS, 1)),
        (NAMES[3], (2, STEPS, 4)),
    ],
)
def test_shapes_that_do_not_fit_together_are_refused(write, spec, name, shape):
    refused(rf"{name}\.\w+ has shape \({', '.join(map(str, shape))}\), expected", write(**{name: np.ones(shape)}), spec)


def test_a_mask_with_a_hole_is_refused(write, arrays, spec):
    masks = arrays[NAMES[2]].copy()
    masks[1, 3] = 0
    refused("mask of demonstration 1 is not ones followed by zeros", write(**{NAMES[2]: masks}), spec)


def test_an_empty_demonstration_is_refused(write, arrays, spec):
    masks = arrays[NAMES[2]].copy()
    masks[2] = 0
    refused("mask of demonstration 2 is not ones followed by zeros", write(**{NAMES[2]: masks}), spec)


@pytest.mark.parametrize("name", NAMES[:2])
def test_a_value_that_is_not_finite_is_refused(write, arrays, spec, name):
    arrays[name][1, 2, 0] = np.nan
    refused(rf"demonstration 1: {name[16:]} holds nan at \[2, 0\]: every number must be finite", write(), spec)


def test_padding_may_hold_anything(write, arrays, spec):
    arrays[NAMES[0]][0, 6] = np.nan
    assert load(write()).lengths.tolist() == LENGTHS


def test_demonstrations_longer_than_the_published_ones_are_refused(write, spec):
    longer = LONGEST + 1
    shapes = (3, longer, 16), (3, longer, 2), (3, longer), (3, longer, 4)
    folder = write(**{name: np.ones(shape) for name, shape in zip(NAMES, shapes, strict=True)})
    refused("202 steps a demonstration, expected at most 201", folder, spec)


def test_a_truncated_npy_file_is_refused(write, spec):
    path = write() / f"{NAMES[0]}.npy"
    path.write_bytes(path.read_bytes()[:500])
    refused("is truncated", path.parent, spec)


@pytest.mark.parametrize("content", [b"no tensor at all", b"PK\x03\x04"])
def test_a_damaged_pth_file_is_refused(write, spec, content):
    folder = write()
    (folder / "onehot_goals.pth").write_bytes(content)
    refused("onehot_goals.pth is damaged or holds more than plain tensors", folder, spec)


def test_an_empty_pth_file_is_refused(write, spec):
    folder = write()
    (folder / "onehot_goals.pth").write_bytes(b"")
    refused("onehot_goals.pth is damaged or holds more than plain tensors", folder, spec)


def test_a_pth_file_with_a_pickled_object_is_refused_unopened(write, spec):
    folder = write()
    torch.save(pathlib.PurePosixPath("anything"), folder / "onehot_goals.pth")
    refused("onehot_goals.pth is damaged or holds more than plain tensors", folder, spec)


def test_a_pth_file_with_something_else_than_a_tensor_is_refused(write, spec):
    folder = write()
    torch.save({"goals": torch.zeros(3)}, folder / "onehot_goals.pth")
    refused("onehot_goals.pth holds a dict, expected one tensor", folder, spec)


def test_an_archive_in_place_of_an_array_is_refused(write, arrays, spec):
    folder = write()
    with (folder / f"{NAMES[2]}.npy").open("wb") as file:
        np.savez(file, arrays[NAMES[2]])
    refused(f"{NAMES[2]}.npy", folder, spec)


@pytest.mark.parametrize(("name", "factor"), [(NAMES[1], 100), (NAMES[0], 1e30), (NAMES[0], -7)])
def test_numbers_out_of_range_are_refused(write, arrays, spec, name, factor):
    arrays[name] = np.where(arrays[name] == 0, 0, np.maximum(np.abs(arrays[name]), 0.01)) * factor
    if factor == -7:
        arrays[name] = arrays[name] * 100
    refused(rf"demonstration \d: {name[16:]} reach .*, expected at most", write(), spec)


@pytest.mark.parametrize("value", [0.5, 2.0, -1.0, np.nan])
def test_labels_that_are_neither_0_nor_1_are_refused(write, arrays, spec, value):
    arrays[NAMES[3]][2, 1, 2] = value
    refused("demonstration 2: tasks ", write(), spec)


def test_a_demonstration_without_a_completed_task_is_refused_unless_it_ran_into_its_limit(write, arrays, spec):
    arrays[NAMES[3]][1] = 0
    refused("demonstration 1: no task is completed", write(), spec)
    shapes = (3, LONGEST, 16), (3, LONGEST, 2), (3, LONGEST), (3, LONGEST, 4)
    longest = {name: np.zeros(shape) for name, shape in zip(NAMES, shapes, strict=True)}
    longest[NAMES[2]] += 1
    assert load(write(**longest)).lengths.tolist() == [LONGEST] * 3


@pytest.mark.parametrize("value", [np.nan, 0.5, 2.0, -1.0])
def test_masks_that_are_neither_0_nor_1_are_refused(write, arrays, spec, value):
    arrays[NAMES[2]][1, 7] = value
    refused("mask of demonstration 1 is not ones followed by zeros", write(), spec)


def test_an_array_that_is_there_twice_is_refused(write, arrays, spec):
    folder = write()
    torch.save(torch.from_numpy(arrays[NAMES[1]]), folder / f"{NAMES[1]}.pth")
    refused(f"{NAMES[1]} is there as .npy and as .pth", folder, spec)


def test_a_folder_of_something_else_is_told_what_it_must_hold(tmp_path, spec):
    refused(f"holds no demonstrations: `folder` must hold {NAMES[0]}, ", tmp_path, spec)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (np.complex128, r"multimodal_push_actions.npy is not a .npy array of numbers: it holds complex128"),
        (str, r"multimodal_push_actions.npy is not a .npy array of numbers: it holds <U"),
        (object, r"multimodal_push_actions.npy is truncated or is not a .npy array of numbers$"),
    ],
)
def test_arrays_of_other_than_real_numbers_are_refused(write, arrays, spec, kind, message):
    refused(message, write(**{NAMES[1]: arrays[NAMES[1]].astype(kind)}), spec)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (torch.Tensor.bfloat16, "holds a tensor of bfloat16, expected plain real numbers"),
        (torch.Tensor.to_sparse, "holds a tensor of sparse_coo, expected plain real numbers"),
        (lambda tensor: tensor.to(torch.complex64), "holds a tensor of complex64, expected plain real numbers"),
        (lambda tensor: tensor.to(torch.float8_e4m3fnuz), "holds a tensor of float8_e4m3fnuz, expected plain real"),
        (lambda tensor: tensor.to("meta"), "holds a tensor of meta, expected plain real numbers"),
        (lambda tensor: torch.nested.nested_tensor([tensor[0]]), "holds a tensor of nested, expected plain real"),
        (lambda tensor: torch.zeros(1).expand(10**12), "is damaged: 1000000000000 numbers in"),
    ],
)
def test_tensors_of_another_kind_are_refused(write, arrays, spec, change, message):
    folder = write()
    torch.save(change(torch.from_numpy(arrays[NAMES[3]])), folder / "onehot_goals.pth")
    refused(f"onehot_goals.pth {message}", folder, spec)


def test_a_tensor_that_is_stored_with_the_other_sign_is_read(write, arrays, spec):
    folder, stored = write(), torch.complex(torch.zeros(1), -torch.from_numpy(arrays[NAMES[3]]).float())
    torch.save(stored.conj().imag, folder / "onehot_goals.pth")
    assert np.array_equal(load(folder).tasks, load(write()).tasks)


def test_a_file_that_would_unpack_to_much_more_is_refused_packed(write, spec):
    folder = write()
    torch.save(torch.zeros(3, STEPS, 4), folder / "plain.pth")
    with (
        zipfile.ZipFile(folder / "plain.pth") as plain,
        zipfile.ZipFile(folder / "onehot_goals.pth", "w", zipfile.ZIP_DEFLATED) as bomb,
    ):
        for name in plain.namelist():
            bomb.writestr(name, bytes(1 << 26) if name.endswith("/data/0") else plain.read(name))
    refused(r"onehot_goals.pth is damaged: its \d+ bytes would unpack to 67\d+", folder, spec)
