"""Multi-layer perceptron with ReLU, the network of the paper's simpler baselines."""

import itertools
import math

import torch
from torch import Tensor, nn

from beso.networks.layers import dropout


class MLP(nn.Module):
    """`layers` hidden layers of `width` neurons, each followed by ReLU and dropout, and a linear output.

    Args:
        inputs, outputs: widths of input and output.
        generator: initial weights are drawn from it, uniform in +-1/sqrt(fan in), biases too (PyTorch's default).
    """

    def __init__(
        self, inputs: int, outputs: int, width: int, layers: int, dropout_rate: float, generator: torch.Generator
    ) -> None:
        super().__init__()
        sizes = [inputs] + [width] * layers
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in itertools.pairwise(sizes))
        self.output = nn.Linear(width, outputs)
        self.dropout_rate = dropout_rate
        with torch.no_grad():
            for layer in [*self.hidden, self.output]:
                bound = 1 / math.sqrt(layer.in_features)
                for parameter in layer.parameters():
                    parameter.uniform_(-bound, bound, generator=generator)

    def forward(self, x: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """(..., inputs) -> (..., outputs). With a generator, dropout is on."""
        for layer in self.hidden:
            x = dropout(torch.relu(layer(x)), self.dropout_rate, generator)
        return self.output(x)
