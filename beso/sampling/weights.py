"""Acting on a CPU with weights of half the size.

A call for one episode computes little with each weight, so it waits for memory, which gives half-size weights in half
the time. All sums are single precision. Weights that are half precision already, as an archive's are, give the same
actions to about 1e-6; others are rounded.
"""

from typing import Literal

import torch
from torch import Tensor, nn

from beso.config import require
from beso.errors import UserError

Weights = Literal["fp32", "fp16"]


class HalfLinear(nn.Module):
    """A linear layer with packed half-precision weights; its own stay, for networks that use a part of them."""

    def __init__(self, layer: nn.Linear) -> None:
        super().__init__()
        self.weight, self.bias = layer.weight, layer.bias
        self._packed = torch.ops.quantized.linear_prepack_fp16(layer.weight.detach(), layer.bias.detach())

    def forward(self, x: Tensor) -> Tensor:
        """(.., inputs) -> (.., outputs)."""
        return torch.ops.quantized.linear_dynamic_fp16(x, self._packed)


def choose(policy: nn.Module, weights: Weights) -> None:
    """Let the linear layers of a trained policy compute with such weights, in place.

    Raises:
        UserError: no such weights; or "fp16" and the policy is not on a CPU, or a weight is too large for it.
    """
    try:
        require(weights in ("fp32", "fp16"), f"weights = {weights!r}: must be fp32 or fp16")
        if weights == "fp32":
            return
        largest = torch.finfo(torch.float16).max
        for name, value in policy.named_parameters():
            require(value.device.type == "cpu", f"weights = {weights!r}: the policy must be on the CPU")
            require(value.abs().max().item() <= largest, f"weights = {weights!r}: {name} has one beyond {largest:g}")
    except ValueError as error:
        raise UserError(str(error)) from None
    for parent in list(policy.modules()):
        for name, layer in parent.named_children():
            if isinstance(layer, nn.Linear) and layer.bias is not None:
                setattr(parent, name, HalfLinear(layer))
