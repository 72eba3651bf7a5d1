"""How the weights of linear layers lie in memory, for a policy that acts for one episode on a CPU.

A call for one episode computes little with each weight, so it waits for memory. "fp32" stores a layer's weights column
by column, which the product of a few rows reads in order; actions differ in their last bits. "fp16" halves what is
read, and sums in single precision. Weights that are half precision already, as an archive's are, give the same actions
to about 1e-6; others are rounded.
"""

from typing import Literal, get_args

import torch
from torch import Tensor, nn

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
    """Let the linear layers of a trained policy compute with such weights, in place; on a GPU "fp32" changes nothing.

    Raises:
        UserError: no such weights; or "fp16" and the policy is not on a CPU, or a weight is too large for it.
    """
    if weights not in get_args(Weights):
        raise UserError(f"weights = {weights!r}: must be {' or '.join(get_args(Weights))}")
    if weights == "fp32":
        for layer in policy.modules():
            if isinstance(layer, nn.Linear) and layer.weight.device.type == "cpu":
                layer.weight.data = layer.weight.data.t().contiguous().t()
        return
    largest = torch.finfo(torch.float16).max
    for name, value in policy.named_parameters():
        if value.device.type != "cpu":
            raise UserError(f"weights = {weights!r}: the policy must be on the CPU")
        if value.abs().max() > largest:
            raise UserError(f"weights = {weights!r}: {name} has one beyond {largest:g}")
    for parent in list(policy.modules()):
        for name, layer in parent.named_children():
            if isinstance(layer, nn.Linear) and layer.bias is not None:
                setattr(parent, name, HalfLinear(layer))
