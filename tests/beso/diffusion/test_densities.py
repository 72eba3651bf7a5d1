import math

import pytest
import torch

from beso.diffusion.densities import DENSITIES

LOCATION, SCALE = math.log(0.5), 0.5


def logistic_cdf(x):
    return 1 / (1 + math.exp(-x))


def normal_cdf(x):
    return (1 + math.erf(x / math.sqrt(2))) / 2


def distribution(name, sigma, low, high):
    """The truncated distribution function, written down independently."""
    if name == "uniform":
        return (sigma - low) / (high - low)
    cdf = logistic_cdf if name == "log_logistic" else normal_cdf
    at = [cdf((math.log(x) - LOCATION) / SCALE) for x in (sigma, low, high)]
    return (at[0] - at[1]) / (at[2] - at[1])


def draw(name, uniform, low=0.005, high=1.0):
    return DENSITIES[name](uniform, low, high, LOCATION, SCALE)


def test_quantiles_of_the_published_log_logistic():
    """Measured by running the published code's sampling function on [0.005, 1], location ln 0.5, scale 0.5."""
    levels = torch.tensor([0.01, 0.1, 0.5, 0.9, 0.99], dtype=torch.float64)
    golden = torch.tensor([0.045, 0.147, 0.408, 0.801, 0.976], dtype=torch.float64)
    assert torch.allclose(draw("log_logistic", levels), golden, atol=1e-3, rtol=0)  # three digits, not rounded


def test_median_without_truncation_is_the_papers_alpha():
    median = DENSITIES["log_logistic"](torch.tensor([0.5]), 1e-9, 1e9, LOCATION, SCALE)
    assert median.item() == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize("limits", [(0.005, 1.0), (0.05, 1.0), (0.001, 40.0)])
@pytest.mark.parametrize("name", DENSITIES)
def test_is_the_inverse_of_the_distribution_function(name, limits):
    uniform = torch.linspace(1e-4, 1 - 1e-4, 201, dtype=torch.float64)
    sigmas = draw(name, uniform, *limits).tolist()
    for u, sigma in zip(uniform.tolist(), sigmas, strict=True):
        assert distribution(name, sigma, *limits) == pytest.approx(u, abs=1e-9)


@pytest.mark.parametrize("name", DENSITIES)
def test_random_draws_follow_the_distribution(name):
    count = 20_000
    uniform = torch.rand(count, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    sigmas = draw(name, uniform).sort().values
    expected = torch.tensor([distribution(name, s, 0.005, 1.0) for s in sigmas.tolist()], dtype=torch.float64)
    empirical = torch.arange(1, count + 1, dtype=torch.float64) / count
    # Kolmogorov-Smirnov: 1.95 / sqrt(n) is exceeded once in a thousand.
    assert (empirical - expected).abs().max() < 1.95 / math.sqrt(count)


@pytest.mark.parametrize("limits", [(0.005, 1.0), (0.05, 1.0), (1e-4, 80.0)])
@pytest.mark.parametrize("name", DENSITIES)
def test_stays_in_the_range_and_rises(name, limits):
    sigmas = draw(name, torch.linspace(1e-6, 1 - 1e-6, 1000), *limits)
    assert sigmas.dtype == torch.float64
    assert limits[0] <= sigmas.min()
    assert sigmas.max() <= limits[1]
    assert (sigmas.diff() > 0).all()


@pytest.mark.parametrize(
    "name",
    [
        "log_logistic",
        "log_normal",
        "uniform",
    ],
)
def test_stays_in_the_range_at_the_ends_of_the_unit_interval(name):
    """A uniform number in [0, 1) may be 0 or the float below 1."""
    sigmas = draw(name, torch.tensor([0.0, 1 - 2**-53], dtype=torch.float64), 1e-4, 80.0)
    assert sigmas[0].item() == pytest.approx(1e-4)
    assert 1e-4 < sigmas[1].item() <= 80.0 * (1 + 1e-9)
