"""Play on disk, in our own form and in CALVIN's."""

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from beso.envs.calvin.demonstrations import official, raw, recording
from beso.envs.calvin.demonstrations.scripted import Step, record
from beso.errors import UserError

STATES = ("robot_obs", "scene_obs", "rel_actions", "actions")


def random_steps(length, seed, size=8):
    rng = np.random.default_rng(seed)
    return [
        Step(
            rng.integers(256, size=(size, size, 3), dtype=np.uint8),
            rng.normal(size=15),
            rng.normal(size=24),
            rng.uniform(-1, 1, 7),
            rng.normal(size=7),
            rng.integers(2, size=34, dtype=np.uint8),
            i == 0,
            "push",
        )
        for i in range(length)
    ]


@pytest.fixture
def episodes():
    """The second one is longer than a batch."""
    return [random_steps(5, 0), random_steps(300, 1), random_steps(7, 2)]


@pytest.fixture
def folder(tmp_path, episodes):
    raw.write((iter(episode) for episode in episodes), tmp_path / "raw", {"source": "random", "seed": 3})
    return tmp_path / "raw"


@pytest.fixture
def calvin(tmp_path, folder):
    """The same in CALVIN's layout."""
    official.export(raw.load(folder), tmp_path / "training")
    return tmp_path / "training"


def convert(calvin, target, size=None, **meta):
    official.convert([official.layout(calvin)], target, size=size, workers=2, meta=meta)
    return raw.load(target)


class TestRaw:
    def test_what_was_written_is_read(self, folder, episodes):
        play = raw.load(folder)
        steps = [step for episode in episodes for step in episode]
        assert play.episode_ends.tolist() == [5, 305, 312]
        assert [(rows.start, rows.stop) for rows in play.episodes()] == [(0, 5), (5, 305), (305, 312)]
        assert (play.frames == np.stack([step.frame for step in steps])).all()
        assert (play.rel_actions == np.stack([step.rel_action for step in steps]).astype(np.float32)).all()
        assert (play.tasks == np.stack([step.tasks for step in steps])).all()
        assert np.flatnonzero(play.segment_starts).tolist() == [0, 5, 305]
        assert play.meta["counts"] == {"episodes": 3, "steps": 312}
        assert play.meta["seed"] == 3
        assert set(play.meta["versions"]) == {"numpy", "pybullet"}
        assert isinstance(play.frames, np.memmap)

    def test_parts_join_to_the_same_bytes(self, tmp_path, folder, episodes):
        parts = [tmp_path / f"part{i}" for i in range(3)]
        for part, episode in zip(parts, episodes, strict=True):
            raw.write([episode], part, {})
        raw.join(parts, tmp_path / "joined", {"source": "random", "seed": 3})
        for path in folder.iterdir():
            assert (tmp_path / "joined" / path.name).read_bytes() == path.read_bytes()

    def test_an_interrupted_recording_leaves_nothing(self, tmp_path, episodes):
        def broken():
            yield episodes[0]
            raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            raw.write(broken(), tmp_path / "raw", {})
        assert list(tmp_path.iterdir()) == []

    def test_frames_of_two_sizes_are_refused(self, tmp_path, folder):
        raw.write([random_steps(3, 0, size=9)], tmp_path / "other", {})
        with pytest.raises(UserError, match=r"other: frames of shape \(9, 9, 3\), those before have \(8, 8, 3\)"):
            raw.join([folder, tmp_path / "other"], tmp_path / "joined", {})
        with pytest.raises(ValueError, match="rows of shape"):
            raw.write([random_steps(3, 0), random_steps(3, 0, size=9)], tmp_path / "mixed", {})

    def test_no_episode_is_an_error(self, tmp_path):
        with pytest.raises(UserError, match="no episode to write"):
            raw.write([], tmp_path / "raw", {})

    def test_a_folder_of_something_else(self, tmp_path):
        with pytest.raises(UserError, match="is not raw CALVIN play"):
            raw.load(tmp_path)

    def test_a_missing_file(self, folder):
        (folder / "actions.npy").unlink()
        with pytest.raises(UserError, match=r"actions.npy is missing"):
            raw.load(folder)

    def test_a_truncated_file(self, folder):
        path = folder / "frames.npy"
        path.write_bytes(path.read_bytes()[:-100])
        with pytest.raises(UserError, match=r"frames.npy is truncated"):
            raw.load(folder)

    def test_an_altered_file(self, folder):
        path = folder / "frames.npy"
        data = bytearray(path.read_bytes())
        data[-1] ^= 1
        path.write_bytes(data)
        with pytest.raises(UserError, match=r"frames.npy is not the file that meta.json describes"):
            raw.load(folder)
        raw.load(folder, verify=False)

    def test_an_array_of_another_shape(self, folder):
        np.save(folder / "scene_obs.npy", np.zeros((312, 23), dtype=np.float32))
        with pytest.raises(UserError, match=r"scene_obs holds float32 \(312, 23\), expected float32 \(312, 24\)"):
            raw.load(folder, verify=False)

    def test_episode_ends_that_fall(self, folder):
        np.save(folder / "episode_ends.npy", np.array([305, 5, 312]))
        with pytest.raises(UserError, match="does not rise"):
            raw.load(folder, verify=False)

    def test_a_damaged_meta_json(self, folder):
        (folder / "meta.json").write_text("{")
        with pytest.raises(UserError, match=r"meta.json is damaged"):
            raw.load(folder)

    def test_recorded_play_round_trips(self, tmp_path):
        steps = list(record(seed=0, index=3, length=20, size=16))
        raw.write([record(seed=0, index=3, length=20, size=16)], tmp_path / "raw", {})
        play = raw.load(tmp_path / "raw")
        assert play.frames.tobytes() == b"".join(step.frame.tobytes() for step in steps)


class TestOfficial:
    def test_exported_play_is_imported_unchanged(self, tmp_path, folder, calvin):
        play, again = raw.load(folder), convert(calvin, tmp_path / "again", source="ours")
        assert again.meta["labelled"] is False
        assert again.meta["source"] == "ours"
        for name in ("frames", *STATES, "episode_ends"):
            assert getattr(again, name).tobytes() == getattr(play, name).tobytes(), name
        assert not again.tasks.any()
        assert np.flatnonzero(again.segment_starts).tolist() == [0, 5, 305]

    def test_layout_is_calvins(self, calvin):
        with np.load(calvin / "episode_0000005.npz") as frame:
            assert {key: (frame[key].shape, str(frame[key].dtype)) for key in frame} == {
                "rgb_static": ((8, 8, 3), "uint8"),
                "robot_obs": ((15,), "float64"),
                "scene_obs": ((24,), "float64"),
                "rel_actions": ((7,), "float64"),
                "actions": ((7,), "float64"),
            }
        assert np.load(calvin / "ep_start_end_ids.npy").tolist() == [[0, 4], [5, 304], [305, 311]]
        assert np.load(calvin / "ep_lens.npy").tolist() == [5, 300, 7]

    def test_frames_between_episodes_are_not_read(self, tmp_path, calvin):
        """Numbers jump, other files lie about, arrays of other cameras are there but broken frames are not touched."""
        np.save(calvin / "ep_start_end_ids.npy", np.array([[305, 311], [1, 4]]))
        (calvin / "episode_0000000.npz").write_bytes(b"broken")
        (calvin / "statistics.yaml").write_text("")
        again = convert(calvin, tmp_path / "again")
        assert again.episode_ends.tolist() == [4, 11]

    def test_frames_are_resized(self, tmp_path, calvin, folder):
        again = convert(calvin, tmp_path / "again", size=4)
        assert again.frames.shape == (312, 4, 4, 3)
        means = raw.load(folder).frames.reshape(312, 4, 2, 4, 2, 3).mean(axis=(2, 4))
        assert np.abs(again.frames - means).max() <= 1  # the mean over each pixel's area

    def test_names_with_another_number_of_digits(self, tmp_path, calvin):
        for path in calvin.glob("episode_*.npz"):
            path.rename(calvin / f"episode_{int(path.stem[8:]):06d}.npz")
        assert convert(calvin, tmp_path / "again").episode_ends.tolist() == [5, 305, 312]

    @pytest.mark.parametrize(
        ("bounds", "message"),
        [
            (np.array([[0.0, 4.0]]), r"ep_start_end_ids.npy holds float64 \(1, 2\), expected whole numbers"),
            (np.array([0, 4]), r"ep_start_end_ids.npy holds int64 \(2,\)"),
            (np.array([[4, 0]]), "an episode from frame 4 to 0"),
            (np.array([[0, 4], [4, 9]]), "an episode starts at frame 4 before another ends at 4"),
            (np.array([[300, 312]]), r"episode_0000312.npz is missing, a frame of the episode from 300 to 312"),
        ],
    )
    def test_bad_lists_of_episodes(self, tmp_path, calvin, bounds, message):
        np.save(calvin / "ep_start_end_ids.npy", bounds)
        with pytest.raises(UserError, match=message):
            convert(calvin, tmp_path / "again")

    def test_a_root_folder_instead_of_a_split(self, tmp_path, calvin):
        with pytest.raises(UserError, match="the folder must be `training` or `validation`"):
            convert(calvin.parent, tmp_path / "again")

    @pytest.mark.parametrize("instead", [None, Path.mkdir, os.mkfifo])
    def test_a_missing_frame(self, tmp_path, calvin, instead):
        (calvin / "episode_0000123.npz").unlink()
        if instead:
            instead(calvin / "episode_0000123.npz")
        with pytest.raises(UserError, match=r"episode_0000123.npz is missing, a frame of the episode from 5 to 304"):
            convert(calvin, tmp_path / "again")
        assert not (tmp_path / "again").exists()

    @pytest.mark.parametrize("kept", [0, 10, 300, -30])
    def test_a_truncated_frame(self, tmp_path, calvin, kept):
        path = calvin / "episode_0000123.npz"
        path.write_bytes(path.read_bytes()[:kept])
        with pytest.raises(UserError, match=r"episode_0000123.npz is truncated"):
            convert(calvin, tmp_path / "again")

    def test_damaged_bytes_inside_a_frame(self, tmp_path, calvin):
        path = calvin / "episode_0000123.npz"
        data = bytearray(path.read_bytes())
        data[60:120] = bytes(60)
        path.write_bytes(data)
        with pytest.raises(UserError, match=r"episode_0000123.npz is truncated"):
            convert(calvin, tmp_path / "again")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"robot_obs": None}, "has no array of this name: robot_obs"),
            ({"scene_obs": np.zeros(23)}, r"scene_obs has shape \(23,\), expected \(24,\)"),
            ({"actions": np.full(7, np.nan)}, r"actions holds nan at \[0\]: every number must be finite"),
            ({"rel_actions": np.full(7, 50.0)}, "rel_actions reach 50, expected at most 1"),
            ({"robot_obs": np.full(15, 1e30)}, r"robot_obs reach 1e\+30, expected at most 12"),
            ({"robot_obs": np.array(["x"] * 15)}, "robot_obs holds <U1"),
            ({"robot_obs": np.zeros(15, dtype=complex)}, "robot_obs holds complex128"),
            ({"robot_obs": np.array([None] * 15)}, "robot_obs holds object"),
            ({"rgb_static": np.zeros((8, 9, 3), np.uint8)}, r"rgb_static is uint8 \(8, 9, 3\), expected uint8 \(size"),
            ({"rgb_static": np.zeros((8, 8))}, r"rgb_static is float64 \(8, 8\)"),
            ({"rgb_static": np.zeros((9, 9, 3), np.uint8)}, r"a frame of shape \(9, 9, 3\), those before have"),
        ],
    )
    def test_wrong_contents_of_a_frame(self, tmp_path, calvin, change, message):
        path = calvin / "episode_0000123.npz"
        with np.load(path) as frame:
            arrays = {**frame, **change}
        np.savez_compressed(path, **{key: value for key, value in arrays.items() if value is not None})
        with pytest.raises(UserError, match=message):
            convert(calvin, tmp_path / "again")

    def test_a_frame_whose_header_tells_of_more_than_a_picture(self, tmp_path, calvin):
        path = calvin / "episode_0000123.npz"
        header = {"descr": "|u1", "fortran_order": False, "shape": (1 << 20, 1 << 20, 3)}
        with np.load(path) as frame:
            states = {key: frame[key] for key in STATES if key in frame}
        np.savez(path, **states)
        with zipfile.ZipFile(path, "a") as archive, archive.open("rgb_static.npy", "w") as file:
            np.lib.format.write_array_header_1_0(file, header)
        with pytest.raises(UserError, match=r"rgb_static holds uint8 .* 50331648 bytes at most"):
            convert(calvin, tmp_path / "again")

    def test_an_array_under_an_archives_name(self, tmp_path, calvin):
        path = calvin / "episode_0000123.npz"
        with path.open("wb") as file:
            np.save(file, np.zeros(3))
        with pytest.raises(UserError, match=r"episode_0000123.npz is truncated or is not an .npz file \(BadZipFile\)"):
            convert(calvin, tmp_path / "again")

    def test_frames_of_another_scene(self, tmp_path, calvin):
        np.save(calvin / "scene_info.npy", np.array({"calvin_scene_D": [0, 9], "calvin_scene_B": [10, 311]}))
        with pytest.raises(UserError, match=r"scene_info.npy names frames of scene B, expected scene D alone"):
            convert(calvin, tmp_path / "again")
        np.save(calvin / "scene_info.npy", np.array({"calvin_scene_D": [0, 311]}))
        convert(calvin, tmp_path / "again")

    def test_an_incomplete_split_is_told_what_it_lacks(self, tmp_path, calvin):
        (calvin / "ep_start_end_ids.npy").unlink()
        with pytest.raises(UserError, match="training must hold a CALVIN data set's list of episodes"):
            convert(calvin, tmp_path / "again")

    def test_an_episode_of_both_parts_cannot_be_held_out(self, tmp_path, folder, calvin):
        root, play = calvin.parent, raw.load(folder)
        official.export(play, root / "validation")
        with pytest.raises(UserError, match=r"validation/episode_0000\d+.npz starts an episode of training too"):
            recording.convert(root, tmp_path / "raw", 8, 1)
        with pytest.raises(UserError, match="has no folder `training`: `folder` must be the one that holds CALVIN's"):
            recording.convert(calvin, tmp_path / "raw", 8, 1)
