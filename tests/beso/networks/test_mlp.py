import math

import pytest
import torch

from beso.networks.layers import dropout
from beso.networks.mlp import MLP


def make(dropout_rate=0.0, seed=0):
    return MLP(6, 2, width=64, layers=3, dropout_rate=dropout_rate, generator=torch.Generator().manual_seed(seed))


def test_is_relu_layers_and_a_linear_output():
    network, x = make(), torch.randn(5, 6, generator=torch.Generator().manual_seed(0))
    expected = x
    for layer in network.hidden:
        expected = (expected @ layer.weight.T + layer.bias).clamp(min=0)
    expected = expected @ network.output.weight.T + network.output.bias
    assert torch.allclose(network(x), expected, atol=1e-6)
    assert [layer.weight.shape for layer in network.hidden] == [(64, 6), (64, 64), (64, 64)]


def test_the_papers_network_has_four_hidden_layers_of_512():
    network = MLP(20, 2, width=512, layers=4, dropout_rate=0.1, generator=torch.Generator())
    expected = (20 * 512 + 512) + 3 * (512 * 512 + 512) + (512 * 2 + 2)
    assert sum(p.numel() for p in network.parameters()) == expected


def test_starts_uniform_within_the_inverse_root_of_the_fan_in():
    for layer in [*make().hidden, make().output]:
        bound = 1 / math.sqrt(layer.in_features)
        assert layer.weight.abs().max() <= bound
        assert layer.bias.abs().max() <= bound
        # A uniform variable's standard deviation is bound / sqrt(3); 128 weights or more give it within 15 %.
        assert layer.weight.std().item() == pytest.approx(bound / math.sqrt(3), rel=0.15)


def test_initial_weights_come_from_the_generator_alone():
    torch.manual_seed(1)
    first = make(seed=3).output.weight
    torch.manual_seed(2)
    assert torch.equal(first, make(seed=3).output.weight)
    assert not torch.equal(first, make(seed=4).output.weight)


def test_dropout_is_on_only_with_a_generator():
    network, x = make(dropout_rate=0.5), torch.ones(4, 6)
    assert torch.equal(network(x), network(x))
    assert torch.equal(network(x, torch.Generator().manual_seed(0)), network(x, torch.Generator().manual_seed(0)))
    assert not torch.equal(network(x), network(x, torch.Generator().manual_seed(0)))


def test_dropout_keeps_the_mean_and_drops_at_its_rate():
    x = torch.ones(100_000)
    y = dropout(x, 0.3, torch.Generator().manual_seed(0))
    dropped = (y == 0).float().mean().item()
    assert dropped == pytest.approx(0.3, abs=4 * math.sqrt(0.3 * 0.7 / len(x)))  # four standard errors
    assert torch.allclose(y[y != 0], torch.tensor(1 / 0.7))
    assert torch.equal(dropout(x, 0.0, torch.Generator()), x)
