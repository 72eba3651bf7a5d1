"""A transformer over one sequence of vectors: the network of C-BeT, and LMP's plan recognition."""

import torch
from torch import Tensor, nn

from beso.networks.blocks import Block, causal_mask
from beso.networks.layers import dropout, initialise_normal


class SequenceTransformer(nn.Module):
    """A linear embedding, learned positions, blocks, and a linear output without bias at every position.

    Args:
        inputs, outputs: widths of input and output vectors.
        longest: largest length of a sequence.
        width, layers, heads: size of a token, number of blocks and of attention heads.
        dropout_rate: of embeddings, attention and residuals.
        causal: a position sees itself and what precedes it; otherwise every position sees all.
        generator: initial weights are drawn from it.
    """

    mask: Tensor

    def __init__(
        self,
        inputs: int,
        outputs: int,
        longest: int,
        width: int,
        layers: int,
        heads: int,
        dropout_rate: float,
        causal: bool,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        self.dropout_rate, self.causal = dropout_rate, causal
        self.embed = nn.Linear(inputs, width)
        self.position = nn.Parameter(torch.empty(1, longest, width))
        self.blocks = nn.ModuleList(Block(width, heads, dropout_rate, dropout_rate) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, outputs, bias=False)
        self.register_buffer("mask", causal_mask(longest), persistent=False)
        initialise_normal(self, generator)

    def forward(self, x: Tensor, generator: torch.Generator | None = None) -> Tensor:
        """(B, L, inputs) -> (B, L, outputs). With a generator, dropout is on."""
        length = x.shape[1]
        x = dropout(self.embed(x) + self.position[:, :length], self.dropout_rate, generator)
        mask = self.mask[:length, :length] if self.causal else None
        for block in self.blocks:
            x = block(x, mask, generator)
        return self.head(self.norm(x))
