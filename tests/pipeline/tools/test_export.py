"""`beso export`, and the stage `collect` on what it wrote."""

from pathlib import Path

import numpy as np
import pytest

from beso import envs
from beso.data import play
from beso.data.play import Episode
from beso.envs.calvin.demonstrations import raw, scripted
from beso.errors import UserError
from pipeline import paths
from pipeline import settings as parameters
from pipeline.machine import Machine
from pipeline.recipes import EnvironmentRecipe
from pipeline.tools.export import export
from stages.collect import collect


@pytest.fixture(autouse=True)
def empty(tmp_path, monkeypatch):
    """An empty folder as working directory."""
    monkeypatch.chdir(tmp_path)


def random_play(name):
    """Small numbers, within all bounds; the first task is done in each episode."""
    spec, rng = envs.spec(name), np.random.default_rng(0)
    episodes = []
    for length in (6, 4, 8):
        tasks = np.zeros((length, len(spec.tasks)))
        tasks[3, 0] = 1
        sizes = (length, spec.observation_size), (length, spec.action_size)
        episodes.append(Episode(*(rng.uniform(-0.1, 0.1, size) for size in sizes), tasks))
    return play.assemble(episodes, spec, {"source": "scripted", "seed": 0})


def changed(name, folder, target, camera=None):
    """Which arrays are others after the stage imported what was exported."""
    before = {path.name: path.read_bytes() for path in target.glob("*.npy")}
    settings = parameters.Collect(target.parts[1], "published", 2, str(folder), camera)
    collect(EnvironmentRecipe(name, 0, settings), Machine(workers=1, device="cpu"))
    return {path.stem for path in target.glob("*.npy") if path.read_bytes() != before[path.name]}


@pytest.mark.parametrize("name", [name for name in envs.names() if not envs.sees_images(name)])
def test_play_of_states_goes_out_as_minaris_and_comes_back(tmp_path, monkeypatch, capsys, name):
    minari = pytest.importorskip("minari")
    play.save(random_play(name), paths.play(name))
    export(name, "minari", Path("exported"))
    shown = f"with MINARI_DATASETS_PATH={tmp_path}/exported/minari, minari.load_dataset('beso/{name}-v0')"
    assert shown in capsys.readouterr().out
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "exported/minari"))
    assert minari.load_dataset(f"beso/{name}-v0").total_steps == 18
    assert changed(name, f"exported/minari/beso/{name}-v0", paths.play(name)) == set()
    with pytest.raises(UserError, match=f"policies of {name} see no pictures: its play has the form minari alone"):
        export(name, "lerobot", tmp_path / "exported")


@pytest.mark.parametrize(("form", "lost"), [("lerobot", set()), ("official", {"tasks", "segment_starts"})])
def test_raw_play_goes_out_with_its_frames_and_comes_back(tmp_path, form, lost):
    if form == "lerobot":
        pytest.importorskip("pyarrow")
    raw.write([scripted.record(0, i, 60, 16) for i in range(2)], paths.raw("calvin"), {"source": "scripted"})
    export("calvin", form, tmp_path / "exported")
    assert changed("calvin", f"exported/{form}/calvin", paths.raw("calvin"), parameters.Camera(60, 16)) <= lost


def test_what_is_not_there_is_told_in_one_line(tmp_path):
    with pytest.raises(UserError, match="environment 'kitchn' is not one of"):
        export("kitchn", "lerobot", tmp_path)
    with pytest.raises(UserError, match="data/play/kitchen is not a play dataset"):
        export("kitchen", "minari", tmp_path)
    with pytest.raises(UserError, match="data/raw/calvin is not raw CALVIN play"):
        export("calvin", "lerobot", tmp_path)
