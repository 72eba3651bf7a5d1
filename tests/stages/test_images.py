"""From raw play to play data of features: the stages collect, preprocess and features where policies see images."""

import dataclasses
import json

import numpy as np
import pandas as pd
import pytest
import torch

from beso import envs
from beso.core.seeding import torch_generator
from beso.data import play, store
from beso.encoders import encoder
from beso.encoders.resnet import ResNet18
from beso.envs.calvin.demonstrations import official, raw, recording
from beso.errors import UserError
from beso.files import sha256
from beso.images import frames
from beso.images.pretraining import Pretraining
from pipeline import paths
from pipeline import settings as parameters
from pipeline.machine import Machine
from pipeline.recipes import EnvironmentRecipe
from pipeline.report import figures
from stages import features
from stages.collect import collect
from stages.preprocess import main, preprocess

PRETRAINING = Pretraining(
    steps=4,
    batch_size=4,
    learning_rate=1e-3,
    weight_decay=0.01,
    inverse_dynamics=1.0,
    reconstruction=1.0,
    horizon=4,
    shift=1,
)
IMAGES = parameters.ImageParams(
    parameters.Preprocess(size=32, held_out=0.25),
    parameters.Features(8, "average", "fp32", None, PRETRAINING, finetune=False),
)
COLLECT = parameters.Collect("raw", "scripted", 4, None, parameters.Camera(length=12, size=40))


@pytest.fixture(autouse=True)
def empty(tmp_path, monkeypatch):
    """An empty folder as working directory."""
    monkeypatch.chdir(tmp_path)


def recipe(settings):
    return EnvironmentRecipe("calvin", 0, settings)


def machine(workers):
    return Machine(workers=workers, device="cpu")


def make_raw(settings=COLLECT, workers=1):
    collect(recipe(settings), machine(workers))


def pack(images=IMAGES):
    preprocess(recipe(images.preprocess))


def make_features(images=IMAGES, workers=1):
    features.make_features(recipe(images.features), machine(workers))


def run(images=IMAGES):
    pack(images)
    make_features(images)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Raw play of four short episodes, recorded once."""
    folder = tmp_path_factory.mktemp("recorded")
    parts = [folder / str(i) for i in range(4)]
    for i, part in enumerate(parts):
        recording.record(0, i, 12, 40, part)
    recording.join(parts, folder / "raw", 0)
    return folder / "raw"


def give_raw(recorded):
    paths.raw("calvin").parent.mkdir(parents=True)
    paths.raw("calvin").symlink_to(recorded)


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("workers", [1, 2])
def test_raw_play_is_the_same_for_any_number_of_workers(recorded, workers):
    make_raw(workers=workers)
    assert contents(paths.raw("calvin")) == contents(recorded)
    assert raw.load(paths.raw("calvin")).meta["seed"] == 0
    assert (paths.film_of_play("calvin") / "rollout.webm").stat().st_size > 1000


def test_more_episodes_are_recorded_where_some_end_early(monkeypatch):
    asked, record = [], recording.record

    def short(seed, index, length, size, folder):
        asked.append(index)
        return record(seed, index, 7 if index == 1 else length, size, folder)

    monkeypatch.setattr(recording, "record", short)
    make_raw()
    assert asked == [0, 1, 2, 3, 4]
    assert raw.load(paths.raw("calvin")).episode_ends.tolist() == [12, 19, 31, 43, 55]


def test_an_interruption_of_recording_or_filming_keeps_whole_episodes(recorded, monkeypatch):
    record, played, filmed = recording.scripted.record, [], []

    def interrupted(seed, index, length, size):
        played.append(index)
        if played == [0, 1, 2]:
            raise KeyboardInterrupt
        return record(seed, index, length, size)

    def film(*_):
        filmed.append(len(played))
        if len(filmed) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(recording.scripted, "record", interrupted)
    monkeypatch.setattr("stages.collect.write_film", film)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            make_raw()
    make_raw()
    assert (played, filmed) == ([0, 1, 2, 2, 3], [5, 5])
    assert contents(paths.raw("calvin")) == contents(recorded)
    assert list(paths.SCRATCH.iterdir()) == []


def test_published_data_keep_their_split(recorded, tmp_path):
    for name in ("training", "validation"):
        official.export(raw.load(recorded), tmp_path / "published" / name)
    firsts = sorted((tmp_path / "published/validation").glob("episode_*.npz"))[::12]
    for first in firsts:  # other episodes, as far as their first frames tell
        frame = dict(np.load(first))
        frame["rgb_static"][0, 0] ^= 1
        np.savez(first, **frame)
    published = dataclasses.replace(COLLECT, source="published", folder=str(tmp_path / "published"))
    make_raw(published)
    assert [path.name for path in paths.film_of_play("calvin").iterdir()] == ["rollout.json"]
    pack()
    packed = frames.load(paths.frames("calvin"))
    assert packed.meta["held_out_episodes"] == [4, 5, 6, 7]
    same = np.arange(48)[np.arange(48) % 12 > 0]
    assert np.array_equal(packed.frames.read(same), packed.frames.read(48 + same))
    with pytest.raises(UserError, match=r"nowhere has no folder `training`"):
        make_raw(dataclasses.replace(published, folder="nowhere"))


def test_features_are_what_the_encoder_beside_them_makes_of_the_frames(recorded, capsys):
    give_raw(recorded)
    run()
    folder = paths.play("calvin")
    packed, source = frames.load(paths.frames("calvin")), raw.load(recorded)
    features = store.read_npy(folder / "observations.npy")
    assert features.shape == (48, 512)
    assert features.dtype == np.float32
    encode = encoder.load(folder, torch.device("cpu"))
    assert np.array_equal(encode(packed.frames.read(np.arange(48))), features)
    assert np.array_equal(store.read_npy(folder / "actions.npy"), source.rel_actions)
    assert np.array_equal(store.read_npy(folder / "tasks.npy"), source.tasks)
    assert np.array_equal(store.read_npy(folder / "episode_ends.npy"), source.episode_ends)
    meta = json.loads((folder / "meta.json").read_text())
    assert meta["source"] == "scripted"
    assert meta["sha256"]["observations"] == sha256(folder / "observations.npy")
    assert len(packed.meta["held_out_episodes"]) == 1
    assert list(paths.SCRATCH.iterdir()) == []


def test_the_same_bytes_with_other_workers_and_after_a_kill(recorded, monkeypatch):
    give_raw(recorded)
    monkeypatch.setattr("stages.features.SHARE", 10)
    run()
    first, table = contents(paths.play("calvin")), paths.probe("calvin").read_bytes()
    make_features(workers=2)
    assert contents(paths.play("calvin")) == first
    assert paths.probe("calvin").read_bytes() == table

    def killed(*arguments):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("stages.features.encode_all", killed)
        with pytest.raises(KeyboardInterrupt):
            make_features()
        assert contents(paths.play("calvin")) == first  # as it was
    with monkeypatch.context() as patch:
        patch.setattr("stages.features.pretrain", killed)  # the encoder is there already
        make_features()
    assert contents(paths.play("calvin")) == first


def test_the_probe_compares_with_random_weights_and_the_state_itself():
    make_raw(dataclasses.replace(COLLECT, camera=parameters.Camera(length=60, size=40)))  # more steps than numbers
    run()
    table = pd.read_csv(paths.probe("calvin"))
    assert set(table["representation"]) == {"features", "random encoder", "state"}
    assert set(table["target"]) >= {"drawer", "slider", "led", "lightbulb", "block_red", "hand"}
    rows = table.set_index(["target", "representation"])
    assert rows.loc[("hand", "state"), "value"] < 0.5 * rows.loc[("hand", "state"), "constant"]
    assert len(figures.samples(paths.samples("calvin")).axes[0].images) == 1
    drawn = figures.probe(table)
    assert [axis.get_ylabel() for axis in drawn.axes] == ["accuracy", "error over that of a constant"]
    assert [len(axis.patches) for axis in drawn.axes] == [4 * 3, 5 * 3]  # targets, representations
    heights = [bar.get_height() for bar in drawn.axes[0].patches[:4]]  # of the features
    accuracies = table[(table["representation"] == "features") & (table["measure"] == "accuracy")]
    np.testing.assert_array_equal(heights, accuracies["value"])  # NaN where nothing could be measured


def given(tmp_path, **changes):
    torch.save(ResNet18(8, torch.Generator().manual_seed(5)).state_dict(), tmp_path / "weights.pth")
    values = {
        "path": "weights.pth",
        "sha256": sha256(tmp_path / "weights.pth"),
        "mean": (0.485, 0.456, 0.406),
        "std": (0.229, 0.224, 0.225),
    }
    weights = parameters.Weights(**{**values, **changes})
    return dataclasses.replace(IMAGES, features=dataclasses.replace(IMAGES.features, weights=weights))


def test_given_weights_are_used_as_they_are(recorded, tmp_path):
    give_raw(recorded)
    run(given(tmp_path))
    made = encoder.load(paths.play("calvin"), torch.device("cpu"))
    expected = ResNet18(8, torch.Generator().manual_seed(5)).state_dict()
    assert all(torch.equal(value, expected[name]) for name, value in made.network.state_dict().items())
    assert made.encoding.mean == (0.485, 0.456, 0.406)


def finetuned(steps=PRETRAINING.steps, images=IMAGES):
    pretraining = dataclasses.replace(PRETRAINING, steps=steps)
    return dataclasses.replace(
        images, features=dataclasses.replace(images.features, finetune=True, pretraining=pretraining)
    )


def test_policies_that_train_the_encoder_get_the_frames_and_its_start(recorded, capsys):
    give_raw(recorded)
    run()
    frozen, table = contents(paths.play("calvin")), paths.probe("calvin").read_bytes()
    run(finetuned())
    folder = paths.play("calvin")
    ours = contents(folder)
    assert ours["observations.npy"] == (paths.frames("calvin") / "frames.npy").read_bytes()
    assert ours["encoder.safetensors"] == frozen["encoder.safetensors"]
    description = json.loads(ours["encoder.json"])
    assert {**json.loads(frozen["encoder.json"]), "finetune": True, "shift": 1} == description
    dataset = play.load(folder, envs.spec("calvin"))
    assert dataset.meta["finetune"] == {"frame_size": 32, "encoder": sha256(folder / "encoder.json")}
    assert paths.probe("calvin").read_bytes() == table, "the probe tells of the start"
    assert all(name in ours and ours[name] == frozen[name] for name in frozen if name[:-4] in ("actions", "tasks"))
    assert list(paths.SCRATCH.iterdir()) == []


def test_joint_training_may_start_at_random_or_given_weights(recorded, tmp_path):
    give_raw(recorded)
    run(finetuned(steps=0))
    random = encoder.load(paths.play("calvin"), torch.device("cpu")).network.state_dict()
    expected = ResNet18(8, torch_generator(0, "initial encoder weights")).state_dict()
    assert all(torch.equal(value, random[name]) for name, value in expected.items())
    run(finetuned(images=given(tmp_path)))
    assert json.loads((paths.play("calvin") / "encoder.json").read_text())["shift"] == 1
    with pytest.raises(ValueError, match=r"pretraining\.steps = 0: must be at least 1 unless finetune is true"):
        dataclasses.replace(finetuned(steps=0).features, finetune=False)


def test_mistakes_are_one_line_and_leave_nothing(recorded, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    with pytest.raises(UserError, match="data/raw/calvin is not raw CALVIN play"):
        pack()
    with pytest.raises(UserError, match="data/frames/calvin holds no packed frames"):
        make_features()
    give_raw(recorded)
    large = dataclasses.replace(IMAGES, preprocess=parameters.Preprocess(41, 0.25))
    with pytest.raises(UserError, match="frames of 40 x 40 pixels cannot be packed as 41 x 41"):
        pack(large)
    assert not paths.frames("calvin").exists()
    pack()
    with pytest.raises(UserError, match=r"weights.pth has SHA-256 \w+, but features.weights says 00"):
        make_features(given(tmp_path, path="~/weights.pth", sha256="00"))
    with pytest.raises(UserError, match=r"recipes/preprocess/block_push.json is missing: params.yaml has no"):
        main("block_push")
    assert not paths.play("calvin").exists()
