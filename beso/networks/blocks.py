"""Pre-norm transformer blocks, shared by every network with attention."""

import math

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.networks.layers import dropout

ALL = slice(None)  # every position of a sequence


def causal_mask(length: int) -> Tensor:
    """(L, L): 0 on and below the diagonal, minus infinity in the future."""
    return torch.full((length, length), -math.inf).triu(1)


def fused_attention_pays(device: torch.device) -> bool:
    """Over a dozen tokens, plain products are faster than the CPU's fused kernel."""
    return device.type != "cpu"


class Attention(nn.Module):
    """Multi-head self-attention with biases, causal where there is a mask."""

    def __init__(self, width: int, heads: int, attention_dropout: float, residual_dropout: float) -> None:
        super().__init__()
        self.heads = heads
        self.query_key_value = nn.Linear(width, 3 * width)
        self.output = nn.Linear(width, width)
        self.attention_dropout, self.residual_dropout = attention_dropout, residual_dropout

    def forward(self, x: Tensor, mask: Tensor | None, wanted: slice, generator: torch.Generator | None) -> Tensor:
        """x (B, L, d) and causal_mask(L) or None -> (B, n, d) for the n wanted positions."""
        batch, _, width = x.shape
        size = width // self.heads

        def by_head(y: Tensor) -> Tensor:
            """(B, L, n d) -> (n, B heads, L, size)."""
            split = y.view(batch, y.shape[1], -1, self.heads, size)
            return split.permute(2, 0, 3, 1, 4).reshape(split.shape[2], batch * self.heads, -1, size)

        if wanted == ALL:
            query, key, value = by_head(self.query_key_value(x))
        else:
            weight, bias = self.query_key_value.weight, self.query_key_value.bias
            query = by_head(functional.linear(x[:, wanted], weight[:width], bias[:width]))[0]
            key, value = by_head(functional.linear(x, weight[width:], bias[width:]))
            mask = None if mask is None else mask[wanted]
        drops = generator is not None and self.attention_dropout > 0
        if drops or not fused_attention_pays(x.device):
            # The fused kernel would draw its dropout from torch's global generator.
            scale = 1 / math.sqrt(size)
            if mask is None:
                scores = torch.bmm(query * scale, key.mT)
            else:
                scores = torch.baddbmm(mask, query, key.mT, alpha=scale)
            weights = scores.softmax(dim=-1)
            y = dropout(weights, self.attention_dropout, generator) @ value
        else:
            query, key, value = (z.view(batch, self.heads, -1, size) for z in (query, key, value))
            y = functional.scaled_dot_product_attention(query, key, value, attn_mask=mask)
        y = y.view(batch, self.heads, -1, size).transpose(1, 2).reshape(batch, -1, width)
        return dropout(self.output(y), self.residual_dropout, generator)


class Block(nn.Module):
    """Pre-norm transformer block; with FiLM, a condition scales and shifts both normalised inputs."""

    def __init__(
        self,
        width: int,
        heads: int,
        attention_dropout: float,
        residual_dropout: float,
        film_inputs: int | None = None,
    ) -> None:
        super().__init__()
        self.attention_norm, self.mlp_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention = Attention(width, heads, attention_dropout, residual_dropout)
        self.expand, self.contract = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)
        self.residual_dropout = residual_dropout
        self.film = None
        if film_inputs is not None:
            self.film = nn.Sequential(nn.Linear(film_inputs, width), nn.ReLU(), nn.Linear(width, 4 * width))

    def start_unconditional(self) -> None:
        """Zero what FiLM adds, so that training starts from the network without a condition."""
        if self.film is not None:
            for parameter in self.film[-1].parameters():
                nn.init.zeros_(parameter)

    def forward(
        self,
        x: Tensor,
        mask: Tensor | None,
        generator: torch.Generator | None,
        condition: Tensor | None = None,
        wanted: slice = ALL,
    ) -> Tensor:
        """Transform a sequence.

        Args:
            x: (B, L, d).
            mask: causal_mask(L), or None where every position sees all.
            generator: turns dropout on and feeds it.
            condition: (B, film_inputs), with FiLM.
            wanted: the positions to compute.

        Returns:
            (B, n, d) for the n wanted positions.
        """
        normed = self.attention_norm(x)
        if self.film is not None:
            gamma_1, beta_1, gamma_2, beta_2 = self.film(condition).unsqueeze(1).chunk(4, dim=-1)
            normed = normed * (1 + gamma_1) + beta_1
        x = x[:, wanted] + self.attention(normed, mask, wanted, generator)
        normed = self.mlp_norm(x)
        if self.film is not None:
            normed = normed * (1 + gamma_2) + beta_2
        y = self.contract(functional.gelu(self.expand(normed)))
        return x + dropout(y, self.residual_dropout, generator)
