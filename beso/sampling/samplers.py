"""Samplers: from noise at sigmas[0] to an action at sigmas[-1].

    sample_x(denoise, a, sigmas, noise) -> a

`denoise(a, sigma)` is the denoiser D with state and goal bound, `a` a sample at noise level sigmas[0], `sigmas` falling
floats (usually ending in 0), `noise()` standard normal numbers of a's shape for the samplers that inject noise. With
t = -ln(sigma), the probability-flow ODE (paper, Eq. 3) is da/dsigma = d = (a - D) / sigma. A step to sigma = 0 is a
first-order one for every sampler and returns D.

The paper's algorithms 2 and 3 are misprinted; what stands here is right:
- Algorithm 2 (DDIM): h must be beta(t_{i+1}) - beta(t_i), the factor (e^{-h} - 1) multiplies D and not d, and the
  inverse of beta(t) = -ln(t) is e^{-beta}.
- Algorithm 3 (ancestral step): the sign under both roots is reversed; t_down = sqrt(t_to^2 - t_up^2).
- Algorithm 4 (Euler) is right and is the corrected algorithm 2: `ddim` and `euler` agree to rounding.
- The appendix swaps the two solvers: DPM++(2S) makes two calls a step, DPM++(2M) one.
"""

import itertools
import math
from collections.abc import Callable, Sequence

from torch import Tensor

Denoise = Callable[[Tensor, float], Tensor]
Noise = Callable[[], Tensor]
Sampler = Callable[[Denoise, Tensor, Sequence[float], Noise], Tensor]


def _slope(a: Tensor, sigma: float, denoised: Tensor) -> Tensor:
    return (a - denoised) / sigma


def _exponential_step(a: Tensor, denoised: Tensor, sigma: float, to: float) -> Tensor:
    """The exact solution of the ODE for a constant denoiser: (sigma'/sigma) a + (1 - sigma'/sigma) D."""
    return (to / sigma) * a + (1 - to / sigma) * denoised


def _ancestral(sigma: float, to: float) -> tuple[float, float]:
    """Split a step into a deterministic one to `down` and noise of std `up` (paper, Alg. 3, corrected; eta = 1)."""
    up = min(to, math.sqrt(to**2 * (sigma**2 - to**2) / sigma**2))
    return math.sqrt(to**2 - up**2), up


def sample_euler(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """Euler's method (paper, Alg. 4; Karras et al. 2022, Alg. 1 without correction). Order 1, n calls."""
    for sigma, to in itertools.pairwise(sigmas):
        a = a + (to - sigma) * _slope(a, sigma, denoise(a, sigma))
    return a


def sample_euler_ancestral(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """Euler with ancestral noise (paper, Alg. 5; Song et al. 2021). Stochastic, n calls."""
    for sigma, to in itertools.pairwise(sigmas):
        down, up = _ancestral(sigma, to)
        a = a + (down - sigma) * _slope(a, sigma, denoise(a, sigma))
        if to > 0:
            a = a + up * noise()
    return a


def sample_ddim(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """DDIM, which is DPM-Solver-1 (paper, Alg. 2, corrected; Song et al. 2021; Lu et al. 2022). Order 1, n calls."""
    for sigma, to in itertools.pairwise(sigmas):
        a = _exponential_step(a, denoise(a, sigma), sigma, to)
    return a


def sample_heun(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """Heun's method (Karras et al. 2022, Alg. 1 without churn). Order 2, 2n - 1 calls when sigmas end in 0."""
    for sigma, to in itertools.pairwise(sigmas):
        slope = _slope(a, sigma, denoise(a, sigma))
        predicted = a + (to - sigma) * slope
        if to == 0:
            a = predicted
        else:
            a = a + (to - sigma) * (slope + _slope(predicted, to, denoise(predicted, to))) / 2
    return a


def _dpm_2_step(denoise: Denoise, a: Tensor, sigma: float, to: float) -> Tensor:
    slope = _slope(a, sigma, denoise(a, sigma))
    if to == 0:
        return a + (to - sigma) * slope
    middle = math.sqrt(sigma * to)
    at_middle = a + (middle - sigma) * slope
    return a + (to - sigma) * _slope(at_middle, middle, denoise(at_middle, middle))


def sample_dpm_2(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """The midpoint method in ln(sigma) (DPM-Solver-2, Lu et al. 2022). Order 2, 2n - 1 calls when sigmas end in 0."""
    for sigma, to in itertools.pairwise(sigmas):
        a = _dpm_2_step(denoise, a, sigma, to)
    return a


def sample_dpm_2_ancestral(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """DPM-Solver-2 with ancestral noise. Stochastic, 2n - 1 calls when sigmas end in 0."""
    for sigma, to in itertools.pairwise(sigmas):
        down, up = _ancestral(sigma, to)
        a = _dpm_2_step(denoise, a, sigma, down)
        if to > 0:
            a = a + up * noise()
    return a


def _dpmpp_2s_step(denoise: Denoise, a: Tensor, sigma: float, to: float) -> Tensor:
    denoised = denoise(a, sigma)
    if to == 0:
        return denoised
    middle = math.sqrt(sigma * to)
    at_middle = _exponential_step(a, denoised, sigma, middle)
    return _exponential_step(a, denoise(at_middle, middle), sigma, to)


def sample_dpmpp_2s(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """DPM-Solver++(2S) (Lu et al. 2022b, Alg. 1, r = 1/2). Order 2, 2n - 1 calls when sigmas end in 0."""
    for sigma, to in itertools.pairwise(sigmas):
        a = _dpmpp_2s_step(denoise, a, sigma, to)
    return a


def sample_dpmpp_2s_ancestral(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """DPM-Solver++(2S) with ancestral noise. Stochastic, 2n - 1 calls when sigmas end in 0."""
    for sigma, to in itertools.pairwise(sigmas):
        down, up = _ancestral(sigma, to)
        a = _dpmpp_2s_step(denoise, a, sigma, down)
        if to > 0:
            a = a + up * noise()
    return a


def sample_dpmpp_2m(denoise: Denoise, a: Tensor, sigmas: Sequence[float], noise: Noise) -> Tensor:
    """DPM-Solver++(2M) (Lu et al. 2022b, Alg. 2). Order 2, n calls: the last call's result is reused."""
    previous: Tensor | None = None
    previous_stride = 0.0
    for sigma, to in itertools.pairwise(sigmas):
        denoised = denoise(a, sigma)
        if to == 0:
            return denoised
        stride = math.log(sigma / to)
        extrapolated = denoised
        if previous is not None:
            ratio = previous_stride / stride
            extrapolated = (1 + 1 / (2 * ratio)) * denoised - 1 / (2 * ratio) * previous
        a = _exponential_step(a, extrapolated, sigma, to)
        previous, previous_stride = denoised, stride
    return a


SAMPLERS: dict[str, Sampler] = {
    "euler": sample_euler,
    "euler_ancestral": sample_euler_ancestral,
    "heun": sample_heun,
    "ddim": sample_ddim,
    "dpm_2": sample_dpm_2,
    "dpm_2_ancestral": sample_dpm_2_ancestral,
    "dpmpp_2s": sample_dpmpp_2s,
    "dpmpp_2s_ancestral": sample_dpmpp_2s_ancestral,
    "dpmpp_2m": sample_dpmpp_2m,
}
