"""Samplers against distributions whose denoiser is known in closed form."""

import math

import pytest
import torch

from beso.sampling.samplers import SAMPLERS
from beso.sampling.schedules import SCHEDULES

MEAN, STD = 0.3, 0.4
ORDERS = {"euler": 1, "ddim": 1, "heun": 2, "dpm_2": 2, "dpmpp_2s": 2, "dpmpp_2m": 2}
ANCESTRAL = ["euler_ancestral", "dpm_2_ancestral", "dpmpp_2s_ancestral"]
ONE_CALL = {"euler", "euler_ancestral", "ddim", "dpmpp_2m"}


def gaussian(a, sigma):
    """E[clean | noisy] for data N(MEAN, STD^2)."""
    return MEAN + (a - MEAN) * STD**2 / (STD**2 + sigma**2)


def mixture(a, sigma):
    """E[clean | noisy] for data 0.7 N(-0.5, 0.2^2) + 0.3 N(0.5, 0.2^2)."""
    modes = a.new_tensor([-0.5, 0.5])
    variance = 0.2**2 + sigma**2
    distance = a[..., None] - modes
    weights = torch.softmax(a.new_tensor([0.7, 0.3]).log() - distance**2 / (2 * variance), dim=-1)
    return (weights * (modes + distance * 0.2**2 / variance)).sum(-1)


def no_noise():
    raise AssertionError("a deterministic sampler asked for noise")


def falling(steps, sigma_min=0.05, sigma_max=1.0, schedule="karras"):
    """`steps` solver steps from sigma_max to sigma_min, without the schedule's final 0."""
    return SCHEDULES[schedule](steps + 1, sigma_min, sigma_max).tolist()[:-1]


def errors(name, denoise, start, exact, counts):
    sampler = SAMPLERS[name]
    return [(sampler(denoise, start, falling(n), no_noise) - exact).abs().max().item() for n in counts]


def test_every_sampler_is_covered_here():
    assert set(ORDERS) | set(ANCESTRAL) == set(SAMPLERS)


@pytest.mark.parametrize(("name", "order"), ORDERS.items())
def test_converges_to_the_exact_solution_on_a_gaussian_at_its_order(name, order):
    start = torch.linspace(-2, 2, 9, dtype=torch.float64)
    exact = MEAN + (start - MEAN) * math.sqrt((STD**2 + 0.05**2) / (STD**2 + 1))
    coarse, fine = errors(name, gaussian, start, exact, [64, 128])
    assert fine < (0.02 if order == 1 else 3e-4)
    # The next term of the error's expansion moves the measured order by about 1/n.
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.1)


def reference_solution(denoise, a, sigma_max, sigma_min, steps=1000):
    """Classical Runge-Kutta of fourth order in x = ln(sigma), where da/dx = a - D."""
    x, h = math.log(sigma_max), (math.log(sigma_min) - math.log(sigma_max)) / steps

    def slope(a, x):
        return a - denoise(a, math.exp(x))

    for _ in range(steps):
        k1 = slope(a, x)
        k2 = slope(a + h / 2 * k1, x + h / 2)
        k3 = slope(a + h / 2 * k2, x + h / 2)
        k4 = slope(a + h * k3, x + h)
        a, x = a + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), x + h
    return a


@pytest.mark.parametrize(("name", "order"), ORDERS.items())
def test_converges_on_a_two_mode_mixture_at_its_order(name, order):
    start = torch.linspace(-1.5, 1.5, 11, dtype=torch.float64)
    exact = reference_solution(mixture, start, 1.0, 0.05)
    coarse, fine = errors(name, mixture, start, exact, [128, 256])
    assert fine < (0.05 if order == 1 else 2e-3)
    # The maximum over the starts sits where the modes part, the slowest place to become asymptotic.
    assert math.log2(coarse / fine) == pytest.approx(order, abs=0.25)


def test_reference_solution_is_exact_on_a_gaussian():
    start = torch.linspace(-2, 2, 9, dtype=torch.float64)
    exact = MEAN + (start - MEAN) * math.sqrt((STD**2 + 0.05**2) / (STD**2 + 1))
    assert torch.allclose(reference_solution(gaussian, start, 1.0, 0.05), exact, atol=1e-11)


@pytest.mark.parametrize("name", ANCESTRAL)
def test_ancestral_samples_have_the_mean_and_variance_of_the_data(name):
    count, generator = 40_000, torch.Generator().manual_seed(0)

    def draw():
        return torch.randn(count, generator=generator, dtype=torch.float64)

    start = MEAN + math.sqrt(STD**2 + 1) * draw()  # the exact distribution at sigma = 1
    samples = SAMPLERS[name](gaussian, start, falling(250, 0.01), draw)
    mean_error, variance = STD / math.sqrt(count), STD**2 + 0.01**2
    # Four standard errors; for the variance also the discretisation error, which the next test bounds by 2 %.
    assert samples.mean().item() == pytest.approx(MEAN, abs=4 * mean_error)
    assert samples.var().item() == pytest.approx(variance, rel=4 * math.sqrt(2 / count) + 0.02)


def exact_moments(name, steps):
    """Mean and variance of a sampler's result on the Gaussian, without sampling.

    Every sampler is affine there, so a result is coefficients on (1, z_0, z_1, ...) with independent standard normal z.
    """
    state = torch.zeros(steps + 2, dtype=torch.float64)
    one = torch.eye(steps + 2, dtype=torch.float64)
    fresh = iter(one[2:])

    def denoise(a, sigma):
        shift = MEAN * one[0]
        return shift + (a - shift) * STD**2 / (STD**2 + sigma**2)

    state[0], state[1] = MEAN, math.sqrt(STD**2 + 1)
    result = SAMPLERS[name](denoise, state, falling(steps, 0.01), lambda: next(fresh))
    assert next(fresh, None) is None, "noise is drawn once a step"
    return result[0].item(), result[1:].square().sum().item()


@pytest.mark.parametrize("name", ANCESTRAL)
def test_variance_of_an_ancestral_sampler_converges_to_the_data_variance(name):
    gaps = []
    for steps in (100, 200, 400):
        mean, variance = exact_moments(name, steps)
        assert mean == pytest.approx(MEAN, abs=1e-12)
        gaps.append(abs(variance / (STD**2 + 0.01**2) - 1))
    assert gaps[1] < 0.02
    assert gaps[0] > 1.8 * gaps[1] > 1.8**2 * gaps[2]


def nonlinear(a, sigma):
    return torch.sin(3 * a) + sigma * torch.cos(a.flip(-1))


@pytest.mark.parametrize("steps", [1, 3, 10])
def test_ddim_equals_euler_on_any_denoiser(steps):
    start = torch.randn(5, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    sigmas = SCHEDULES["exponential"](steps, 0.005, 1.0).tolist()
    ddim, euler = (SAMPLERS[name](nonlinear, start, sigmas, no_noise) for name in ("ddim", "euler"))
    assert torch.allclose(ddim, euler, atol=1e-13, rtol=0)


@pytest.mark.parametrize("steps", [3, 5, 10])
@pytest.mark.parametrize("name", SAMPLERS)
def test_number_of_network_calls(name, steps):
    """Measured in the published implementations: n calls, or 2n - 1 with a first-order step to 0."""
    levels = []

    def counted(a, sigma):
        levels.append(sigma)
        return gaussian(a, sigma)

    SAMPLERS[name](counted, torch.zeros(1), SCHEDULES["karras"](steps, 0.005, 1.0).tolist(), lambda: torch.ones(1))
    assert len(levels) == (steps if name in ONE_CALL else 2 * steps - 1)
    assert min(levels) > 0, "a denoiser is undefined at sigma = 0"


@pytest.mark.parametrize("name", SAMPLERS)
def test_a_step_to_zero_returns_the_denoised_action(name):
    start = torch.tensor([[0.4, -0.7]], dtype=torch.float64)
    result = SAMPLERS[name](nonlinear, start, [0.3, 0.0], lambda: torch.full((1, 2), math.nan))
    assert torch.allclose(result, nonlinear(start, 0.3), atol=1e-14)


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("name", SAMPLERS)
def test_ten_steps_of_every_schedule_end_near_the_data(name, schedule):
    generator = torch.Generator().manual_seed(0)
    sigmas = SCHEDULES[schedule](10, 0.005, 1.0).tolist()

    def draw():
        return torch.randn(1000, generator=generator)

    samples = SAMPLERS[name](gaussian, MEAN + math.sqrt(STD**2 + 1) * draw(), sigmas, draw)
    # The mean of 1000 samples of this Gaussian has a standard error of 0.013; the largest lies about 3.3 STD out.
    assert samples.mean().item() == pytest.approx(MEAN, abs=0.07)
    assert (samples - MEAN).abs().max() < 6 * STD


def test_tensors_given_to_a_sampler_are_left_as_they_were():
    start = torch.tensor([[0.4, -0.7]])
    kept = start.clone()
    for sampler in SAMPLERS.values():
        sampler(nonlinear, start, [1.0, 0.2, 0.05, 0.0], lambda: torch.ones(1, 2))
    assert torch.equal(start, kept)
