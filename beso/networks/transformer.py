"""The score transformer F of BESO (paper, Sec. IV "Model Architecture" and Fig. 1).

A causal transformer over one sequence. Sequential conditioning puts the goal in front:

    [sigma, g_1 .. g_G, s_1, a_1, s_2, a_2, .., s_T, a_T]         1 + G + 2T tokens

and reads the prediction for action t off its own token, which sees sigma, all goals, the states up to t and the noisy
actions up to t. FiLM conditioning (Perez et al. 2018) drops the goal tokens; a small network a block turns the goal
into a scale and a shift of the two normalised inputs instead. That network does not see the state.

States and goals share one embedding; s_t and a_t share one position; the sigma token has none.
"""

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from beso.config import require, require_positive, require_rate
from beso.networks.blocks import Block, causal_mask
from beso.networks.layers import initialise_normal


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
        require_positive(self, "width", "layers", "heads", "window")
        require(self.width % self.heads == 0, f"heads = {self.heads}: must divide width = {self.width}")
        require_rate(self, "attention_dropout", "residual_dropout")


class ScoreTransformer(nn.Module):
    """The inner network F(c_in a, s, g, c_noise).

    Args:
        config: size and conditioning.
        observation_size, action_size, goal_window: widths of states (and goals) and of actions; states in a goal.
        generator: initial weights are drawn from it.
    """

    mask: Tensor

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
        sizes = (config.width, config.heads, config.attention_dropout, config.residual_dropout)
        blocks = [Block(*sizes, film_inputs) for _ in range(config.layers)]
        self.blocks = nn.ModuleList(blocks)
        self.norm = nn.LayerNorm(config.width)
        self.head = nn.Linear(config.width, action_size)
        self.register_buffer("mask", causal_mask(1 + self.goal_tokens + 2 * config.window), persistent=False)
        initialise_normal(self, generator)
        for block in blocks:
            block.start_unconditional()

    def forward(
        self,
        actions: Tensor,
        c_noise: Tensor,
        observations: Tensor,
        goal: Tensor,
        last_only: bool = False,
        generator: torch.Generator | None = None,
    ) -> Tensor:
        """Predict for all actions, or for the last one only.

        Args:
            actions: (B, T, A) noisy actions times c_in; T at most the window.
            c_noise: (B,) of beso.diffusion.preconditioning, or another number for sigma.
            observations: (B, T, O).
            goal: (B, G, O).
            last_only: predict for the last action only.
            generator: turns dropout on and feeds it.

        Returns:
            (B, T, A), or (B, 1, A).
        """
        batch, steps, _ = actions.shape
        goals, position = self.goal_tokens, self.position
        at_steps = position[:, goals : goals + steps]
        states = self.embed_state(observations) + at_steps
        pairs = torch.stack([states, self.embed_action(actions) + at_steps], dim=2)  # (B, T, 2, d)
        tokens = [self.embed_sigma(c_noise.reshape(batch, 1, 1)), pairs.view(batch, 2 * steps, -1)]
        if goals:
            tokens.insert(1, self.embed_state(goal) + position[:, :goals])
        x = torch.cat(tokens, dim=1)
        mask = self.mask[: x.shape[1], : x.shape[1]]
        condition = None if goals else goal.flatten(1)
        *earlier, last = self.blocks
        for block in earlier:
            x = block(x, mask, generator, condition)
        # Of the last block, only the action tokens are read.
        x = last(x, mask, generator, condition, slice(-1, None) if last_only else slice(2 + goals, None, 2))
        return self.head(self.norm(x))
