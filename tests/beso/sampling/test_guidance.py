import pytest
import torch

from beso.sampling.guidance import classifier_free

B, T, A = 3, 2, 2


@pytest.fixture
def goals():
    goal = torch.randn(B, 1, A, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    return torch.cat([goal, torch.zeros_like(goal)])


@pytest.fixture
def a():
    return torch.randn(B, T, A, generator=torch.Generator().manual_seed(1), dtype=torch.float64)


def with_goals(goals, a, sigma):
    return torch.tanh(a) * sigma + goals * a.square() + goals


@pytest.mark.parametrize("scale", [0.0, 0.5, 1.0, 1.25, 2.0])
def test_mixes_the_two_branches_with_the_papers_weights(goals, a, scale):
    guided = classifier_free(lambda x, sigma: with_goals(goals, x, sigma), scale)(a, 0.3)
    conditional, unconditional = with_goals(goals[:B], a, 0.3), with_goals(goals[B:], a, 0.3)
    assert torch.allclose(guided, scale * conditional + (1 - scale) * unconditional, atol=1e-14)


@pytest.mark.parametrize(("scale", "half"), [(1.0, slice(0, B)), (0.0, slice(B, 2 * B))])
def test_scale_one_follows_the_goal_and_scale_zero_ignores_it(goals, a, scale, half):
    guided = classifier_free(lambda x, sigma: with_goals(goals, x, sigma), scale)(a, 0.3)
    assert torch.allclose(guided, with_goals(goals[half], a, 0.3), atol=1e-15)


def test_mixing_denoisers_is_mixing_scores(goals, a):
    sigma, scale = 0.3, 2.0

    def score(denoised):
        return (denoised - a) / sigma**2

    guided = classifier_free(lambda x, s: with_goals(goals, x, s), scale)(a, sigma)
    conditional, unconditional = with_goals(goals[:B], a, sigma), with_goals(goals[B:], a, sigma)
    assert torch.allclose(score(guided), scale * score(conditional) + (1 - scale) * score(unconditional))


def test_costs_one_network_call_on_twice_the_batch(goals, a):
    batches = []

    def counted(x, sigma):
        batches.append(len(x))
        return with_goals(goals, x, sigma)

    classifier_free(counted, 2.0)(a, 0.3)
    assert batches == [2 * B]
