"""Play as a Minari dataset: what Minari reads, and that the importers read the same arrays again."""

import sys

import numpy as np
import pytest

from beso import envs
from beso.data import play
from beso.data.play import ARRAYS, Episode
from beso.envs import minari_data
from beso.errors import UserError

minari = pytest.importorskip("minari")
LENGTHS = (5, 9, 3)
META = {"source": "scripted", "seed": 3, "versions": {"numpy": np.__version__}, "sha256": {}, "counts": {}}


def random_play(name, **meta):
    """Small numbers, within all bounds; each task is done once in each episode but the last."""
    spec, rng = envs.spec(name), np.random.default_rng(0)
    episodes = []
    for length in LENGTHS:
        tasks = np.zeros((length, len(spec.tasks)))
        tasks[rng.integers(length, size=len(spec.tasks)), np.arange(len(spec.tasks))] = length != LENGTHS[-1]
        sizes = (length, spec.observation_size), (length, spec.action_size)
        episodes.append(Episode(*(rng.uniform(-0.1, 0.1, size) for size in sizes), tasks))
    return play.assemble(episodes, spec, META | meta)


@pytest.fixture
def write(tmp_path, monkeypatch):
    """write(name, dataset) -> the dataset as Minari loads it by its name."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))

    def write(name, dataset):
        spec = envs.spec(name)
        return minari.load_dataset(minari_data.write(dataset, spec, envs.gymnasium_name(name), tmp_path))

    return write


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", envs.names())
def test_minari_reads_it(write, name):
    dataset, spec = random_play(name), envs.spec(name)
    found = write(name, dataset)
    assert list(minari.list_local_datasets()) == [f"beso/{name}-v0"]
    assert (found.total_episodes, found.total_steps) == (len(LENGTHS), sum(LENGTHS))
    for i, episode in enumerate(found):
        rows = slice(dataset.episode_starts[i], dataset.episode_ends[i])
        length = LENGTHS[i]
        assert len(episode.observations) == length + 1
        assert np.array_equal(episode.observations, [*dataset.observations[rows], dataset.observations[rows][-1]])
        assert np.array_equal(episode.actions, dataset.actions[rows])
        assert all(found.observation_space.contains(row) for row in episode.observations)
        assert all(found.action_space.contains(row) for row in episode.actions)
        assert np.array_equal(episode.infos["tasks"][:-1], dataset.tasks[rows])
        assert episode.infos["goal"].shape == (length + 1, spec.goal_window, spec.observation_size)
        assert (episode.infos["goal"] == dataset.observations[rows][-spec.goal_window :]).all()
        assert np.array_equal(episode.rewards[:-1], dataset.tasks[rows][1:].sum(axis=1))
        assert episode.rewards[-1] == 0
        assert not episode.terminations.any()
        assert np.flatnonzero(episode.truncations).tolist() == [length - 1]
    said = found.storage.metadata
    assert said["tasks"] == list(spec.tasks)
    assert said["play"]["seed"] == 3
    assert said["requirements"] == [f"numpy=={np.__version__}"]
    environment = found.recover_environment()
    assert environment.action_space.shape == found.action_space.shape
    environment.close()


@pytest.mark.parametrize("meta", [{}, {"labelled": False, "source": "published CALVIN", "held_out_episodes": [2]}])
@pytest.mark.parametrize("name", envs.names())
def test_it_imports_again_to_the_same_arrays(write, tmp_path, name, meta):
    dataset = random_play(name, **meta)
    write(name, dataset)
    folder = tmp_path / "beso" / f"{name}-v0"
    if envs.sees_images(name):
        again = minari_data.read(minari_data.opened(folder), envs.spec(name), {})
    else:
        again = envs.importer(name)(folder)
    for array in ARRAYS:
        one, other = getattr(dataset, array), getattr(again, array)
        assert (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())
    kept = {key: value for key, value in (META | meta).items() if key not in ("sha256", "counts")}
    assert again.meta == kept | {"files": again.meta["files"]}
    assert again.labelled == dataset.labelled
    assert set(again.meta["files"]) == {"main_data.hdf5", "metadata.json"}


def test_scripted_play_imports_again_to_the_same_bytes_on_disk(write, tmp_path):
    spec, record = envs.spec("block_push"), envs.recorder("block_push")
    dataset = play.assemble([record(0, i) for i in range(2)], spec, META)
    write("block_push", dataset)
    play.save(dataset, tmp_path / "one")
    play.save(envs.importer("block_push")(tmp_path / "beso/block_push-v0"), tmp_path / "other")
    for array in ARRAYS:
        assert (tmp_path / f"one/{array}.npy").read_bytes() == (tmp_path / f"other/{array}.npy").read_bytes()


def test_the_second_replaces_the_first(write):
    write("block_push", random_play("block_push"))
    assert write("block_push", random_play("block_push")).total_episodes == len(LENGTHS)


def test_numbers_beyond_the_environments_bounds_widen_the_space(write):
    dataset = random_play("block_push")
    dataset.actions[0, 0] = 0.1 + 5e-7
    assert write("block_push", dataset).action_space.contains(dataset.actions[0])


def test_play_of_another_environment_is_refused(write, tmp_path):
    write("kitchen", random_play("kitchen"))
    with pytest.raises(UserError, match="is not that of play of block_push that `beso export` wrote"):
        envs.importer("block_push")(tmp_path / "beso/kitchen-v0")


def test_numbers_out_of_range_are_refused(write, tmp_path):
    dataset = random_play("kitchen")
    dataset.observations[6, 2] = 12
    write("kitchen", dataset)
    with pytest.raises(UserError, match="demonstration 1: observations reach 12, expected at most 11"):
        envs.importer("kitchen")(tmp_path / "beso/kitchen-v0")


def test_frames_are_refused(tmp_path):
    dataset = random_play("calvin")
    dataset.meta["finetune"] = {"frame_size": 8}
    with pytest.raises(UserError, match="play of calvin is frames"):
        minari_data.write(dataset, envs.spec("calvin"), "beso/Calvin-v0", tmp_path)


def test_without_the_package_it_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "minari", None)
    with pytest.raises(UserError, match=r"needs the packages minari and h5py: install .* its extra \[minari\]"):
        minari_data.write(random_play("block_push"), envs.spec("block_push"), "beso/BlockPush-v0", tmp_path)
    assert list(tmp_path.iterdir()) == []
