import itertools

import pytest
import torch

from beso.core.noise import BatchNoise
from beso.methods import lmp
from beso.networks import logistic_mixture
from tests.beso.methods import SIZES, batch

CONFIG = {
    "window": 4,
    "plan": 3,
    "recognition_width": 8,
    "recognition_layers": 1,
    "recognition_heads": 2,
    "recognition_dropout": 0.0,
    "prior_width": 16,
    "prior_layers": 2,
    "decoder_width": 16,
    "decoder_layers": 2,
    "decoder_dropout": 0.0,
    "mixtures": 3,
    "classes": 16,
    "kl_beta": 0.01,
}


def make(replan=3, **changes):
    config = lmp.Config(**{**CONFIG, **changes})
    return lmp.Method(config, lmp.Sampling(replan), SIZES, torch.Generator().manual_seed(0)).eval()


def gaussians(seed):
    draws = torch.Generator().manual_seed(seed)
    return lmp.Gaussian(torch.randn(5, 3, generator=draws), torch.rand(5, 3, generator=draws) + 0.2)


def test_kl_divergence_is_torchs():
    q, p = gaussians(0), gaussians(1)
    expected = torch.distributions.kl_divergence(torch.distributions.Normal(*q), torch.distributions.Normal(*p)).sum(-1)
    assert torch.allclose(lmp.kl_divergence(q, p), expected, atol=1e-5)


def test_balancing_moves_the_prior_with_most_of_the_gradient():
    def gradients(loss):
        q, p = (lmp.Gaussian(*(part.clone().requires_grad_() for part in gaussians(seed))) for seed in (0, 1))
        value = loss(q, p)
        value.backward()
        return value.item(), [part.grad for part in (*q, *p)]

    plain, whole = gradients(lambda q, p: lmp.kl_divergence(q, p).mean())
    balanced, shared = gradients(lmp.balanced_kl)
    assert balanced == pytest.approx(plain, rel=1e-5)
    for share, expected, got in zip([0.2, 0.2, 0.8, 0.8], whole, shared, strict=True):
        assert torch.allclose(got, share * expected, atol=1e-6)


def test_plan_and_decoder_state_last_until_the_next_plan():
    method, memory, goal = make(replan=3), {}, batch(2, 1).goal
    noise, plans = BatchNoise(2, torch.Generator().manual_seed(0)), []
    with torch.no_grad():
        for i in range(7):
            state = batch(2, 1, seed=i).observations
            before = memory.get("hidden")
            method.act(state, torch.zeros(2, 0, 2), goal, noise, memory)
            plans.append(memory["plan"])
            start = None if i % 3 == 0 else before
            _, hidden = method._decode(state, plans[-1], goal, start)
            assert torch.allclose(memory["hidden"], hidden, atol=1e-6)
    assert [torch.equal(a, b) for a, b in itertools.pairwise(plans)] == [True, True, False, True, True, False]


def test_the_decoder_in_single_steps_is_the_decoder_over_a_window():
    method, data = make(), batch(2, 4)
    plan = torch.randn(2, 3, generator=torch.Generator().manual_seed(0))
    with torch.no_grad():
        whole, _ = method._decode(data.observations, plan, data.goal)
        hidden = None
        for t in range(4):
            one, hidden = method._decode(data.observations[:, t : t + 1], plan, data.goal, hidden)
            for of_step, of_window in zip(one, whole, strict=True):
                assert torch.allclose(of_step[:, 0], of_window[:, t], atol=1e-5)


def test_the_loss_is_likelihood_and_balanced_divergence():
    method, data = make(kl_beta=0.5), batch(6, 4)
    eps = torch.randn(6, 3, generator=torch.Generator().manual_seed(2))
    with torch.no_grad():
        recognised = torch.stack([method.recognition(data.observations)[:, t] for t in range(4)]).sum(0) / 4
        mean, std = recognised[:, :3], torch.nn.functional.softplus(recognised[:, 3:]) + 0.1
        prior = method.prior(torch.cat([data.observations[:, 0], data.goal[:, 0]], dim=1))
        prior_mean, prior_std = prior[:, :3], torch.nn.functional.softplus(prior[:, 3:]) + 0.1
        mixture, _ = method._decode(data.observations, mean + std * eps, data.goal)
        of_entries = logistic_mixture.negative_log_likelihood(mixture, data.actions, 16)
        distributions = torch.distributions.Normal(mean, std), torch.distributions.Normal(prior_mean, prior_std)
        divergence = torch.distributions.kl_divergence(*distributions).sum() / 6
        expected = of_entries.sum() / (6 * 4) + 0.5 * divergence
        loss = method.loss(data, torch.Generator().manual_seed(2))
    assert loss.item() == pytest.approx(expected.item(), rel=1e-4)


@pytest.mark.parametrize("kl_beta", [0.0, 0.01])
def test_the_likelihood_teaches_recognition_and_only_the_divergence_the_prior(kl_beta):
    method, data = make(kl_beta=kl_beta), batch(6, 4)
    method.loss(data, torch.Generator().manual_seed(0)).backward()
    for part, learns in ((method.recognition, True), (method.prior, kl_beta > 0), (method.decoder, True)):
        gradients = [p.grad for p in part.parameters() if p.grad is not None]
        assert any((gradient != 0).any() for gradient in gradients) == learns


@pytest.mark.parametrize("changes", [{"recognition_heads": 3}, {"classes": 1}, {"kl_beta": -1.0}, {"window": 0}])
def test_impossible_sizes_are_refused(changes):
    with pytest.raises(ValueError, match="must"):
        lmp.Config(**{**CONFIG, **changes})
