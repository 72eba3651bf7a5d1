"""An encoder that is trained with the policy."""

import copy
import dataclasses
import json
import math

import numpy as np
import pytest
import safetensors.torch
import torch
from torch import nn

from beso import methods
from beso.core.seeding import torch_generator
from beso.data import play
from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.data.windows import WindowConfig, Windows
from beso.encoders import encoder, finetuned
from beso.encoders.encoder import shifted
from beso.encoders.resnet import ResNet18
from beso.envs.calvin.spec import SPEC
from beso.errors import UserError
from beso.training import loop as training

CPU = torch.device("cpu")
SIZE = 48
ENCODING = encoder.Encoding(8, SIZE, (0.4, 0.5, 0.6), (0.2, 0.3, 0.25), "fp32")
METHODS = ["c_beso", "gcbc", "lmp", "ril", "c_bet", "c_ibc", "cfg_beso", "cx_diff"]


@pytest.fixture
def spec():
    return SPEC


@pytest.fixture
def folder(make_dataset, tmp_path):
    """Play data of random frames, and the encoder beside them."""
    states = make_dataset([14, 12, 16, 13])
    beside = tmp_path / "start"
    beside.mkdir()
    encoder.save(beside, ResNet18(8, torch.Generator().manual_seed(0)), ENCODING, {}, shift=2)
    frames = np.random.default_rng(0).integers(256, size=(len(states.actions), SIZE, SIZE, 3), dtype=np.uint8)
    meta = {"source": "random frames", "finetune": {"frame_size": SIZE, "encoder": "0123456789abcdef"}}
    files = [beside / encoder.WEIGHTS, beside / encoder.DESCRIPTION]
    play.save(dataclasses.replace(states, observations=frames, meta=meta), tmp_path / "data", files)
    return tmp_path / "data"


@pytest.fixture
def frames(folder):
    return play.load(folder, SPEC)


@pytest.fixture
def run(folder, frames, tmp_path):
    def run(job, state=None, save_seconds=math.inf):
        return training.train(job, frames, SPEC, CPU, state or tmp_path / "unused", save_seconds, folder)

    return run


@pytest.fixture
def join(folder, frames, make_job):
    """join(method) -> policy with encoder, and its windows of the first three episodes."""

    def join(name="c_beso", relative_goals=False):
        job = make_job(name)
        model, episodes = job.config.model, np.arange(3)
        policy = methods.load(name).Method(model, None, SPEC.sizes, torch_generator(0, "initial weights"))
        scaling = Scaling.fit(frames, episodes, SPEC, relative_goals)
        config = WindowConfig(model.window, 1, model.lookahead)
        windows = Windows(frames, episodes, scaling, config)
        policy.prepare(windows.actions, 0)
        return finetuned.join(policy, folder, frames, episodes, scaling).train(), windows

    return join


def generator(seed=0):
    return torch.Generator().manual_seed(seed)


def test_play_data_of_frames_are_memory_mapped_and_name_their_encoder(frames):
    assert isinstance(frames.observations, np.memmap)
    assert frames.observations.shape == (55, SIZE, SIZE, 3)
    other = dataclasses.replace(frames, meta={**frames.meta, "finetune": {"frame_size": SIZE, "encoder": "f" * 64}})
    assert play.data_digest(frames) != play.data_digest(other)
    assert play.data_digest(frames).endswith("-0123456789abcdef")


def test_play_data_of_frames_of_another_size_are_refused(frames):
    meta = {"finetune": {"frame_size": 40, "encoder": ""}}
    with pytest.raises(
        UserError, match=r"observations holds uint8 \(55, 48, 48, 3\), expected uint8 \(55, 40, 40, 3\)"
    ):
        play.check(dataclasses.replace(frames, meta=meta), SPEC, "here")


def test_nothing_of_frames_is_scaled_by_statistics(frames):
    scaling = Scaling.fit(frames, np.arange(3), SPEC)
    features = torch.randn(4, 512)
    assert torch.equal(scaling.scale_observations(features), features)
    assert np.allclose(scaling.action_low, frames.actions[:42].min(axis=0))


def test_windows_name_the_frames_of_their_steps(join):
    _, windows = join()
    batch = windows.sample(64, generator())
    start = batch.observations[:, 0, 0]
    assert torch.equal(batch.observations[..., 0], start[:, None] + torch.arange(3))
    assert (batch.goal[:, 0, 0] > start + 2).all()
    assert batch.observations.dtype == torch.long


@pytest.mark.parametrize("name", METHODS)
def test_gradients_reach_every_weight_of_the_encoder(join, name):
    model, windows = join(name)
    model.loss(windows.sample(4, generator()), generator()).backward()
    for key, parameter in model.encoder.named_parameters():
        assert parameter.grad.abs().sum() > 0, key


def test_a_batch_is_encoded_once_a_picture_with_its_samples_shift(join, frames):
    model, windows = join("lmp")
    batch, window = windows.sample(4, generator(3)), 4
    batch = batch._replace(goal=batch.observations[:, -1:])  # stands in the sample twice
    seen = []
    model.encoder.register_forward_pre_hook(lambda _, inputs: seen.append(inputs[0]))
    model.loss(batch, generator(7))
    (pictures,) = seen
    assert len(pictures) == 4 * window
    shifts = torch.randint(-2, 3, (4, 2), generator=generator(7)).repeat_interleave(window, dim=0)
    read = frames.observations[batch.observations.flatten().numpy()]
    moved = torch.from_numpy(shifted(read, (shifts + 2).numpy(), 2))
    assert torch.equal(pictures, ENCODING.standardise(moved))


def test_features_are_normalised_and_in_the_order_of_the_steps(join, frames):
    model, _ = join()
    model.eval()
    model.settle()
    steps = torch.tensor([[5, 2], [9, 5]])
    with torch.no_grad():
        features = model._encode(steps, torch.zeros(2, 2, dtype=torch.long))
    assert torch.allclose(features.mean(dim=-1), torch.zeros(2, 2), atol=1e-5)
    assert torch.allclose(features.var(dim=-1, unbiased=False), torch.ones(2, 2), atol=1e-2)
    assert torch.equal(features[0, 0], features[1, 1])
    encode = encoder.FrameEncoder(model.encoder, ENCODING, CPU)
    assert np.allclose(encode(frames.observations[[5, 2, 9]]), features[[0, 0, 1], [0, 1, 0]], atol=1e-4)


def test_relative_goals_are_features_less_the_first_states(join):
    passed = []
    for relative in (False, True):
        model, windows = join("c_beso", relative)
        model.eval()
        model.policy.loss = lambda batch, generator: passed.append(batch) or batch.observations.sum()
        model.loss(windows.sample(4, generator()), generator())
    absolute, relative = passed
    assert torch.equal(relative.observations, absolute.observations)
    assert torch.equal(relative.goal, absolute.goal - absolute.observations[:, :1])


def test_states_after_the_window_get_no_gradient(join):
    model, windows = join("ril")
    batch = windows.sample(4, generator())
    passed = []
    model.policy.loss = lambda batch, generator: passed.append(batch) or batch.observations.sum()
    model.loss(batch, generator())
    assert passed[0].future.shape == (4, 4, 512)
    assert not passed[0].future.requires_grad
    assert passed[0].observations.requires_grad
    assert passed[0].goal.requires_grad


def test_statistics_are_those_of_training_frames_under_the_weights(join, frames, monkeypatch):
    model, _ = join()
    model.eval()
    model.settle()
    first = model.encoder.network.conv1(ENCODING.standardise(torch.from_numpy(np.array(frames.observations[:42]))))
    norm = model.encoder.network.bn1
    assert torch.allclose(norm.running_mean, first.mean(dim=(0, 2, 3)), atol=1e-5)
    assert torch.allclose(norm.running_var, first.var(dim=(0, 2, 3)), rtol=1e-4)
    assert not any(module.training for module in model.modules())
    before = {key: value.clone() for key, value in model.state_dict().items()}
    model.settle()
    assert all(torch.equal(value, before[key]) for key, value in model.state_dict().items())
    monkeypatch.setattr(finetuned, "PART", 10)
    model.settle()
    assert torch.allclose(norm.running_mean, first.mean(dim=(0, 2, 3)), atol=1e-2)


def test_evaluation_of_a_loss_shifts_nothing_and_changes_nothing(join):
    model, windows = join()
    model.eval()
    model.settle()
    batch, before = windows.sample(8, generator()), model.encoder.network.bn1.running_mean.clone()
    with torch.no_grad():
        losses = [model.loss(batch, generator(1)).item() for _ in range(2)]
    assert losses[0] == losses[1]
    assert torch.equal(model.encoder.network.bn1.running_mean, before)


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_training_changes_the_encoder_and_keeps_it_in_the_averages(run, make_job, folder, precision):
    start = encoder.load(folder, CPU).network.state_dict()
    trained = run(make_job("gcbc", steps=2, precision=precision))
    ours = {key: value for key, value in trained.weights.items() if key.startswith("encoder.")}
    assert ours.keys() == {f"encoder.network.{key}" for key in start}
    learned = [key for key, value in start.items() if value.is_floating_point()]
    assert all(not torch.equal(ours[f"encoder.network.{key}"], start[key]) for key in learned)
    last = run(make_job("gcbc", steps=2, precision=precision, ema_decay=0.0)).weights
    assert not torch.equal(ours["encoder.network.conv1.weight"], last["encoder.network.conv1.weight"])
    assert trained.encoding == ENCODING
    assert all(value.is_contiguous() for value in trained.weights.values())


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
def test_the_encoders_precision_is_its_own(join, precision):
    model, windows = join("ril")
    model.encoding = dataclasses.replace(ENCODING, precision=precision)
    kinds = []
    model.encoder.network.conv1.register_forward_hook(lambda _, inputs, output: kinds.append(output.dtype))
    other = "bf16" if precision == "fp32" else "fp32"
    with torch.autocast("cpu", torch.bfloat16, enabled=other == "bf16"):
        loss = model.loss(windows.sample(4, generator()), generator())
    loss.backward()
    assert set(kinds) == {torch.bfloat16 if precision == "bf16" else torch.float32}
    assert model.encoder.network.conv1.weight.grad.abs().sum() > 0


class Killed(BaseException):
    """Stands for a kill: nothing catches it."""


@pytest.mark.parametrize(("name", "optimizer"), [("c_beso", "muon"), ("ril", "adam"), ("lmp", "adamw")])
def test_a_killed_run_continues_to_the_same_bytes(run, make_job, tmp_path, monkeypatch, name, optimizer):
    job, state = make_job(name, optimizer=optimizer, steps=5, every=2), tmp_path / "state"
    undisturbed = run(job)
    sample, calls = Windows.sample, []

    def killed(self, size, generator):
        calls.append(size)
        if size == 4 and calls.count(4) in (3, 5):  # the batch size; before step 3, and two steps after that
            raise Killed
        return sample(self, size, generator)

    monkeypatch.setattr(Windows, "sample", killed)
    for _ in range(2):
        with pytest.raises(Killed):
            run(job, state, save_seconds=0)
    resumed = run(job, state)
    assert safetensors.torch.save(resumed.weights) == safetensors.torch.save(undisturbed.weights)
    assert resumed.curve == undisturbed.curve


def test_only_the_frames_of_a_batch_are_read(join, monkeypatch):
    model, windows = join()
    read, asked = model._read, []
    model._read = lambda rows: asked.append(len(rows)) or read(rows)
    model.loss(windows.sample(2, generator()), generator())
    assert asked == [2 * 4]


def test_a_copy_of_the_model_does_not_copy_the_frames(frames, folder, join, monkeypatch):
    model, _ = join()
    monkeypatch.setattr(PlayDataset, "__deepcopy__", lambda *_: pytest.fail("copied"), raising=False)
    monkeypatch.setattr(np.memmap, "__deepcopy__", lambda *_: pytest.fail("copied"), raising=False)
    twin = copy.deepcopy(model)
    assert twin._read is model._read
    norms = [module for module in twin.modules() if isinstance(module, nn.BatchNorm2d)]
    assert [id(norm) for norm in twin._norms] == [id(norm) for norm in norms]


def test_a_frozen_encoder_is_no_start(frames, folder, make_job, run):
    description = json.loads((folder / encoder.DESCRIPTION).read_text())
    assert description["finetune"] is True
    del description["shift"]
    (folder / encoder.DESCRIPTION).write_text(json.dumps(description))
    with pytest.raises(UserError, match=r"encoder.json: shift = None: must be a number of pixels"):
        run(make_job("gcbc"))
