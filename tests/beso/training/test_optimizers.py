import math

import pytest
import torch
from torch import nn

from beso.networks.transformer import ScoreTransformer, TransformerConfig
from beso.training.optimizers import MOMENTUM, RMS, Muon, make, orthogonalise


def random(*shape, seed=0):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("shape", [(4, 48, 48), (2, 64, 192), (3, 256, 64)])
def test_orthogonalise_brings_singular_values_near_one(shape):
    values = torch.linalg.svdvals(orthogonalise(random(*shape)))
    assert values.max() < 1.3
    # Five steps of the published coefficients lift a value of 0.01 of the norm into the band; square matrices have a
    # few smaller ones.
    assert values.quantile(0.05) > 0.6


@pytest.mark.parametrize("shape", [(24, 24), (16, 40), (40, 16)])
def test_orthogonalise_keeps_the_singular_vectors(shape):
    rank = min(shape)
    left, right = (torch.linalg.qr(random(n, rank, seed=n)).Q for n in shape)
    values = torch.linspace(0.5, 3, rank)
    result = orthogonalise((left * values @ right.mT)[None])[0]
    core = left.mT @ result @ right
    off_diagonal = core - torch.diag(core.diagonal())
    assert off_diagonal.abs().max() < 1e-4
    assert core.diagonal().min() > 0.6
    assert core.diagonal().max() < 1.3
    assert torch.allclose(left @ core @ right.mT, result, atol=1e-4), "nothing outside of the two spans"


def test_orthogonalise_ignores_the_scale():
    x = random(1, 20, 30)
    assert torch.allclose(orthogonalise(x), orthogonalise(1e3 * x), atol=1e-4)


def test_orthogonalise_of_nothing_is_nothing():
    assert torch.equal(orthogonalise(torch.zeros(1, 8, 8)), torch.zeros(1, 8, 8))


def test_first_update_of_muon_in_plain_numbers():
    parameter = nn.Parameter(random(40, 60))
    before, parameter.grad = parameter.detach().clone(), random(40, 60, seed=1)
    Muon([parameter], lr=0.1, weight_decay=0.5).step()
    momentum = (1 - MOMENTUM) * parameter.grad
    nesterov = (1 - MOMENTUM) * parameter.grad + MOMENTUM * momentum
    update = orthogonalise(nesterov[None])[0]
    expected = before * (1 - 0.1 * 0.5) - 0.1 * RMS * math.sqrt(60) * update
    assert torch.allclose(parameter, expected, atol=1e-6)


def test_updates_of_muon_are_of_adamws_size():
    """RMS 0.2 an element, so that one learning rate serves both; exact when all singular values are 1."""
    for shape in ((64, 64), (64, 256), (256, 64)):
        parameter = nn.Parameter(torch.zeros(shape))
        parameter.grad = random(*shape)
        Muon([parameter], lr=1.0, weight_decay=0.0).step()
        assert parameter.square().mean().sqrt().item() == pytest.approx(RMS, rel=0.25)


def test_matrices_of_one_shape_do_not_mix():
    together = [nn.Parameter(random(32, 48, seed=i)) for i in range(3)]
    alone = [nn.Parameter(p.detach().clone()) for p in together]
    optimizers = [Muon(together, 0.1, 0.0)] + [Muon([p], 0.1, 0.0) for p in alone]
    for step in range(3):
        for i, (p, q) in enumerate(zip(together, alone, strict=True)):
            p.grad = random(32, 48, seed=10 * step + i)
            q.grad = p.grad.clone()
        for optimizer in optimizers:
            optimizer.step()
    assert all(torch.allclose(p, q, atol=1e-5) for p, q in zip(together, alone, strict=True))


def test_muon_skips_parameters_without_a_gradient():
    used, unused = nn.Parameter(random(32, 32)), nn.Parameter(random(32, 32))
    before = unused.detach().clone()
    used.grad = random(32, 32, seed=1)
    Muon([used, unused], 0.1, 0.0).step()
    assert torch.equal(unused, before)


def transformer(width):
    config = TransformerConfig(width, 2, 2, 5, 0.0, 0.0, "sequential")
    return ScoreTransformer(config, 10, 2, 1, torch.Generator().manual_seed(0))


def test_muon_takes_the_hidden_matrices_and_adamw_the_rest():
    network = transformer(64)
    muon, adamw = make("muon", network.parameters(), 1e-3, 0.01)
    names = {id(p): name for name, p in network.named_parameters()}
    taken = [{names[id(p)] for group in o.param_groups for p in group["params"]} for o in (muon, adamw)]
    hidden = ("attention.query_key_value", "attention.output", "expand", "contract")
    assert taken[0] == {f"blocks.{i}.{name}.weight" for i in range(2) for name in hidden}
    assert taken[0] | taken[1] == set(names.values())
    assert not taken[0] & taken[1]
    assert all(group["weight_decay"] == 0.01 for o in (muon, adamw) for group in o.param_groups)


def test_muon_works_for_networks_without_hidden_matrices():
    network = transformer(16)  # narrower than SMALLEST_HIDDEN
    assert make("muon", network.parameters(), 1e-3, 0.0)


@pytest.mark.parametrize("name", ["adam", "adamw"])
def test_adam_is_torchs_own(name):
    """The first update of Adam is lr * sign(gradient); AdamW also shrinks the weight."""
    parameter = nn.Parameter(torch.tensor([2.0, -3.0]))
    parameter.grad = torch.tensor([0.5, -0.1])
    (optimizer,) = make(name, [parameter], 0.01, 0.0 if name == "adam" else 0.1)
    optimizer.step()
    start = torch.tensor([2.0, -3.0]) * (1 if name == "adam" else 1 - 0.01 * 0.1)
    assert torch.allclose(parameter, start - 0.01 * torch.tensor([1.0, -1.0]), atol=1e-6)


@pytest.mark.parametrize("name", ["adam", "adamw", "muon"])
def test_every_optimizer_solves_least_squares(name):
    target = random(40, 36, seed=1) / 6
    layer = nn.Linear(36, 40)
    with torch.no_grad():
        layer.weight.zero_()
        layer.bias.zero_()
    optimizers = make(name, layer.parameters(), 0.02, 0.0)
    inputs = random(200, 36, seed=2)
    losses = []
    for step in range(150):
        for optimizer in optimizers:
            for group in optimizer.param_groups:
                group["lr"] = 0.02 * (1 - step / 150)
        loss = (layer(inputs) - inputs @ target.T).square().mean()
        losses.append(loss.item())
        loss.backward()
        for optimizer in optimizers:
            optimizer.step()
        layer.zero_grad()
    assert losses[-1] < 1e-2 * losses[0]
