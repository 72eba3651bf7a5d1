import os
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from beso.data.store import write_npy
from beso.envs.calvin.simulator.observations import block_slice
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.errors import UserError
from beso.files import read_json, write_json
from beso.images import frames

ENDS = np.array([100, 160, 300])


def columns(steps=300):
    rng = np.random.default_rng(1)
    return {
        "actions": rng.normal(size=(steps, 7)).astype(np.float32),
        "tasks": rng.integers(2, size=(steps, 34), dtype=np.uint8),
        "states": rng.normal(size=(steps, 39)).astype(np.float32),
    }


@pytest.fixture
def raw(tmp_path):
    """Frames of three episodes, each with a brightness of its own; more of them than a block."""
    rng = np.random.default_rng(0)
    array = rng.integers(100, size=(300, 16, 16, 3), dtype=np.uint8)
    array[100:160] += 120
    write_npy(tmp_path / "raw.npy", array)
    return tmp_path / "raw.npy"


def pack(raw, folder, size=8, held_out=(1,)):
    frames.pack(frames.FrameFile(raw), columns(), ENDS, held_out, size, folder, {"raw": {"source": "random"}})
    return frames.load(folder)


def test_frames_are_means_over_areas_and_the_rest_is_unchanged(raw, tmp_path):
    packed, whole = pack(raw, tmp_path / "frames"), np.load(raw)
    read = packed.frames.read(np.arange(300))
    assert np.abs(read - whole.reshape(300, 8, 2, 8, 2, 3).mean(axis=(2, 4))).max() <= 0.5
    for name, values in columns().items():
        assert np.array_equal(getattr(packed, name), values)
    assert packed.meta["raw"] == {"source": "random"}
    assert packed.meta["counts"] == {"episodes": 3, "steps": 300}
    assert np.array_equal(pack(raw, tmp_path / "same", size=16).frames.read(np.arange(300)), whole)


def test_rows_and_blocks_are_those_of_the_array(raw):
    whole, file = np.load(raw), frames.FrameFile(raw)
    rows = np.array([299, 0, 5, 5])
    assert np.array_equal(file.read(rows), whole[rows])
    blocks = list(file.blocks(3, 290))
    assert max(map(len, blocks)) == frames.BLOCK
    assert np.array_equal(np.concatenate(blocks), whole[3:290])


def test_statistics_are_those_of_the_training_episodes(raw, tmp_path):
    packed = pack(raw, tmp_path / "frames")
    assert packed.held_out.tolist() == [False] * 100 + [True] * 60 + [False] * 140
    assert packed.ends.tolist() == [100] * 100 + [160] * 60 + [300] * 140
    training = packed.frames.read(np.flatnonzero(~packed.held_out)) / 255
    assert np.allclose(packed.meta["mean"], training.mean(axis=(0, 1, 2)), rtol=1e-9)
    assert np.allclose(packed.meta["std"], training.std(axis=(0, 1, 2)), rtol=1e-6)


def test_the_same_bytes_again(raw, tmp_path):
    pack(raw, tmp_path / "a")
    pack(raw, tmp_path / "b")
    names = sorted(path.name for path in (tmp_path / "a").iterdir())
    assert names == sorted([*(f"{name}.npy" for name in frames.ARRAYS), "meta.json"])
    for name in names:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_colours_keep_their_order(tmp_path):
    """Where the red block and the blue one are taken away, red and blue pixels go."""
    table, scene = PlayTable(), np.zeros(24)
    for block, x in enumerate((0.02, 0.14, 0.27)):
        scene[block_slice(block)] = x, -0.11, 0.46, 0, 0, np.pi / 2
    pictures = []
    for gone in (None, 0, 1):  # none, red, blue
        changed = scene.copy()
        if gone is not None:
            changed[block_slice(gone)][2] = -5
        table.reset(changed)
        pictures.append(table.picture(64))
    table.close()
    write_npy(tmp_path / "raw.npy", np.stack(pictures))
    frames.pack(frames.FrameFile(tmp_path / "raw.npy"), columns(3), np.array([2, 3]), [1], 32, tmp_path / "out", {})
    packed = frames.load(tmp_path / "out").frames.read(np.arange(3)).astype(int)
    for gone, channel in ((1, 0), (2, 2)):
        place = np.unravel_index(np.abs(packed[0] - packed[gone]).sum(axis=2).argmax(), (32, 32))
        assert packed[0][place].argmax() == channel
    frames.write_samples(frames.load(tmp_path / "out").frames, tmp_path / "samples.png", 1, 3)
    sheet = cv2.cvtColor(cv2.imread(str(tmp_path / "samples.png")), cv2.COLOR_BGR2RGB)
    assert np.array_equal(sheet, np.concatenate(list(packed), axis=1))


PACK = """
import sys
from pathlib import Path
import numpy as np
from beso.images import frames
steps, folder = int(sys.argv[1]), Path(sys.argv[2])
with (folder / "raw.npy").open("wb") as file:
    header = {"descr": "|u1", "fortran_order": False, "shape": (steps, 60, 60, 3)}
    np.lib.format.write_array_header_1_0(file, header)
    file.truncate(file.tell() + steps * 60 * 60 * 3)
columns = {name: np.zeros((steps, 39), "f4") for name in frames.COLUMNS}
ends = np.arange(1000, steps + 1, 1000)
frames.pack(frames.FrameFile(folder / "raw.npy"), columns, ends, [0], 12, folder / "out", {})
print(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
"""


@pytest.mark.parametrize("steps", [20_000, 200_000])
def test_memory_does_not_grow_with_the_number_of_frames(tmp_path, steps):
    """200,000 frames of 60 pixels are 2.2 GB; the file is sparse, so that it need not be written first."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    command = [sys.executable, "-c", PACK, str(steps), str(tmp_path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    # Of this process alone; getrusage would count the one that started it.
    assert int(done.stdout) < 400_000  # kB


def test_frames_that_are_too_small_or_not_square_are_refused(raw, tmp_path):
    with pytest.raises(UserError, match="frames of 16 x 16 pixels cannot be packed as 17 x 17"):
        pack(raw, tmp_path / "frames", size=17)
    assert not (tmp_path / "frames").exists()
    write_npy(tmp_path / "wide.npy", np.zeros((300, 8, 9, 3), dtype=np.uint8))
    with pytest.raises(UserError, match="frames of 8 x 9 pixels"):
        pack(tmp_path / "wide.npy", tmp_path / "frames")
    write_npy(tmp_path / "flat.npy", np.zeros((300, 8), dtype=np.uint8))
    with pytest.raises(UserError, match=r"flat.npy holds uint8 \(300, 8\), expected uint8 frames"):
        frames.FrameFile(tmp_path / "flat.npy")


def test_missing_truncated_and_altered_files(raw, tmp_path):
    folder = tmp_path / "frames"
    with pytest.raises(UserError, match=r"holds no packed frames: it has no meta\.json"):
        frames.load(folder)
    pack(raw, folder)
    path = folder / "frames.npy"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    with pytest.raises(UserError, match=r"frames.npy is truncated"):
        frames.load(folder)
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    with pytest.raises(UserError, match=r"frames.npy is not the file that meta.json describes"):
        frames.load(folder)
    path.write_bytes(whole)
    meta = read_json(folder / "meta.json")
    write_json(folder / "meta.json", {key: value for key, value in meta.items() if key != "held_out_episodes"})
    with pytest.raises(UserError, match=r"meta.json is damaged: it has no 'held_out_episodes'"):
        frames.load(folder)
    write_json(folder / "meta.json", meta)
    write_npy(folder / "tasks.npy", np.zeros((299, 34), dtype=np.uint8))
    with pytest.raises(UserError, match=r"tasks holds uint8 \(299, 34\), expected uint8 \(300, 34\)"):
        frames.load(folder, verify=False)
    (folder / "states.npy").unlink()
    with pytest.raises(UserError, match=r"states.npy is missing"):
        frames.load(folder)
