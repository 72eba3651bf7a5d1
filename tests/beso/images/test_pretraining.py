import dataclasses
import itertools

import numpy as np
import pytest
import torch

from beso.core.seeding import torch_generator
from beso.data.store import write_npy
from beso.encoders.encoder import Encoding, shifted
from beso.errors import UserError
from beso.images import frames, pretraining
from beso.images.pretraining import Pairs, Pretraining, pretrain

CPU = torch.device("cpu")
SIZE = 32
ENDS = np.array([40, 60, 61, 100])
CONFIG = Pretraining(
    steps=8,
    batch_size=4,
    learning_rate=1e-3,
    weight_decay=0.01,
    inverse_dynamics=1.0,
    reconstruction=1.0,
    horizon=5,
    shift=2,
)


@pytest.fixture
def play(tmp_path):
    """A bright square that moves as the action says."""
    rng = np.random.default_rng(0)
    steps = int(ENDS[-1])
    actions = rng.choice([-1.0, 1.0], size=(steps, 2)).astype(np.float32)
    array, place = np.full((steps, SIZE, SIZE, 3), 30, dtype=np.uint8), np.array([12, 12])
    for i in range(steps):
        y, x = place
        array[i, y : y + 8, x : x + 8] = 220
        place = np.clip(place + 2 * actions[i].astype(int), 0, SIZE - 8)
    write_npy(tmp_path / "raw.npy", array)
    columns = {"actions": actions, "tasks": np.zeros((steps, 1), "u1"), "states": np.zeros((steps, 1), "f4")}
    frames.pack(frames.FrameFile(tmp_path / "raw.npy"), columns, ENDS, [1], SIZE, tmp_path / "frames", {})
    return frames.load(tmp_path / "frames")


def encoding(play, precision="fp32"):
    return Encoding(8, SIZE, tuple(play.meta["mean"]), tuple(play.meta["std"]), precision)


def train(play, path, save_seconds=1e9, precision="fp32", **changes):
    config = dataclasses.replace(CONFIG, **changes)
    return pretrain(play, encoding(play, precision), config, 0, CPU, path, save_seconds)


def same(first, second):
    a, b = first.state_dict(), second.state_dict()
    return all(torch.equal(value, b[name]) for name, value in a.items())


def test_pairs_stay_within_a_training_episode(play):
    pairs, seen = Pairs(play, dataclasses.replace(CONFIG, batch_size=50, shift=0)), set()
    read = play.frames.read
    play.frames.read = lambda rows: seen.update(zip(*np.split(rows, 2), strict=True)) or read(rows)
    draws = torch_generator(0, "test")
    for _ in range(60):
        pairs.sample(draws)
    first, second = np.array(sorted(seen)).T
    assert (play.ends[first] == play.ends[second]).all()
    assert set((second - first).tolist()) == {1, 2, 3, 4, 5}
    assert not play.held_out[first].any()
    # Every frame with a successor is a first frame; the episode of one step has none.
    assert set(first.tolist()) == {*range(39), *range(61, 99)}


def test_targets_are_the_first_frames_action_and_each_frames_small_picture(play):
    config = dataclasses.replace(CONFIG, shift=0)
    pairs, draws = Pairs(play, config), torch_generator(0, "test")
    pixels, actions, pictures = pairs.sample(draws)
    assert pixels.shape == (8, SIZE, SIZE, 3)
    training = np.flatnonzero(~play.held_out)
    colours = np.array([[1, 1, 1], [1, -1, 0], [1, 1, -2]]) / np.sqrt([[3], [2], [6]])
    assert np.allclose(colours @ colours.T, np.eye(3))
    small = frames.resize(play.frames.read(training), pretraining.GRID) @ colours.T
    expected = (frames.resize(pixels, pretraining.GRID) @ colours.T - small.mean(0)) / np.maximum(small.std(0), 4)
    assert np.allclose(pictures.numpy(), expected.reshape(8, -1), atol=1e-5)
    scale = play.actions[training].astype(float).std(axis=0)
    rows = [np.flatnonzero((play.frames.read(np.arange(100)) == frame).all(axis=(1, 2, 3))) for frame in pixels[:4]]
    for action, candidates in zip(actions.numpy() * scale, rows, strict=True):
        assert any(np.allclose(action, play.actions[row], atol=1e-5) for row in candidates)


def test_shift_moves_and_repeats_the_border():
    array = np.arange(2 * 4 * 4 * 3, dtype=np.uint8).reshape(2, 4, 4, 3)
    moved = shifted(array, np.array([[1, 1], [0, 2]]), 1)
    assert np.array_equal(moved[0], array[0])
    assert np.array_equal(moved[1, 1:, :3], array[1, :3, 1:])
    assert np.array_equal(moved[1, 0], moved[1, 1])
    assert np.array_equal(moved[1, :, 3], moved[1, :, 2])


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_training_is_repeatable_and_resumes_to_the_same_bytes(play, tmp_path, monkeypatch, precision):
    whole, curve = train(play, tmp_path / "a", precision=precision)
    again, _ = train(play, tmp_path / "b", precision=precision)
    assert same(whole, again)
    sample, calls = Pairs.sample, itertools.count(1)

    def interrupted(self, draws):
        if next(calls) % 4 == 0:
            raise KeyboardInterrupt
        return sample(self, draws)

    monkeypatch.setattr(Pairs, "sample", interrupted)
    for _ in range(2):
        with pytest.raises(KeyboardInterrupt):
            train(play, tmp_path / "state", save_seconds=0, precision=precision)
    resumed, resumed_curve = train(play, tmp_path / "state", save_seconds=0, precision=precision)
    assert same(whole, resumed)
    assert curve == resumed_curve
    assert [row["step"] for row in curve] == list(range(1, 9))


def test_both_losses_fall(play, tmp_path):
    _, curve = train(play, tmp_path / "state", steps=150, batch_size=32, horizon=1, shift=0)
    assert curve[-1]["inverse_dynamics"] < 0.6 * curve[0]["inverse_dynamics"]
    assert curve[-1]["reconstruction"] < 0.6 * curve[0]["reconstruction"]


def test_an_objective_of_weight_0_changes_nothing(play, tmp_path):
    """Its head keeps its first weights, but for weight decay, and its loss does not reach the encoder."""
    alone, _ = train(play, tmp_path / "a", inverse_dynamics=0.0)
    both, _ = train(play, tmp_path / "b")
    assert not same(alone, both)


def test_bad_values_are_refused(play, tmp_path):
    with pytest.raises(ValueError, match="inverse_dynamics and reconstruction are both 0"):
        dataclasses.replace(CONFIG, inverse_dynamics=0.0, reconstruction=0.0)
    with pytest.raises(ValueError, match="horizon = 0"):
        dataclasses.replace(CONFIG, horizon=0)
    with pytest.raises(ValueError, match="shift = -1: must not be negative"):
        dataclasses.replace(CONFIG, shift=-1)
    with pytest.raises(UserError, match=r"the loss is not finite after \d steps; lower learning_rate"):
        train(play, tmp_path / "state", learning_rate=1e30)
    single = dataclasses.replace(play, episode_ends=np.arange(1, 101))
    with pytest.raises(UserError, match="no training episode has two frames"):
        Pairs(single, CONFIG)
