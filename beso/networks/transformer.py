"""The score transformer F of BESO (paper, Sec. IV "Model Architecture" and Fig. 1).

A causal transformer over one sequence. Sequential conditioning puts the goal in front:

    [sigma, g_1 .. g_G, s_1, a_1, s_2, a_2, .., s_T, a_T]         1 + G + 2T tokens

and reads the prediction for action t off its own token, which sees sigma, all goals, the states up to t and the noisy
actions up to t. FiLM conditioning (Perez et al. 2018) drops the goal tokens; a small network a block turns the goal
into a scale and a shift of the two normalised inputs instead.

States and goals share one embedding; s_t and a_t share one position; the sigma token has none.
"""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.config import require
from beso.networks.layers import dropout, initialise_normal


@dataclass(frozen=True)
class TransformerConfig:
    """Size of the transformer.

    Attributes:
        width: size of a token; a multiple of `heads`.
        layers, heads: number of blocks and of attention heads.
        window: largest number of time steps T.
        attention_dropout, residual_dropout: rates.
        conditioning: "sequential" (goal tokens) or "film".
    """

    width: int
    layers: int
    heads: int
    window: int
    attention_dropout: float
    residual_dropout: float
    conditioning: Literal["sequential", "film"]

    def __post_init__(self) -> None:
        for name in ("width", "layers", "heads", "window"):
            require(getattr(self, name) >= 1, f"{name} = {getattr(self, name)}: must be at least 1")
        require(self.width % self.heads == 0, f"heads = {self.heads}: must divide width = {self.width}")
        for name in ("attention_dropout", "residual_dropout"):
            require(0 <= getattr(self, name) < 1, f"{name} = {getattr(self, name)}: must be in [0, 1)")


def fused_attention_pays(device: torch.device) -> bool:
    """Over a dozen tokens, plain products are faster than the CPU's fused kernel."""
    return device.type != "cpu"


class Attention(nn.Module):
    """Causal multi-head self-attention with biases."""

    def __init__(self, config: TransformerConfig) -> None:
        super().__init__()
        self.heads = config.heads
        self.query_key_value = nn.Linear(config.width, 3 * config.width)
        self.output = nn.Linear(config.width, config.width)
        self.attention_dropout, self.residual_dropout = config.attention_dropout, config.residual_dropout

    def forward(self, x: Tensor, mask: Tensor, last_only: bool, generator: torch.Generator | None) -> Tensor:
        """x (B, L, d) and the causal mask (L, L) -> (B, L, d), or (B, 1, d) for the last position alone."""
        batch, _, width = x.shape
        size = width // self.heads

        def by_head(y: Tensor) -> Tensor:
            """(B, L, n d) -> (n, B heads, L, size)."""
            split = y.view(batch, y.shape[1], -1, self.heads, size)
            return split.permute(2, 0, 3, 1, 4).reshape(split.shape[2], batch * self.heads, -1, size)

        if last_only:
            weight, bias = self.query_key_value.weight, self.query_key_value.bias
            query = by_head(functional.linear(x[:, -1:], weight[:width], bias[:width]))[0]
            key, value = by_head(functional.linear(x, weight[width:], bias[width:]))
            mask = mask[-1:]
        else:
            query, key, value = by_head(self.query_key_value(x))
        drops = generator is not None and self.attention_dropout > 0
        if drops or not fused_attention_pays(x.device):
            # The fused kernel would draw its dropout from torch's global generator.
            weights = torch.baddbmm(mask, query, key.mT, alpha=1 / math.sqrt(size)).softmax(dim=-1)
            y = dropout(weights, self.attention_dropout, generator) @ value
        else:
            query, key, value = (z.view(batch, self.heads, -1, size) for z in (query, key, value))
            y = functional.scaled_dot_product_attention(query, key, value, is_causal=not last_only)
        y = y.view(batch, self.heads, -1, size).transpose(1, 2).reshape(batch, -1, width)
        return dropout(self.output(y), self.residual_dropout, generator)


class Block(nn.Module):
    """Pre-norm transformer block; with FiLM, the goal scales and shifts both normalised inputs."""

    def __init__(self, config: TransformerConfig, film_inputs: int | None) -> None:
        super().__init__()
        width = config.width
        self.attention_norm, self.mlp_norm = nn.LayerNorm(width), nn.LayerNorm(width)
        self.attention = Attention(config)
        self.expand, self.contract = nn.Linear(width, 4 * width), nn.Linear(4 * width, width)
        self.residual_dropout = config.residual_dropout
        self.film = None
        if film_inputs is not None:
            self.film = nn.Sequential(nn.Linear(film_inputs, width), nn.ReLU(), nn.Linear(width, 4 * width))

    def start_unconditional(self) -> None:
        """Zero what FiLM adds, so that training starts from the network without a goal."""
        if self.film is not None:
            for parameter in self.film[-1].parameters():
                nn.init.zeros_(parameter)

    def forward(
        self, x: Tensor, mask: Tensor, goal: Tensor, last_only: bool, generator: torch.Generator | None
    ) -> Tensor:
        """x (B, L, d), mask (L, L), goal (B, G, O) -> (B, L, d), or (B, 1, d) for the last position alone."""
        normed = self.attention_norm(x)
        if self.film is not None:
            gamma_1, beta_1, gamma_2, beta_2 = self.film(goal.flatten(1)).unsqueeze(1).chunk(4, dim=-1)
            normed = normed * (1 + gamma_1) + beta_1
        if last_only:
            x = x[:, -1:]
        x = x + self.attention(normed, mask, last_only, generator)
        normed = self.mlp_norm(x)
        if self.film is not None:
            normed = normed * (1 + gamma_2) + beta_2
        y = self.contract(functional.gelu(self.expand(normed)))
        return x + dropout(y, self.residual_dropout, generator)


class ScoreTransformer(nn.Module):
    """The inner network F(c_in a, s, g, c_noise).

    Args:
        config: size and conditioning.
        observation_size, action_size, goal_window: widths of states (and goals) and of actions; states in a goal.
        generator: initial weights are drawn from it.
    """

    mask: Tensor  # (L, L): 0 on and below the diagonal, minus infinity in the future

    def __init__(
        self,
        config: TransformerConfig,
        observation_size: int,
        action_size: int,
        goal_window: int,
        generator: torch.Generator,
    ) -> None:
        super().__init__()
        film = config.conditioning == "film"
        self.goal_tokens = 0 if film else goal_window
        self.embed_state = nn.Linear(observation_size, config.width)
        self.embed_action = nn.Linear(action_size, config.width)
        self.embed_sigma = nn.Linear(1, config.width)
        # One entry more than there are positions, as in the published network, so that parameter counts agree.
        self.position = nn.Parameter(torch.empty(1, self.goal_tokens + config.window + 1, config.width))
        film_inputs = goal_window * observation_size if film else None
        blocks = [Block(config, film_inputs) for _ in range(config.layers)]
        self.blocks = nn.ModuleList(blocks)
        self.norm = nn.LayerNorm(config.width)
        self.head = nn.Linear(config.width, action_size)
        longest = 1 + self.goal_tokens + 2 * config.window
        self.register_buffer("mask", torch.full((longest, longest), -math.inf).triu(1), persistent=False)
        initialise_normal(self, generator)
        for block in blocks:
            block.start_unconditional()

    def forward(
        self,
        actions: Tensor,
        noise_level: Tensor,
        observations: Tensor,
        goal: Tensor,
        last_only: bool = False,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Predict for all actions, or for the last one only.

        Args:
            actions: (B, T, A) noisy actions times c_in; T at most the window.
            noise_level: (B,) c_noise.
            observations: (B, T, O).
            goal: (B, G, O).
            last_only: compute only what the last action needs in the last block.
            generator: turns dropout on and feeds it.

        Returns:
            (B, T, A), or (B, 1, A).
        """
        batch, steps, _ = actions.shape
        goals, position = self.goal_tokens, self.position
        at_steps = position[:, goals : goals + steps]
        states = self.embed_state(observations) + at_steps
        pairs = torch.stack([states, self.embed_action(actions) + at_steps], dim=2)  # (B, T, 2, d)
        tokens = [self.embed_sigma(noise_level.reshape(batch, 1, 1)), pairs.view(batch, 2 * steps, -1)]
        if goals:
            tokens.insert(1, self.embed_state(goal) + position[:, :goals])
        x = torch.cat(tokens, dim=1)
        mask = self.mask[: x.shape[1], : x.shape[1]]
        for i, block in enumerate(self.blocks):
            x = block(x, mask, goal, last_only and i == len(self.blocks) - 1, generator)
        if not last_only:
            x = x[:, 2 + goals :: 2]  # the action tokens
        return self.head(self.norm(x))
