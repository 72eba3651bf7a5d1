"""CX-Diff: goal-conditioned Diffusion-X (Pearce et al. 2023; paper, "Diffusion-X").

A discrete denoising diffusion model (Ho et al. 2020) on BESO's transformer, sampled with all its noise, and with extra
steps at the lowest noise level.
"""

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from beso.config import require, require_positive
from beso.core.memory import Memory
from beso.core.method import BaseMethod, SamplingConfig
from beso.core.noise import Noise
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.diffusion.score_policy import DenoiserConfig
from beso.networks.transformer import ScoreTransformer


@dataclass(frozen=True)
class Config(DenoiserConfig):
    """The network and its chain of noise levels.

    Attributes:
        diffusion_steps: T, the length of the chain.
        beta_min, beta_max: variances of the first and the last step; linear in between.
    """

    diffusion_steps: int
    beta_min: float
    beta_max: float

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "diffusion_steps")
        require(
            0 < self.beta_min <= self.beta_max < 1,
            f"beta_min = {self.beta_min}: must be above 0 and at most beta_max = {self.beta_max}, which is below 1",
        )

    def check(self, sampling: "Sampling") -> None:
        """As for all methods, and no more steps than the chain has."""
        super().check(sampling)
        steps, chain = sampling.steps, self.diffusion_steps
        require(steps is None or steps <= chain, f"steps = {steps}: must be at most diffusion_steps, {chain}")


@dataclass(frozen=True)
class Sampling(SamplingConfig):
    """How actions are generated.

    Attributes:
        steps: of the chain, evenly chosen where they are fewer than the training's; null takes all.
        extra_steps: X, further steps at the lowest noise level, without noise.
        context_length: time steps of the context in rollouts; null takes the training window.
    """

    steps: int | None
    extra_steps: int
    context_length: int | None

    def __post_init__(self) -> None:
        require_positive(self, "steps", "context_length")
        require(self.extra_steps >= 0, f"extra_steps = {self.extra_steps}: must not be negative")


class Method(nn.Module, BaseMethod):
    """The policy. See beso.core.method.BaseMethod."""

    alpha_bar: Tensor

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__()
        self.network = ScoreTransformer(config.transformer, *sizes, generator=generator)
        self.sampling = sampling or Sampling(steps=None, extra_steps=0, context_length=None)
        self.length = config.diffusion_steps
        alpha_bar = signal_shares(self.length, config.beta_min, config.beta_max)
        self.register_buffer("alpha_bar", alpha_bar.float(), persistent=False)
        shares, steps = alpha_bar.tolist(), self.sampling.steps or self.length
        extra = ancestral_updates(shares, self.length)[-1:] * self.sampling.extra_steps
        self._updates = ancestral_updates(shares, steps) + extra

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Squared error of the predicted noise (Ho et al. 2020, Eq. 14), a scalar; one step t a window."""
        clean = batch.actions
        t = torch.randint(1, self.length + 1, (len(clean),), generator=generator, device=clean.device)
        eps = torch.randn(clean.shape, generator=generator, device=clean.device)
        share = self.alpha_bar[t][:, None, None]
        noisy = share.sqrt() * clean + (1 - share).sqrt() * eps
        dropout = generator if self.training else None
        predicted = self.network(noisy, t / self.length, batch.observations, batch.goal, generator=dropout)
        return (predicted.float() - eps).square().mean()

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> (B, A). Previous actions are shrunk as in training, but not noised."""
        a = noise.normal(1, actions.shape[-1])
        for t, shrink, scale, slope, std in self._updates:
            level = a.new_full((len(a),), t / self.length)
            eps = self.network(torch.cat([shrink * actions, a], dim=1), level, observations, goal, last_only=True)
            a = scale * (a - slope * eps)
            if std:
                a = a + std * noise.normal(*a.shape[1:])
        return a[:, -1]


def signal_shares(steps: int, beta_min: float, beta_max: float) -> Tensor:
    """(T + 1,) alpha-bar of steps 0 to T: the share of the signal in the variance; 1 at step 0."""
    alphas = 1 - torch.linspace(beta_min, beta_max, steps, dtype=torch.float64)
    return torch.cat([alphas.new_ones(1), alphas.cumprod(0)])


def ancestral_updates(alpha_bar: list[float], steps: int) -> list[tuple[int, float, float, float, float]]:
    """The steps of ancestral sampling, a <- scale (a - slope eps) + std z (Ho et al. 2020, Alg. 2), from T to 0.

    With alpha = alpha_bar[t] / alpha_bar[next t], which is 1 - beta where no step is left out: scale = alpha^(-1/2),
    slope = (1 - alpha) / sqrt(1 - alpha_bar[t]), and std^2 is the posterior's variance
    (1 - alpha) (1 - alpha_bar[next t]) / (1 - alpha_bar[t]), which is 0 in the last step. (Ho et al.'s other choice,
    1 - alpha, leaves short chains noise that their last step is too fine to take away.)

    Args:
        steps: how many of the T steps to take, at most T, evenly chosen, the last always T.

    Returns:
        t, sqrt(alpha_bar[t]), scale, slope and std of each step.
    """
    length = len(alpha_bar) - 1
    levels = [round(length * i / steps) for i in range(steps, -1, -1)]
    updates = []
    for t, to in itertools.pairwise(levels):
        alpha = alpha_bar[t] / alpha_bar[to]
        slope = (1 - alpha) / math.sqrt(1 - alpha_bar[t])
        std = math.sqrt((1 - alpha) * (1 - alpha_bar[to]) / (1 - alpha_bar[t]))
        updates.append((t, math.sqrt(alpha_bar[t]), 1 / math.sqrt(alpha), slope, std))
    return updates
