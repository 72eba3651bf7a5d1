"""Discretised mixture of logistics (Salimans et al. 2017, PixelCNN++), for numbers in [-1, 1].

The line is cut into K classes of width 2 / (K - 1) around K evenly spaced centres from -1 to 1; the first and the last
reach to infinity, so that the classes' probabilities sum to 1.
"""

from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from beso.noise import categorical

SMALLEST_LOG_SCALE = -7.0


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
        x: (..., A), what lies outside [-1, 1] belongs to the outermost classes.
        classes: K.

    Returns:
        (..., A).
    """
    half = 1 / (classes - 1)
    centre = ((x.clamp(-1, 1) + 1) / (2 * half)).round() * 2 * half - 1
    inverse_scale = (-mixture.log_scales).exp()
    upper = inverse_scale * (centre[..., None] + half - mixture.means)
    lower = inverse_scale * (centre[..., None] - half - mixture.means)
    # sigmoid(u) - sigmoid(l) = sigmoid(u) sigmoid(-l) (1 - e^(l-u)), which neither cancels nor overflows
    width = 2 * half * inverse_scale
    inside = functional.logsigmoid(upper) + functional.logsigmoid(-lower) + torch.log(-torch.expm1(-width))
    first, last = centre[..., None] < -1 + half, centre[..., None] > 1 - half
    log_probability = torch.where(
        first, functional.logsigmoid(upper), torch.where(last, functional.logsigmoid(-lower), inside)
    )
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
