"""Discretised mixture of logistics (Salimans et al. 2017, PixelCNN++), for numbers in [-1, 1].

A number's class is the interval of width 2 / (K - 1) around it; at the ends, -1 and 1, it reaches to infinity. So the
probabilities of K evenly spaced numbers from -1 to 1 sum to 1. Numbers in between are not rounded (as in HULC): with
few classes that would cost precision.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from beso.core.noise import categorical

SMALLEST_LOG_SCALE = -7.0
AT_END = 1e-3  # so near to -1 or 1 a number counts as there (HULC)


class LogisticMixture(NamedTuple):
    """Parameters of independent mixtures, each (..., A, M) for A numbers and M components."""

    logits: Tensor
    means: Tensor
    log_scales: Tensor


def from_outputs(outputs: Tensor, mixtures: int) -> LogisticMixture:
    """(..., A * M * 3) outputs of a network -> the mixtures of A numbers."""
    logits, means, log_scales = outputs.unflatten(-1, (-1, mixtures, 3)).unbind(-1)
    return LogisticMixture(logits, means, log_scales.clamp(min=SMALLEST_LOG_SCALE))


def negative_log_likelihood(mixture: LogisticMixture, x: Tensor, classes: int) -> Tensor:
    """Minus the log probability of the class of each number.

    Args:
        x: (..., A); what lies outside [-1, 1] counts as the end.
        classes: K.

    Returns:
        (..., A).
    """
    half = 1 / (classes - 1)
    x, inverse_scale = x.clamp(-1, 1)[..., None], (-mixture.log_scales).exp()
    upper = inverse_scale * (x + half - mixture.means)
    lower = inverse_scale * (x - half - mixture.means)
    # sigmoid(u) - sigmoid(l) = sigmoid(u) sigmoid(-l) (1 - e^(l-u)), which neither cancels nor overflows
    width = 2 * half * inverse_scale
    inside = functional.logsigmoid(upper) + functional.logsigmoid(-lower) + torch.log(-torch.expm1(-width))
    log_probability = torch.where(x > 1 - AT_END, functional.logsigmoid(-lower), inside)
    log_probability = torch.where(x < -1 + AT_END, functional.logsigmoid(upper), log_probability)
    return -torch.logsumexp(mixture.logits.log_softmax(dim=-1) + log_probability, dim=-1)


def sample(mixture: LogisticMixture, uniform: Tensor) -> Tensor:
    """Draw from the continuous mixture, clipped to [-1, 1].

    Args:
        uniform: (..., A, 2) numbers in [0, 1): the first picks a component, the second a place in it.

    Returns:
        (..., A).
    """
    component = categorical(mixture.logits.softmax(dim=-1), uniform[..., :1])
    mean = mixture.means.gather(-1, component).squeeze(-1)
    scale = mixture.log_scales.gather(-1, component).squeeze(-1).exp()
    place = uniform[..., 1].clamp(1e-5, 1 - 1e-5)
    return (mean + scale * (place.log() - torch.log1p(-place))).clamp(-1, 1)
