import dataclasses

import numpy as np
import pytest

from beso.data import play
from beso.data.play import ARRAYS, Episode, assemble, split_episodes
from beso.envs import spec as spec_of
from beso.errors import UserError


def refused(message, function, *arguments):
    """The function raises a UserError of one line that matches."""
    with pytest.raises(UserError, match=message) as caught:
        function(*arguments)
    assert len(str(caught.value).splitlines()) == 1


@pytest.fixture
def folder(dataset, tmp_path):
    play.save(dataset, tmp_path / "play")
    return tmp_path / "play"


def test_episodes_are_joined_in_order(make_dataset):
    data = make_dataset((4, 7, 5))
    assert len(data) == 3
    assert data.episode_ends.tolist() == [4, 11, 16]
    assert data.episode_starts.tolist() == [0, 4, 11]
    assert data.lengths.tolist() == [4, 7, 5]
    assert data.observations.shape == (16, 16)
    assert (data.observations.dtype, data.actions.dtype, data.tasks.dtype) == (np.float32, np.float32, np.uint8)


def test_completed_tasks_come_in_order_of_completion(spec):
    tasks = np.zeros((2, 6, 4))
    tasks[0, 4, 0] = tasks[0, 1, 3] = tasks[0, 2, 2] = 1
    tasks[1, 5, 1] = tasks[1, 5, 0] = 1  # in the same step: by number
    episodes = [Episode(np.zeros((6, 16)), np.zeros((6, 2)), t) for t in tasks]
    data = assemble(episodes, spec, {})
    assert data.completed(0) == (3, 2, 0)
    assert data.completed(1) == (0, 1)


def test_a_dataset_survives_saving_and_loading(dataset, folder, spec):
    loaded = play.load(folder, spec)
    for name in ARRAYS:
        assert np.array_equal(getattr(loaded, name), getattr(dataset, name))
        assert getattr(loaded, name).dtype == getattr(dataset, name).dtype
        assert isinstance(getattr(loaded, name), np.memmap)
    assert loaded.meta["source"] == "random paths"
    assert loaded.meta["counts"] == {"episodes": 6, "steps": 81}


def test_two_saves_are_the_same_bytes(dataset, folder, tmp_path):
    play.save(dataset, tmp_path / "again")
    names = sorted(path.name for path in folder.iterdir())
    assert names == sorted([f"{name}.npy" for name in ARRAYS] + ["meta.json"])
    assert all((folder / name).read_bytes() == (tmp_path / "again" / name).read_bytes() for name in names)


def test_saving_replaces_an_older_dataset(folder, make_dataset, spec):
    play.save(make_dataset((8, 8)), folder)
    assert len(play.load(folder, spec)) == 2


def test_the_digest_changes_with_any_array(dataset, folder, tmp_path, spec):
    digest = play.data_digest(play.load(folder, spec))
    for name in ("observations", "actions", "tasks"):
        changed = getattr(dataset, name).copy()
        changed[3, 1] = 1
        play.save(dataclasses.replace(dataset, **{name: changed}), tmp_path / name)
        assert play.data_digest(play.load(tmp_path / name, spec)) != digest


@pytest.mark.parametrize("name", ["observations", "actions"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused_with_their_step(dataset, spec, name, value):
    getattr(dataset, name)[37, 1] = value
    refused(f"here: {name} has a value that is not finite .* step 37", play.check, dataset, spec, "here")


@pytest.mark.parametrize(
    ("name", "width", "kind", "expected"),
    [("observations", 15, "float32", 16), ("actions", 3, "float32", 2), ("tasks", 5, "uint8", 4)],
)
def test_wrong_shapes_are_refused(dataset, spec, name, width, kind, expected):
    wrong = dataclasses.replace(dataset, **{name: np.zeros((81, width), dtype=np.float32)})
    refused(
        rf"{name} holds float32 \(81, {width}\), expected {kind} \(81, {expected}\)", play.check, wrong, spec, "here"
    )


def test_arrays_of_different_lengths_are_refused(dataset, spec):
    wrong = dataclasses.replace(dataset, actions=dataset.actions[:-1])
    refused(r"actions holds float32 \(80, 2\), expected float32 \(81, 2\)", play.check, wrong, spec, "here")


@pytest.mark.parametrize("ends", [[], [40], [0, 81], [50, 40, 81], [40, 40, 81], [90, 81]])
def test_impossible_episode_ends_are_refused(dataset, spec, ends):
    wrong = dataclasses.replace(dataset, episode_ends=np.array(ends, dtype=np.int64))
    refused("episode_ends does not rise", play.check, wrong, spec, "here")


def test_a_missing_dataset_is_refused_with_what_makes_it(tmp_path, spec):
    refused("has no meta.json; run `dvc repro collect` first", play.load, tmp_path / "nothing", spec)


@pytest.mark.parametrize("name", ARRAYS)
def test_a_missing_file_is_refused(folder, spec, name):
    (folder / f"{name}.npy").unlink()
    refused(f"{name}.npy is missing", play.load, folder, spec)


@pytest.mark.parametrize("keep", [0, 5, 100, 300])
def test_a_truncated_file_is_refused(folder, spec, keep):
    path = folder / "actions.npy"
    path.write_bytes(path.read_bytes()[:keep])
    refused("actions.npy is truncated", play.load, folder, spec)


def test_an_altered_file_is_refused(folder, spec):
    path = folder / "actions.npy"
    altered = bytearray(path.read_bytes())
    altered[-1] ^= 1
    path.write_bytes(altered)
    refused("actions.npy is not the file that meta.json describes", play.load, folder, spec)


def test_a_file_with_pickled_objects_is_refused(folder, spec):
    np.save(folder / "actions.npy", np.array([{}], dtype=object))
    refused("actions.npy is truncated or is not a .npy array of numbers", play.load, folder, spec)


@pytest.mark.parametrize("text", ['{"sha256": {', "{}"])
def test_a_damaged_description_is_refused(folder, spec, text):
    (folder / "meta.json").write_text(text)
    refused("meta.json", play.load, folder, spec)


@pytest.mark.parametrize(
    ("episodes", "fraction", "expected"), [(20, 0.95, 19), (10, 0.75, 7), (2, 0.95, 1), (5, 0.01, 1)]
)
def test_split_covers_all_episodes_once(episodes, fraction, expected):
    training, held_out = split_episodes(episodes, fraction, np.random.default_rng(0))
    assert len(training) == expected
    assert len(held_out) >= 1
    assert sorted([*training, *held_out]) == list(range(episodes))


def test_split_is_decided_by_its_generator():
    splits = [split_episodes(50, 0.9, np.random.default_rng(seed))[1].tolist() for seed in (0, 0, 1)]
    assert splits[0] == splits[1]
    assert splits[0] != splits[2]


def test_an_unknown_environment_is_refused_with_what_is_allowed():
    refused("environment 'blockpush' is not one of block_push", spec_of, "blockpush")


def test_block_push_shows_ten_dimensions_and_no_target():
    block_push = spec_of("block_push")
    assert block_push.sizes == (10, 2, 1)
    assert max(block_push.visible) < 10, "dimensions 10 to 15 are the targets' poses"
    assert set(block_push.goal_masked) <= set(range(len(block_push.visible)))
