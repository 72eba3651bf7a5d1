import numpy as np
import pytest
import torch
from scipy.signal import correlate

from beso.encoders.resnet import WIDTHS, ResNet18


def make(width=8, seed=0):
    """A network whose batch norms do something: statistics and weights are random."""
    generator = torch.Generator().manual_seed(seed)
    network = ResNet18(width, generator).double().eval()
    with torch.no_grad():
        for module in network.modules():
            if isinstance(module, torch.nn.BatchNorm2d):
                for tensor in (module.weight, module.bias, module.running_mean):
                    tensor.normal_(0.5, 0.3, generator=generator)
                module.running_var.uniform_(0.5, 2, generator=generator)
    return network


class ByHand:
    """The published network in numpy: full correlations, then every n-th row and column."""

    def __init__(self, network):
        self.weights = {name: value.numpy() for name, value in network.state_dict().items()}

    def convolution(self, x, name, stride, padding):
        x = np.pad(x, ((0, 0), (padding, padding), (padding, padding)))
        return np.stack([correlate(x, kernel, "valid")[0] for kernel in self.weights[f"{name}.weight"]])[
            :, ::stride, ::stride
        ]

    def norm(self, x, name):
        weight, bias, mean, variance = (
            self.weights[f"{name}.{part}"][:, None, None] for part in ("weight", "bias", "running_mean", "running_var")
        )
        return weight * (x - mean) / np.sqrt(variance + 1e-5) + bias

    def block(self, x, name, stride):
        inner = np.maximum(self.norm(self.convolution(x, f"{name}.conv1", stride, 1), f"{name}.bn1"), 0)
        inner = self.norm(self.convolution(inner, f"{name}.conv2", 1, 1), f"{name}.bn2")
        if f"{name}.downsample.0.weight" in self.weights:
            x = self.norm(self.convolution(x, f"{name}.downsample.0", stride, 0), f"{name}.downsample.1")
        return np.maximum(inner + x, 0)

    def last_maps(self, x):
        x = np.maximum(self.norm(self.convolution(x, "conv1", 2, 3), "bn1"), 0)
        x = np.pad(x, ((0, 0), (1, 1), (1, 1)), constant_values=-np.inf)
        windows = np.lib.stride_tricks.sliding_window_view(x, (3, 3), axis=(1, 2))
        x = windows.max(axis=(3, 4))[:, ::2, ::2]
        for stage in range(1, 5):
            for block in range(2):
                x = self.block(x, f"layer{stage}.{block}", 2 if stage > 1 and block == 0 else 1)
        return x


@pytest.mark.parametrize("width", [8, 16])
def test_agrees_with_numpy(width):
    network, picture = make(width), torch.randn(1, 3, 64, 64, generator=torch.Generator().manual_seed(1)).double()
    maps = ByHand(network).last_maps(picture[0].numpy())
    assert maps.shape == (8 * width, 2, 2)
    if width == 16:  # four quarters
        expected = maps.reshape(-1)
    else:  # a 2 x 2 map has two columns for four parts, so that columns overlap as torch's adaptive pooling has it
        expected = maps[:, :, [0, 0, 1, 1]].reshape(-1)
    with torch.no_grad():
        assert np.allclose(network(picture)[0].numpy(), expected, rtol=1e-9, atol=1e-9)


def test_is_the_published_network():
    network = ResNet18(64, torch.Generator())
    assert sum(p.numel() for p in network.parameters()) == 11_689_512 - (512 + 1) * 1000  # without the classifier
    names = set(network.state_dict())
    assert len(names) == 120  # 122 in torchvision, of them two of the classifier
    for name, shape in {
        "conv1.weight": (64, 3, 7, 7),
        "bn1.num_batches_tracked": (),
        "layer1.0.conv1.weight": (64, 64, 3, 3),
        "layer2.0.downsample.0.weight": (128, 64, 1, 1),
        "layer3.1.bn2.running_var": (256,),
        "layer4.1.conv2.weight": (512, 512, 3, 3),
    }.items():
        assert tuple(network.state_dict()[name].shape) == shape


@pytest.mark.parametrize("head", ["average", "pyramid"])
@pytest.mark.parametrize("width", WIDTHS)
def test_always_512_features(width, head):
    network = ResNet18(width, torch.Generator(), head).eval()
    with torch.no_grad():
        for size in (32, 84, 112):
            assert network(torch.zeros(2, 3, size, size)).shape == (2, 512)


def bilinear(x, side):
    """Maps (C, n, n) at side x side places between their pixels' centres, the borders repeated."""
    places = np.clip((np.arange(side) + 0.5) * x.shape[1] / side - 0.5, 0, x.shape[1] - 1)
    below = places.astype(int)
    above, share = np.minimum(below + 1, x.shape[1] - 1), places - below
    rows = x[:, below] * (1 - share)[:, None] + x[:, above] * share[:, None]
    return rows[:, :, below] * (1 - share) + rows[:, :, above] * share


def test_the_pyramid_adds_up_the_stages_maps():
    network = ResNet18(8, torch.Generator().manual_seed(0), "pyramid").double().eval()
    picture, maps = torch.randn(1, 3, 256, 256, generator=torch.Generator().manual_seed(1)).double(), []
    for stage in (network.layer1, network.layer2, network.layer3, network.layer4):
        stage.register_forward_hook(lambda _module, _inputs, output: maps.append(output[0].numpy()))
    with torch.no_grad():
        found = network(picture)[0].numpy()
    assert [x.shape for x in maps] == [(8, 64, 64), (16, 32, 32), (32, 16, 16), (64, 8, 8)]
    expected = np.zeros((8, 8, 8))
    for x, lateral in zip(reversed(maps), reversed(network.laterals), strict=True):
        weight, bias = lateral.weight.detach().numpy()[:, :, 0, 0], lateral.bias.detach().numpy()
        expected = bilinear(expected, x.shape[1]) + np.einsum("oc,cyx->oyx", weight, x) + bias[:, None, None]
    places = expected.reshape(8, 8, 8, 8, 8).mean(axis=(2, 4))
    assert np.allclose(found, places.reshape(-1))


def test_initial_weights_come_from_the_generator_and_have_the_right_spread():
    first, again = (ResNet18(32, torch.Generator().manual_seed(3)).layer3[0].conv2.weight for _ in range(2))
    assert torch.equal(first, again)
    assert first.std().item() == pytest.approx((2 / (128 * 9)) ** 0.5, rel=0.02)


def test_other_widths_are_refused():
    with pytest.raises(ValueError, match="width = 24: must be one of 64, 32, 16, 8"):
        ResNet18(24, torch.Generator())
