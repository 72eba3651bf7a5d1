import json

import numpy as np
import pytest
import safetensors.torch
import torch

from beso.encoders import encoder
from beso.encoders.resnet import ResNet18
from beso.errors import UserError

CPU = torch.device("cpu")
SIZE = 40


def encoding(**changes):
    values = {"width": 8, "size": SIZE, "mean": (0.4, 0.5, 0.6), "std": (0.2, 0.3, 0.25), "precision": "fp32"}
    return encoder.Encoding(**{**values, **changes})


@pytest.fixture
def frames():
    return np.random.default_rng(0).integers(256, size=(37, SIZE, SIZE, 3), dtype=np.uint8)


@pytest.fixture
def folder(tmp_path):
    encoder.save(tmp_path, ResNet18(8, torch.Generator().manual_seed(0)), encoding(), {"source": "random"})
    return tmp_path


def test_is_the_network_on_standardised_frames(folder, frames):
    network = ResNet18(8, torch.Generator().manual_seed(0)).eval()
    pictures = (frames / 255 - np.array([0.4, 0.5, 0.6])) / np.array([0.2, 0.3, 0.25])
    with torch.no_grad():
        expected = network(torch.tensor(pictures, dtype=torch.float32).permute(0, 3, 1, 2))
    features = encoder.load(folder, CPU)(frames)
    assert features.dtype == np.float32
    assert np.allclose(features, expected.numpy(), rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("precision", ["fp32", "bf16"])
@pytest.mark.parametrize(("width", "head"), [(16, "average"), (16, "pyramid"), (32, "average")])
def test_a_frames_features_do_not_depend_on_the_others(width, head, precision, frames):
    network = ResNet18(width, torch.Generator().manual_seed(0), head)
    encode = encoder.FrameEncoder(network, encoding(width=width, head=head, precision=precision), CPU)
    together = encode(frames)
    order = np.random.default_rng(1).permutation(len(frames))
    assert np.array_equal(encode(frames[order]), together[order])
    assert np.array_equal(np.concatenate([encode(frames[i : i + 1]) for i in range(20)]), together[:20])
    assert encode(frames[:0]).shape == (0, 512)


def test_a_pyramid_is_saved_and_loaded(tmp_path, frames):
    network = ResNet18(8, torch.Generator().manual_seed(0), "pyramid")
    encoder.save(tmp_path, network, encoding(head="pyramid"), {})
    again = encoder.load(tmp_path, CPU)
    assert np.array_equal(again(frames), encoder.FrameEncoder(network, encoding(head="pyramid"), CPU)(frames))
    path = tmp_path / "encoder.json"
    path.write_text(path.read_text().replace('"pyramid"', '"average"'))
    with pytest.raises(UserError, match=r"laterals\.0\.bias has shape .* not None"):
        encoder.load(tmp_path, CPU)


def test_frames_of_another_size_or_kind_are_refused(folder, frames):
    encode = encoder.load(folder, CPU)
    with pytest.raises(UserError, match=r"takes uint8 frames \(B, 40, 40, 3\), not uint8 \(37, 39, 40, 3\)"):
        encode(frames[:, 1:])
    with pytest.raises(UserError, match="not float64"):
        encode(frames.astype(float))


def test_missing_damaged_and_altered_files(folder):
    weights, description = folder / encoder.WEIGHTS, folder / encoder.DESCRIPTION
    whole, values = weights.read_bytes(), json.loads(description.read_text())
    weights.write_bytes(whole[:-4])
    with pytest.raises(UserError, match=r"encoder.safetensors is not the file that encoder.json describes"):
        encoder.load(folder, CPU)
    weights.unlink()
    with pytest.raises(UserError, match=r"encoder.safetensors is missing"):
        encoder.load(folder, CPU)
    weights.write_bytes(whole)
    description.write_text(json.dumps({**values, "encoding": {**values["encoding"], "width": 16}}))
    with pytest.raises(UserError, match=r"does not hold a ResNet-18 of width 16: bn1\.bias has shape"):
        encoder.load(folder, CPU)
    description.write_text(json.dumps({**values, "encoding": {**values["encoding"], "std": [0.0, 1.0, 1.0]}}))
    with pytest.raises(UserError, match=r"encoding: std = .* must be above 0"):
        encoder.load(folder, CPU)
    description.unlink()
    with pytest.raises(UserError, match=r"encoder.json is missing"):
        encoder.load(folder, CPU)


def test_a_classifier_is_left_out():
    weights = ResNet18(8, torch.Generator().manual_seed(0)).state_dict()
    weights |= {"fc.weight": torch.zeros(10, 512), "fc.bias": torch.zeros(10)}
    loaded = encoder.network(encoding(), weights, "weights")
    assert all(torch.equal(value, weights[name]) for name, value in loaded.state_dict().items())
    assert safetensors.torch.save(dict(loaded.state_dict()))
