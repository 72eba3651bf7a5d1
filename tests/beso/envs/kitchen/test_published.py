"""Import of files in the two published layouts: relay arrays, time first and padded with zeros; Minari's HDF5."""

import json
import pathlib
import sys

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.envs.registration import EnvSpec

from beso.envs.kitchen.demonstrations.published import COLUMNS, LONGEST, load
from beso.envs.kitchen.spec import KETTLE, LIGHT_SWITCH, MICROWAVE, SLIDE_CABINET, SPEC, TASKS
from beso.errors import UserError
from beso.files import sha256

LENGTHS = [6, 9, 5]
STEPS = 9
NAMES = ("observations_seq", "actions_seq", "existence_mask", "onehot_goals")
DONE = (MICROWAVE, KETTLE, LIGHT_SWITCH, SLIDE_CABINET)  # in every demonstration of the arrays below


def refused(message, folder):
    with pytest.raises(UserError, match=message) as caught:
        load(folder)
    assert len(str(caught.value).splitlines()) == 1


# Relay arrays


@pytest.fixture
def arrays():
    rng = np.random.default_rng(0)
    masks = (np.arange(STEPS)[:, None] < np.array(LENGTHS)).astype(np.float64)
    tasks = np.zeros((STEPS, 3, 7), dtype=np.float32)
    for i, length in enumerate(LENGTHS):
        for step in range(length):  # a step for the microwave, one for the kettle, one for the light, then the slide
            tasks[step, i, COLUMNS.index(TASKS[DONE[min(step, 3)]].name)] = 1
    observations = rng.uniform(-2, 2, (STEPS, 3, 60)) * masks[..., None]
    actions = rng.uniform(-1, 1, (STEPS, 3, 9)) * masks[..., None]
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


def test_reads_the_steps_of_every_demonstration_and_no_padding(write, arrays):
    data = load(write())
    assert data.lengths.tolist() == LENGTHS
    for i, length in enumerate(LENGTHS):
        steps = slice(data.episode_starts[i], data.episode_ends[i])
        assert np.array_equal(data.observations[steps], arrays[NAMES[0]][:length, i, :30].astype(np.float32))
        assert np.array_equal(data.actions[steps], arrays[NAMES[1]][:length, i].astype(np.float32))


def test_a_task_is_completed_at_the_last_step_that_is_its_own(write):
    data = load(write())
    for i, length in enumerate(LENGTHS):
        assert data.completed(i) == DONE
        steps, tasks = np.nonzero(data.tasks[data.episode_starts[i] : data.episode_ends[i]])
        assert dict(zip(tasks.tolist(), steps.tolist(), strict=True)) == dict(
            zip(DONE, (0, 1, 2, length - 1), strict=True)
        )


def test_a_task_that_is_taken_up_again_is_completed_at_its_last_step(write, arrays):
    tasks = arrays["onehot_goals"]
    tasks[3, 1] = 0
    tasks[3, 1, COLUMNS.index("microwave")] = 1
    data = load(write())
    assert data.completed(1) == (KETTLE, LIGHT_SWITCH, MICROWAVE, SLIDE_CABINET)
    assert data.tasks.sum() == 4 * 3


def test_the_columns_name_the_same_tasks_as_the_spec():
    assert sorted(COLUMNS) == sorted(SPEC.tasks)


def test_the_description_names_the_files_and_their_digests(write):
    folder = write()
    meta = load(folder).meta
    assert meta["files"] == {path.name: sha256(path) for path in folder.iterdir()}
    assert meta["source"] == "published relay kitchen"


@pytest.mark.parametrize("name", NAMES)
def test_a_missing_file_is_refused(write, name):
    refused(rf"{name}.npy is missing \(nor is there a .pth", write(**{name: None}))


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        (NAMES[0], (STEPS, 3, 30)),
        (NAMES[0], (3, STEPS, 60)),
        (NAMES[1], (STEPS, 3, 7)),
        (NAMES[1], (STEPS - 1, 3, 9)),
        (NAMES[2], (STEPS, 3, 1)),
        (NAMES[3], (STEPS, 2, 7)),
    ],
)
def test_shapes_that_do_not_fit_together_are_refused(write, name, shape):
    refused(rf"{name}\.\w+ has shape \({', '.join(map(str, shape))}\), expected", write(**{name: np.ones(shape)}))


def test_arrays_with_demonstrations_first_are_refused(write, arrays):
    folder = write(**{name: array.swapaxes(0, 1).copy() for name, array in arrays.items()})
    refused("the mask of demonstration 6 is not ones followed by zeros", folder)


@pytest.mark.parametrize(("step", "value"), [(3, 0), (0, 0)])
def test_a_mask_with_a_hole_is_refused(write, arrays, step, value):
    arrays["existence_mask"][step, 1] = value
    refused("mask of demonstration 1 is not ones followed by zeros", write())


def test_an_empty_demonstration_is_refused(write, arrays):
    arrays["existence_mask"][:, 2] = 0
    refused("mask of demonstration 2 is not ones followed by zeros", write())


@pytest.mark.parametrize("name", NAMES[:2])
def test_a_value_that_is_not_finite_is_refused(write, arrays, name):
    arrays[name][2, 1, 0] = np.nan
    refused(rf"demonstration 1: {name[:7]}\w* holds nan at \[2, 0\]: every number must be finite", write())


@pytest.mark.parametrize(("name", "value"), [(NAMES[0], 12.0), (NAMES[1], -1.5)])
def test_a_value_out_of_range_is_refused(write, arrays, name, value):
    arrays[name][0, 1, 4] = value
    refused(rf"demonstration 1: {name[:7]}\w* reach {abs(value):g}, expected at most 1", write())


@pytest.mark.parametrize(("change", "message"), [(0.0, "no task is completed"), (0.5, "tasks hold 0.5, expected")])
def test_tasks_that_are_not_marked_by_ones_are_refused(write, arrays, change, message):
    arrays["onehot_goals"][:, 2] *= change
    refused(f"demonstration 2: {message}", write())


@pytest.mark.parametrize("name", [None, "data-00000-of-00001.arrow", "demos.hdf5", "data"])
def test_a_folder_of_something_else_is_told_what_it_must_hold(tmp_path, name):
    if name:
        (tmp_path / name).mkdir()
    refused(
        "holds no demonstrations: `folder` must hold observations_seq, .* in HDF5 format, with data/main_data", tmp_path
    )


def test_padding_may_hold_anything(write, arrays):
    arrays["observations_seq"][7, 0] = np.nan
    arrays["observations_seq"][:, :, 30:] = np.nan  # nor does the goal's half matter
    arrays["onehot_goals"][7, 0] = 1
    data = load(write())
    assert data.lengths.tolist() == LENGTHS
    assert data.completed(0) == DONE


def test_demonstrations_longer_than_the_published_ones_are_refused(write):
    longer = LONGEST + 1
    shapes = (longer, 2, 60), (longer, 2, 9), (longer, 2), (longer, 2, 7)
    folder = write(**{name: np.ones(shape) for name, shape in zip(NAMES, shapes, strict=True)})
    refused("410 steps a demonstration, expected at most 409", folder)


def test_a_truncated_npy_file_is_refused(write):
    path = write() / "observations_seq.npy"
    path.write_bytes(path.read_bytes()[:500])
    refused("is truncated", path.parent)


def test_a_pth_file_with_a_pickled_object_is_refused_unopened(write):
    folder = write()
    torch.save(pathlib.PurePosixPath("anything"), folder / "onehot_goals.pth")
    refused(r"onehot_goals.pth is damaged or holds more than plain tensors", folder)


# A Minari dataset


def franka_kitchen_observations(steps):
    """A dataset's observations of an episode: the microwave opens half way through, then the light goes on."""
    rng = np.random.default_rng(steps)
    states = rng.uniform(-0.05, 0.05, (steps + 1, 59))
    coordinate = {index: index + 9 for index in range(9, 30)}  # after the robot's nine velocities
    states[:, [coordinate[i] for i in TASKS[KETTLE].element]] = (-0.27, 0.35, 1.62, 1.0, 0.0, 0.0, 0.0)
    states[steps // 2 :, coordinate[22]] = -0.7
    states[steps // 2 + 1 :, [coordinate[17], coordinate[18]]] = (-0.69, -0.05)
    return states


@pytest.fixture
def write_minari(tmp_path):
    """write(episodes, ...) -> a Minari dataset's folder, with a data folder inside; needs the package."""
    pytest.importorskip("minari")
    pytest.importorskip("h5py")
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    def write(episodes, width=59, actions=9, key="observation"):
        box = gymnasium.spaces.Box
        goal_space = gymnasium.spaces.Dict(microwave=box(-np.inf, np.inf, (1,), np.float64))
        observation_space = gymnasium.spaces.Dict(
            {key: box(-np.inf, np.inf, (width,), np.float64), "achieved_goal": goal_space}
        )
        folder = tmp_path / "dataset"
        folder.mkdir()
        storage = MinariStorage.new(folder / "data", observation_space, box(-1.0, 1.0, (actions,), np.float64))
        rng = np.random.default_rng(0)
        storage.update_metadata({"dataset_id": "D4RL/kitchen/test-v0", "minari_version": "0.5.3"})
        storage.update_episodes(
            EpisodeBuffer(
                id=i,
                observations={
                    key: states[:, :width],
                    "achieved_goal": {"microwave": states[:, [31]]},
                },
                actions=rng.uniform(-1, 1, (len(states) - 1, actions)),
                rewards=[0.0] * (len(states) - 1),
                terminations=[False] * (len(states) - 1),
                truncations=[False] * (len(states) - 1),
            )
            for i, states in enumerate(episodes)
        )
        return folder

    return write


EPISODES = [franka_kitchen_observations(steps) for steps in (10, 8)]


def test_reads_a_minari_dataset(write_minari):
    folder = write_minari(EPISODES)
    data = load(folder)
    assert data.lengths.tolist() == [10, 8]
    expected = np.concatenate([states[:-1, [*range(9), *range(18, 39)]] for states in EPISODES])
    assert np.array_equal(data.observations, expected.astype(np.float32))
    assert np.abs(data.actions).max(axis=0).min() > 0.1
    assert [data.completed(i) for i in range(2)] == [(MICROWAVE, LIGHT_SWITCH)] * 2
    assert data.tasks[5, MICROWAVE] == data.tasks[6, LIGHT_SWITCH] == data.tasks[14, MICROWAVE] == 1
    assert data.meta["source"] == "Minari kitchen"
    assert data.meta["files"] == {path.name: sha256(path) for path in (folder / "data").iterdir()}


def test_the_folder_with_the_file_itself_will_do(write_minari):
    folder = write_minari(EPISODES)
    assert np.array_equal(load(folder).actions, load(folder / "data").actions)


def test_a_minari_dataset_of_another_environment_is_refused(write_minari):
    refused(
        r"demonstration 0: observations has shape \(11, 30\), expected \(11, 59\)", write_minari(EPISODES, width=30)
    )


def test_a_minari_dataset_without_the_environments_observations_is_refused(write_minari):
    refused(
        "demonstration 0 has not the observations and actions of FrankaKitchen-v1", write_minari(EPISODES, key="pixels")
    )


def test_a_minari_dataset_with_other_actions_is_refused(write_minari):
    refused(r"demonstration 0: actions has shape \(10, 4\), expected \(10, 9\)", write_minari(EPISODES, actions=4))


def test_a_minari_dataset_with_a_value_that_is_not_finite_is_refused(write_minari):
    broken = [EPISODES[0], EPISODES[1].copy()]
    broken[1][2, 0] = np.nan
    refused(r"demonstration 1: observations holds nan at \[2, 0\]: every number", write_minari(broken))


def test_a_damaged_minari_dataset_is_refused(write_minari):
    folder = write_minari(EPISODES)
    path = folder / "data" / "main_data.hdf5"
    path.write_bytes(path.read_bytes()[:300])
    refused("main_data.hdf5 is damaged or no Minari dataset", folder)
    path.write_bytes(b"no HDF5")
    (folder / "data" / "metadata.json").unlink()
    refused("main_data.hdf5 is damaged or no Minari dataset", folder)


def test_what_a_minari_dataset_says_of_its_environment_is_not_run(write_minari):
    """Minari makes the environment where a space is not told, and an entry point can be any function."""
    folder = write_minari(EPISODES)
    path, touched = folder / "data" / "metadata.json", folder / "touched"
    metadata = json.loads(path.read_text())
    del metadata["observation_space"]
    command = {"args": ["touch", str(touched)]}
    metadata["env_spec"] = EnvSpec("any-v0", entry_point="subprocess:check_output", kwargs=command).to_json()
    path.write_text(json.dumps(metadata))
    assert len(load(folder)) == 2
    assert not touched.exists()


def test_a_minari_dataset_that_lost_episodes_or_stores_fewer_numbers_than_it_says_is_refused(write_minari):
    import h5py

    folder = write_minari(EPISODES)
    for kind, message in (("f4", r"float32 \(1000000000, 9\) in 0 bytes"), (h5py.string_dtype(), "object")):
        with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
            del file["episode_1/actions"]
            file["episode_1"].create_dataset("actions", (10**9, 9), kind, chunks=(1, 9))
        refused(f"episode_1: actions is damaged: {message}", folder)
    with h5py.File(folder / "data" / "main_data.hdf5", "a") as file:
        del file["episode_1"]
    refused("main_data.hdf5 has 1 episodes; metadata.json says 2", folder)


def test_a_minari_dataset_without_the_package_says_what_to_install(monkeypatch, tmp_path):
    (tmp_path / "main_data.hdf5").touch()
    monkeypatch.setitem(sys.modules, "h5py", None)
    refused(r"needs the packages minari and h5py: install this project with its extra \[minari\]", tmp_path)
