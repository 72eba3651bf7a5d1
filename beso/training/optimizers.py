"""Optimizers by name.

"adam" and "adamw" are the paper's. "muon" (Jordan et al. 2024) replaces the update of every hidden matrix by the
nearest orthogonal one and leaves the rest to AdamW. The small transformers of the CPU profiles need about a third of
AdamW's steps with it (docs/fidelity.md). torch.optim.Muon learns as well, but computes in bfloat16: as fast where the
processor has instructions for that, several times slower where it has none.
"""

import math
from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor, nn

MOMENTUM = 0.95
NEWTON_SCHULZ = (3.4445, -4.7750, 2.0315)  # Jordan et al.: steepest at 0, singular values end in about [0.7, 1.2]
NEWTON_SCHULZ_STEPS = 5
RMS = 0.2  # root mean square of AdamW's updates, matched so that one learning rate serves both (Liu et al. 2025)
SMALLEST_HIDDEN = 32  # matrices with a side below this map to or from states, actions or sigma


def make(
    name: str, parameters: Iterable[nn.Parameter], learning_rate: float, weight_decay: float
) -> list[torch.optim.Optimizer]:
    """The optimizers that together update all parameters.

    Args:
        name: "adam", "adamw" or "muon".
    """
    parameters = list(parameters)
    settings: dict[str, Any] = {"lr": learning_rate, "weight_decay": weight_decay}
    if name == "adam":
        return [torch.optim.Adam(parameters, fused=True, **settings)]
    if name == "adamw":
        return [torch.optim.AdamW(parameters, fused=True, **settings)]
    hidden = [p for p in parameters if p.ndim == 2 and min(p.shape) >= SMALLEST_HIDDEN]
    rest = [p for p in parameters if not any(p is h for h in hidden)]
    muon = [Muon(hidden, **settings)] if hidden else []  # a network this small has no hidden matrix
    return [*muon, torch.optim.AdamW(rest, fused=True, **settings)]


class Muon(torch.optim.Optimizer):
    """Momentum, orthogonalised by a Newton-Schulz iteration, for matrices.

    Matrices of one shape are orthogonalised in one batch. Weight decay is decoupled.
    """

    def __init__(self, parameters: list[nn.Parameter], lr: float, weight_decay: float) -> None:
        super().__init__(parameters, {"lr": lr, "weight_decay": weight_decay})

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """One update of every parameter with a gradient."""
        for group in self.param_groups:
            by_shape: dict[torch.Size, list[Tensor]] = {}
            for parameter in group["params"]:
                if parameter.grad is not None:
                    by_shape.setdefault(parameter.shape, []).append(parameter)
            for shape, parameters in by_shape.items():
                gradients = [p.grad for p in parameters if p.grad is not None]
                for p in parameters:
                    if not self.state[p]:
                        self.state[p]["momentum"] = torch.zeros_like(p)
                momenta = [self.state[p]["momentum"] for p in parameters]
                torch._foreach_lerp_(momenta, gradients, 1 - MOMENTUM)
                directions = torch._foreach_lerp(gradients, momenta, MOMENTUM)  # Nesterov
                updates = orthogonalise(torch.stack(directions))
                torch._foreach_mul_(parameters, 1 - group["lr"] * group["weight_decay"])
                scale = group["lr"] * RMS * math.sqrt(max(shape))
                torch._foreach_add_(parameters, list(updates.unbind()), alpha=-scale)


def orthogonalise(matrices: Tensor) -> Tensor:
    """(N, rows, columns) -> matrices with the same singular vectors and all singular values near 1."""
    a, b, c = NEWTON_SCHULZ
    x = matrices.mT if matrices.shape[-2] > matrices.shape[-1] else matrices
    x = x / (torch.linalg.matrix_norm(x, keepdim=True) + 1e-7)
    for _ in range(NEWTON_SCHULZ_STEPS):
        gram = x @ x.mT
        x = a * x + torch.baddbmm(b * gram, gram, gram, beta=1, alpha=c) @ x
    return x.mT if matrices.shape[-2] > matrices.shape[-1] else x
