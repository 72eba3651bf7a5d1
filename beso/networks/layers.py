"""Small parts shared by the networks."""

import math

import torch
from torch import Tensor, nn


def dropout(x: Tensor, rate: float, generator: torch.Generator | None) -> Tensor:
    """Dropout that draws from a given generator and does nothing without one.

    Four decisions come from one 64-bit draw, which on a CPU is several times faster than a Bernoulli draw each; the
    rate is rounded to a multiple of 2^-16.

    Args:
        x: of any shape.
        rate: share of x that becomes 0.
    """
    if generator is None or rate == 0:
        return x
    dropped = round(rate * 2**16)
    draws = torch.empty(math.ceil(x.numel() / 4), dtype=torch.int64, device=x.device)
    draws.random_(-(2**63), None, generator=generator)  # every 64-bit pattern
    keep = draws.view(torch.int16)[: x.numel()].view_as(x) >= dropped - 2**15
    return x * keep.to(x.dtype).mul_(2**16 / (2**16 - dropped))


def initialise_normal(module: nn.Module, generator: torch.Generator, std: float = 0.02) -> None:
    """GPT-2's start: weights and tables N(0, std^2), biases 0, layer norms 1 and 0."""
    norms = {id(p) for m in module.modules() if isinstance(m, nn.LayerNorm) for p in m.parameters()}
    with torch.no_grad():
        for name, parameter in module.named_parameters():
            if id(parameter) in norms:
                parameter.fill_(1.0 if name.endswith("weight") else 0.0)
            elif name.endswith("bias"):
                parameter.zero_()
            else:
                parameter.normal_(0, std, generator=generator)
