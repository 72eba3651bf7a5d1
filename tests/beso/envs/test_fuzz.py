"""Every importer, on good files of which bytes were changed: it reads finite numbers or says in one line what is wrong.

A case is a number, from which the changes are drawn. `python -m tests.beso.envs.test_fuzz SECONDS` tries new ones.
"""

import shutil
import sys
import tempfile
import time
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

from beso.data import play
from beso.data.play import Episode
from beso.envs import minari_data
from beso.envs.block_push.demonstrations import published as block_push
from beso.envs.block_push.spec import SPEC
from beso.envs.calvin.demonstrations import lerobot, official, raw
from beso.envs.calvin.demonstrations.scripted import Step
from beso.envs.kitchen.demonstrations import published as kitchen
from beso.errors import UserError

LONGEST = 5.0  # seconds of a processor
NUMBERS = (b"0", b"9", b"-1", b"1e9", b"999999999999", b"\x00", b"\xff", b"'", b"{", b"nan")


def write_padded(folder, names, widths, time_first):
    rng, steps, lengths = np.random.default_rng(0), 6, np.array([4, 6])
    masks = (np.arange(steps) < lengths[:, None]).astype(np.float64)
    tasks = np.zeros((2, steps, widths[2]))
    tasks[:, 1, 1] = 1
    observations, actions = (rng.uniform(-0.05, 0.05, (2, steps, width)) for width in widths[:2])
    arrays = [observations * masks[..., None], actions * masks[..., None], masks, tasks]
    for name, array in zip(names, arrays, strict=True):
        stored = np.ascontiguousarray(np.swapaxes(array, 0, 1) if time_first else array)
        if name == names[-1]:
            torch.save(torch.from_numpy(stored), folder / f"{name}.pth")
        else:
            np.save(folder / f"{name}.npy", stored)


def write_minari(folder):
    pytest.importorskip("h5py")
    from minari.data_collector import EpisodeBuffer
    from minari.dataset.minari_storage import MinariStorage

    rng, box = np.random.default_rng(0), gymnasium.spaces.Box
    spaces = gymnasium.spaces.Dict(observation=box(-np.inf, np.inf, (59,), np.float64)), box(-1, 1, (9,), np.float64)
    storage = MinariStorage.new(folder / "data", *spaces)
    storage.update_metadata({"dataset_id": "D4RL/kitchen/test-v0", "minari_version": "0.5.3"})
    for i in range(2):
        states = rng.uniform(-0.05, 0.05, (6, 59))
        states[3:, 31] = -0.7  # the microwave
        ends = {"rewards": [0.0] * 5, "terminations": [False] * 5, "truncations": [False] * 5}
        actions = rng.uniform(-1, 1, (5, 9))
        storage.update_episodes([EpisodeBuffer(id=i, observations={"observation": states}, actions=actions, **ends)])


def write_exported(folder):
    pytest.importorskip("h5py")
    rng, tasks = np.random.default_rng(0), np.eye(5, 4)
    episodes = [Episode(rng.uniform(-0.05, 0.05, (5, 16)), rng.uniform(-0.05, 0.05, (5, 2)), tasks) for _ in range(2)]
    dataset = play.assemble(episodes, SPEC, {"source": "random"})
    minari_data.write(dataset, SPEC, "beso/BlockPush-v0", folder)
    shutil.move(folder / "beso/block_push-v0/data", folder / "data")


def write_calvin(folder, export=lambda play, folder: official.export(play, folder / "training")):
    rng = np.random.default_rng(0)

    def step(i):
        frame, tasks = rng.integers(256, size=(8, 8, 3), dtype=np.uint8), np.zeros(34, dtype=np.uint8)
        tasks[0] = i == 4
        actions = (rng.uniform(-1, 1, 7), rng.normal(size=7))
        return Step(frame, rng.normal(size=15), rng.normal(size=24), *actions, tasks, i == 0, "push")

    raw.write([[step(i) for i in range(5)] for _ in range(2)], folder / "raw", {"source": "random", "seed": 0})
    export(raw.load(folder / "raw"), folder)
    shutil.rmtree(folder / "raw")


def load_calvin(folder):
    official.convert([official.layout(folder / "training")], folder / "target", size=None, workers=1, meta={})
    return raw.load(folder / "target")


def write_lerobot(folder):
    pytest.importorskip("pyarrow")
    # What lies beside tells people and LeRobot more than is read again.
    write_calvin(folder, lambda play, folder: lerobot.export(play, folder / "set"))
    for name in (lerobot.STATS, lerobot.TASKS):
        (folder / "set" / name).unlink()
    shutil.rmtree(folder / "set/meta/episodes")


def load_lerobot(folder):
    lerobot.convert(folder / "set", folder / "target", size=None)
    return raw.load(folder / "target")


IMPORTERS = {
    "block_push": (
        lambda folder: write_padded(folder, tuple(block_push.FILES.values()), (16, 2, 4), time_first=False),
        block_push.load,
    ),
    "kitchen": (
        lambda folder: write_padded(folder, tuple(kitchen.FILES.values()), (60, 9, 7), time_first=True),
        kitchen.load,
    ),
    "kitchen_minari": (write_minari, kitchen.load),
    "block_push_exported": (write_exported, block_push.load),
    "calvin": (write_calvin, load_calvin),
    "calvin_lerobot": (write_lerobot, load_lerobot),
}


def change(folder, rng):
    """Change some bytes of one file: flipped, replaced by a number, cut off, repeated or moved."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    path = files[rng.integers(len(files))]
    data = bytearray(path.read_bytes())
    for _ in range(rng.integers(1, 4)):
        # Half of the changes are in headers.
        place = int(rng.integers(min(len(data), 256) if rng.random() < 0.5 else len(data)) if data else 0)
        kind = rng.integers(5)
        if kind == 0 and data:
            data[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            number = NUMBERS[rng.integers(len(NUMBERS))]
            data[place : place + len(number)] = number
        elif kind == 2:
            del data[place:]
        elif kind == 3:
            data[place:place] = data[place : place + int(rng.integers(1, 64))]
        else:
            data[place : place + 8] = rng.bytes(8)
    path.write_bytes(data)


def attempt(name, case, good, folder):
    """Import changed files. Returns what is wrong with what happened, or nothing."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(good, folder)
    change(folder, np.random.default_rng(case))
    start, wrong = time.process_time(), ""
    try:
        found = IMPORTERS[name][1](folder)
    except UserError as error:
        if len(str(error).splitlines()) != 1 or len(str(error)) > 1000:
            wrong = f"not one line: {error}"
    except Exception as error:
        wrong = f"{type(error).__name__}: {error}"
    else:
        parts = [found.rel_actions] if name.startswith("calvin") else [found.observations, found.actions]
        if not all(np.isfinite(part).all() for part in parts):
            wrong = "numbers that are not finite"
    if (took := time.process_time() - start) > LONGEST:
        wrong = f"took {took:.0f} s; {wrong}"
    return wrong


@pytest.mark.parametrize("name", IMPORTERS)
def test_changed_files_are_read_or_refused_in_one_line(name, tmp_path):
    (tmp_path / "good").mkdir()
    IMPORTERS[name][0](tmp_path / "good")
    IMPORTERS[name][1](shutil.copytree(tmp_path / "good", tmp_path / "unchanged"))
    for case in (*range(20), *FOUND[name]):
        assert attempt(name, case, tmp_path / "good", tmp_path / "changed") == "", case


# Cases that an importer once failed.
FOUND = {
    "block_push": (),
    "kitchen": (),
    "kitchen_minari": (),
    "block_push_exported": (),
    "calvin": (),
    "calvin_lerobot": (),
}


def main(seconds):
    """Try new cases on each importer for so long; print those that fail."""
    for name, (write, _) in IMPORTERS.items():
        with tempfile.TemporaryDirectory() as temporary:
            good = Path(temporary, "good")
            good.mkdir()
            write(good)
            case, refused_by, until = 1000, 0, time.monotonic() + seconds
            while time.monotonic() < until:
                case += 1
                if wrong := attempt(name, case, good, Path(temporary, "changed")):
                    refused_by += 1
                    print(name, case, wrong[:300], flush=True)
            print(f"{name}: {case - 1000} cases, {refused_by} wrong", flush=True)


if __name__ == "__main__":
    main(float(sys.argv[1]))
