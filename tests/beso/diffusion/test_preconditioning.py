import math

import pytest
import torch

from beso.diffusion.preconditioning import broadcast_to_actions, network_target, scales

SIGMA_DATA = 0.5
LEVELS = [0.005, 0.05, 0.5, 1.0, 40.0]


@pytest.mark.parametrize("sigma", LEVELS)
def test_network_input_and_target_have_unit_variance(sigma):
    count, generator = 100_000, torch.Generator().manual_seed(0)
    clean = SIGMA_DATA * torch.randn(count, generator=generator, dtype=torch.float64)
    noisy = clean + sigma * torch.randn(count, generator=generator, dtype=torch.float64)
    at = scales(torch.tensor(sigma, dtype=torch.float64), SIGMA_DATA)
    tolerance = 4 * math.sqrt(2 / count)  # four standard errors of a variance
    assert (at.into * noisy).var().item() == pytest.approx(1, abs=tolerance)
    assert network_target(clean, noisy, at).var().item() == pytest.approx(1, abs=tolerance)


@pytest.mark.parametrize("sigma", LEVELS)
def test_denoiser_returns_the_clean_action_when_the_network_hits_its_target(sigma):
    generator = torch.Generator().manual_seed(0)
    clean = torch.randn(4, 3, 2, generator=generator, dtype=torch.float64)
    noisy = clean + sigma * torch.randn(4, 3, 2, generator=generator, dtype=torch.float64)
    at = broadcast_to_actions(scales(torch.full((4,), sigma, dtype=torch.float64), SIGMA_DATA))
    assert torch.allclose(at.skip * noisy + at.out * network_target(clean, noisy, at), clean, atol=1e-12)


def test_values_of_the_papers_formulas():
    at = scales(torch.tensor([0.5, 1.0], dtype=torch.float64), SIGMA_DATA)
    assert torch.allclose(at.skip, torch.tensor([0.5, 0.2], dtype=torch.float64))
    assert torch.allclose(at.out, torch.tensor([0.5 / math.sqrt(2), 0.5 / math.sqrt(1.25)], dtype=torch.float64))
    assert torch.allclose(at.into, torch.tensor([math.sqrt(2), 1 / math.sqrt(1.25)], dtype=torch.float64))
    assert torch.allclose(at.noise, torch.tensor([math.log(0.5) / 4, 0.0], dtype=torch.float64))


def test_scales_multiply_the_samples_of_a_batch():
    sigma = torch.tensor([0.1, 1.0])
    wide = broadcast_to_actions(scales(sigma, SIGMA_DATA))
    assert all(value.shape == (2, 1, 1) for value in wide)
    assert torch.equal((wide.skip * torch.ones(2, 3, 4))[:, 1, 2], scales(sigma, SIGMA_DATA).skip)
