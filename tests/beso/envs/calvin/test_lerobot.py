"""Play with pictures as a LeRobot dataset: its layout, and the way back to the same bytes."""

import json
import os
import struct
import sys
import zlib

import numpy as np
import pandas as pd
import pytest

from beso.envs.calvin.demonstrations import lerobot, raw, recording
from beso.envs.calvin.demonstrations.raw import ARRAYS
from beso.envs.calvin.demonstrations.scripted import Step
from beso.envs.calvin.simulator import tasks
from beso.errors import UserError

parquet = pytest.importorskip("pyarrow.parquet")
SIZE, LENGTHS = 8, (5, 300, 7)  # the second one is longer than a batch
DRAWER, LED = (tasks.NAMES.index(name) for name in ("open_drawer", "turn_on_led"))


def steps(length, seed):
    """Segments of four steps: nothing, the drawer, the drawer and the light, nothing, ..."""
    rng = np.random.default_rng(seed)
    for i in range(length):
        done = np.zeros(34, np.uint8)
        done[DRAWER], done[LED] = i % 4 == 2 and i // 4 % 3 > 0, i % 4 == 3 and i // 4 % 3 == 2
        frame = rng.integers(256, size=(SIZE, SIZE, 3), dtype=np.uint8)
        states = rng.normal(size=15), rng.normal(size=24), rng.uniform(-1, 1, 7), rng.normal(size=7)
        yield Step(frame, *states, done, i % 4 == 0, "push")


@pytest.fixture
def play(tmp_path):
    meta = {"source": "random", "seed": 3, "labelled": True, "held_out_episodes": [2]}
    raw.write((steps(length, seed) for seed, length in enumerate(LENGTHS)), tmp_path / "raw", meta)
    return raw.load(tmp_path / "raw")


@pytest.fixture
def folder(tmp_path, play):
    recording.export(play, tmp_path / "lerobot", "lerobot")
    return tmp_path / "lerobot"


def test_it_imports_again_to_the_same_bytes(tmp_path, play, folder):
    recording.convert(folder, tmp_path / "again", SIZE, 1)
    for name in ARRAYS:
        path = f"{name}.npy"
        assert (tmp_path / "again" / path).read_bytes() == (tmp_path / "raw" / path).read_bytes()
    assert raw.load(tmp_path / "again").meta == play.meta


def test_several_files_import_again_in_their_order(tmp_path, play, monkeypatch):
    monkeypatch.setattr(lerobot, "LARGEST_FILE", 0)
    monkeypatch.setattr(lerobot, "FILES_A_CHUNK", 2)
    lerobot.export(play, tmp_path / "lerobot")
    files = sorted(path.relative_to(tmp_path / "lerobot/data") for path in tmp_path.glob("lerobot/data/*/*"))
    assert list(map(str, files)) == [f"chunk-00{c}/file-00{f}.parquet" for c, f in ((0, 0), (0, 1), (1, 0))]
    lerobot.convert(tmp_path / "lerobot", tmp_path / "again", None)
    assert raw.load(tmp_path / "again").meta == play.meta, "the same SHA-256"


def test_the_layout_is_version_3(folder, play):
    info = json.loads((folder / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["robot_type"]) == ("v3.0", 30, "panda")
    assert (info["total_episodes"], info["total_frames"], info["total_tasks"]) == (3, 312, 3)
    assert info["splits"] == {"train": "0:3"}
    assert info["video_path"] is None
    path = info["data_path"].format(chunk_index=0, file_index=0)
    table = parquet.read_table(folder / path)
    assert set(table.column_names) == set(info["features"])
    for key, feature in info["features"].items():
        kind = table.schema.field(key).type
        if feature["dtype"] == "image":
            assert feature["shape"] == [SIZE, SIZE, 3]
            assert {field.name for field in kind} == {"bytes", "path"}
        elif feature["shape"] == [1]:
            assert kind.to_pandas_dtype() == np.dtype(feature["dtype"]).type
        else:
            assert (kind.list_size, kind.value_type.to_pandas_dtype()) == (
                *feature["shape"],
                np.dtype(feature["dtype"]).type,
            )
    columns = table.to_pydict()
    assert columns["index"] == list(range(312))
    assert columns["frame_index"] == [i for length in LENGTHS for i in range(length)]
    assert columns["episode_index"] == [i for i, length in enumerate(LENGTHS) for _ in range(length)]
    assert np.allclose(columns["timestamp"], np.array(columns["frame_index"]) / 30)
    assert np.array_equal(np.float32(columns["action"]), play.rel_actions)


def test_episodes_tell_their_frames_and_tasks(folder):
    rows = parquet.read_table(folder / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [(row["dataset_from_index"], row["dataset_to_index"]) for row in rows] == [(0, 5), (5, 305), (305, 312)]
    assert [row["length"] for row in rows] == list(LENGTHS)
    assert [(row["data/chunk_index"], row["data/file_index"]) for row in rows] == [(0, 0)] * 3
    assert rows[0]["tasks"] == ["play"]
    assert rows[1]["tasks"] == ["open drawer", "open drawer and turn on led", "play"]
    texts = pd.read_parquet(folder / "meta/tasks.parquet")
    assert texts["task_index"].to_dict() == {"play": 0, "open drawer": 1, "open drawer and turn on led": 2}
    of_frames = parquet.read_table(folder / "data/chunk-000/file-000.parquet")["task_index"].to_pylist()
    assert of_frames[5:21] == [0] * 4 + [1] * 4 + [2] * 4 + [0] * 4


def test_statistics_are_of_each_number_and_of_each_colour(folder, play):
    found = json.loads((folder / "meta/stats.json").read_text())
    assert found["action"]["mean"] == pytest.approx(play.rel_actions.mean(axis=0, dtype=np.float64))
    assert found["action"]["q90"] == pytest.approx(np.quantile(play.rel_actions, 0.9, axis=0))
    assert found["segment_start"]["count"] == [312]
    pictures = found["observation.images.static"]
    assert np.shape(pictures["mean"]) == (3, 1, 1)
    assert np.ravel(pictures["mean"]) == pytest.approx(play.frames.reshape(-1, 3).mean(axis=0) / 255, abs=0.02)
    assert pictures["count"] == [100]


def test_frames_are_resized(tmp_path, folder, play):
    recording.convert(folder, tmp_path / "again", 4, 1)
    means = play.frames.reshape(312, 4, 2, 4, 2, 3).mean(axis=(2, 4))
    assert np.abs(raw.load(tmp_path / "again").frames - means).max() <= 1


def cut_file(folder):
    path = folder / "data/chunk-000/file-000.parquet"
    path.write_bytes(path.read_bytes()[:-50])


def flip_bit_of_a_picture(folder):
    path = folder / "data/chunk-000/file-000.parquet"
    data = bytearray(path.read_bytes())
    data[data.index(b"IDAT") + 20] ^= 1
    path.write_bytes(data)


def drop_column(folder):
    path = folder / "data/chunk-000/file-000.parquet"
    parquet.write_table(parquet.read_table(path).drop_columns(["segment_start"]), path)


def forget_play(folder):
    (folder / "meta/play.json").unlink()


def rename_column(folder):
    path = folder / "meta/info.json"
    path.write_text(path.read_text().replace('"absolute_action"', '"other"'))


def changed(key, value):
    def change(folder):
        path = folder / "data/chunk-000/file-000.parquet"
        table = parquet.read_table(path)
        rows = table.column(key).to_pylist()
        rows[7] = value
        number = table.column_names.index(key)
        parquet.write_table(table.set_column(number, key, [pyarrow_array(rows, table.schema.field(key).type)]), path)

    return change


def paths_of_pictures(folder):
    path = folder / "data/chunk-000/file-000.parquet"
    table = parquet.read_table(path)
    column = pyarrow_array(["frame.png"] * len(table), None)
    parquet.write_table(table.set_column(0, table.column_names[0], [column]), path)


def lose_rows(folder):
    path = folder / "data/chunk-000/file-000.parquet"
    table = parquet.read_table(path)
    parquet.write_table(table.take([i for i in range(len(table)) if i != 3]), path)


def lose_the_last_row(folder):
    path = folder / "data/chunk-000/file-000.parquet"
    parquet.write_table(parquet.read_table(path)[:-1], path)


def a_pipe_instead(folder):
    path = folder / "data/chunk-000/file-000.parquet"
    path.unlink()
    os.mkfifo(path)


def tall_picture(side):
    """A PNG of no data whose header tells of that many pixels."""
    header = b"IHDR" + struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))


def pyarrow_array(rows, kind):
    import pyarrow

    return pyarrow.array(rows, kind)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (cut_file, "file-000.parquet is damaged"),
        (flip_bit_of_a_picture, "file-000.parquet is damaged"),
        (drop_column, "file-000.parquet is damaged, or has not the columns of `beso export`"),
        (forget_play, r"play.json is missing"),
        (rename_column, "no column of this name: absolute_action"),
        (changed("action", [np.nan] * 7), r"file-000.parquet: action holds nan at \[2, 0\]: every number"),
        (changed("action", [3.0] * 7), "action reach 3, expected at most 1"),
        (changed("segment_start", 2), "segment_start holds 2, expected 0 and 1"),
        (changed("observation.images.static", {"bytes": b"no picture", "path": ""}), "something else than square"),
        (changed("observation.images.static", None), "something else than square"),
        (changed("observation.images.static", {"bytes": tall_picture(30000), "path": ""}), "something else than squ"),
        (paths_of_pictures, "file-000.parquet is damaged, or has not"),
        (changed("episode_index", None), "episode_index holds object, expected real numbers"),
        (lose_rows, "index does not go on from 0: a file or rows are missing or moved"),
        (a_pipe_instead, r"has 0 frames; meta/info\.json says 312"),
        (lose_the_last_row, r"has 311 frames; meta/info\.json says 312"),
    ],
)
def test_damage_is_one_line(tmp_path, folder, damage, message):
    damage(folder)
    with pytest.raises(UserError, match=message) as caught:
        recording.convert(folder, tmp_path / "again", SIZE, 1)
    assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "again").exists()


def test_pictures_of_two_sizes_are_refused_where_none_is_asked_for(tmp_path, folder):
    picture = lerobot._png(np.zeros((9, 9, 3), dtype=np.uint8))
    changed("observation.images.static", {"bytes": picture, "path": ""})(folder)
    with pytest.raises(UserError, match="holds pictures of more than one size"):
        lerobot.convert(folder, tmp_path / "again", None)


def test_without_the_package_it_says_what_to_install(tmp_path, play, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(UserError, match=r"needs the package pyarrow: install this project with its extra \[lerobot\]"):
        recording.export(play, tmp_path / "lerobot", "lerobot")
    assert not (tmp_path / "lerobot").exists()
