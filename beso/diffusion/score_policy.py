"""A score-based diffusion policy: denoiser and training objective (paper, Alg. 1).

One window of T steps:

    observations   s_1  s_2  ..  s_T          T grows from 1 to the window at the start of an episode
    actions        a_1  ..  a_{T-1}  [a_T]    previous actions are known; the last one is generated
    goal           g_1 .. g_G

Training noises all T actions at one level sigma a window and learns to denoise them all. At inference only a_T is
noisy. How actions are generated is the Sampling's (beso.sampling.diffusion): training needs no sampler, so that a new
one retrains nothing.
"""

import functools
from dataclasses import dataclass, field
from typing import Protocol

import torch
from torch import Tensor, nn

from beso.config import require, require_name, require_rate
from beso.core.memory import Memory
from beso.core.method import BaseMethod, ModelConfig
from beso.core.noise import Noise
from beso.data.windows import Batch
from beso.diffusion.densities import DENSITIES
from beso.diffusion.preconditioning import broadcast_to_actions, network_target, scales
from beso.networks.transformer import TransformerConfig


@dataclass(frozen=True)
class DenoiserConfig(ModelConfig):
    """What the Configs of all diffusion policies inherit, CX-Diff's too.

    Attributes:
        transformer: BESO's network.
        final_goals: see ModelConfig.
    """

    transformer: TransformerConfig
    final_goals: float = field(kw_only=True)

    def __post_init__(self) -> None:
        require_rate(self, "final_goals")

    @property
    def window(self) -> int:
        """Time steps in a training window and in the context of `act`."""
        return self.transformer.window


@dataclass(frozen=True)
class DiffusionConfig:
    """The training noise.

    Attributes:
        sigma_data: the data's standard deviation, for the preconditioning.
        sigma_min, sigma_max: range of noise levels.
        density: name in densities.DENSITIES, with its location and scale.
        action_range: actions are diffused within [-action_range, action_range].
    """

    sigma_data: float
    sigma_min: float
    sigma_max: float
    density: str
    location: float
    scale: float
    action_range: float

    def __post_init__(self) -> None:
        require(self.action_range > 0, f"action_range = {self.action_range}: must be above 0")
        require(self.sigma_data > 0, f"sigma_data = {self.sigma_data}: must be above 0")
        check_range(self.sigma_min, self.sigma_max)
        require_name(self, "density", DENSITIES)
        require(self.scale > 0, f"scale = {self.scale}: must be above 0")


def check_range(sigma_min: float, sigma_max: float) -> None:
    """Raise ValueError unless these are the ends of a range of noise levels."""
    require(0 < sigma_min < sigma_max, f"sigma_min = {sigma_min}: must be above 0 and below sigma_max = {sigma_max}")


@functools.lru_cache
def _scales_of_one(sigma: float, sigma_data: float) -> list[float]:
    """c_skip, c_out, c_in and c_noise of a noise level, computed once: a sampler meets few of them."""
    return [value.item() for value in scales(torch.tensor(sigma), sigma_data)]


class Acting(Protocol):
    """What a ScorePolicy asks of its sampling; beso.sampling.diffusion has them."""

    def act(self, policy: "ScorePolicy", observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise) -> Tensor:
        """The next action; as ScorePolicy.act."""


class ScorePolicy(nn.Module, BaseMethod):
    """Denoiser and loss around an inner network.

    Args:
        network: F, called as networks.transformer.ScoreTransformer is.
        diffusion: the training noise.
        sampling: how actions are generated; None for a policy that only trains.
        goal_dropout: probability that a training sample loses its goal.
        goal_dropout_from: share of the training before which no goal is lost.
        null_goal: (G, O) what a network gets for a lost goal before training, which learns it; None is zeros, always.
    """

    def __init__(
        self,
        network: nn.Module,
        diffusion: DiffusionConfig,
        sampling: Acting | None,
        goal_dropout: float = 0.0,
        goal_dropout_from: float = 0.0,
        null_goal: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.network = network
        self.diffusion, self.sampling = diffusion, sampling
        self.goal_dropout, self.goal_dropout_from = goal_dropout, goal_dropout_from
        self.drops_goals = goal_dropout > 0
        # Three dimensions, so that optimizers do not take it for a hidden matrix.
        self.null_goal = None if null_goal is None else nn.Parameter(null_goal[None].clone())

    def schedule(self, done: float) -> bool:
        """Goals are lost from a share of the training on: a network must first find out what they are good for."""
        before, self.drops_goals = self.drops_goals, self.goal_dropout > 0 and done >= self.goal_dropout_from
        return self.drops_goals != before

    def without_goal(self, goal: Tensor) -> Tensor:
        """What stands for no goal, in the shape (B, G, O) of a batch of goals."""
        return torch.zeros_like(goal) if self.null_goal is None else self.null_goal.expand_as(goal)

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Denoising score matching (paper, Eq. 6 and Alg. 1), a scalar.

        sigma ~ p_train, one a window; eps ~ N(0, sigma^2); the squared error of D against the clean actions with the
        weight alpha(sigma) = 1 / c_out^2, as a mean over samples, steps and dimensions.
        """
        config = self.diffusion
        clean = config.action_range * batch.actions
        dropout = generator if self.training else None
        uniform = torch.rand(len(clean), generator=generator, device=clean.device, dtype=torch.float64)
        density = DENSITIES[config.density]
        sigma = density(uniform, config.sigma_min, config.sigma_max, config.location, config.scale).to(clean.dtype)
        goal = batch.goal
        if self.drops_goals and self.training:
            kept = torch.rand(len(goal), 1, 1, generator=generator, device=goal.device) >= self.goal_dropout
            goal = torch.where(kept, goal, self.without_goal(goal))
        eps = torch.randn(clean.shape, generator=generator, device=clean.device)
        noisy = clean + sigma[:, None, None] * eps
        at = scales(sigma, config.sigma_data)
        wide = broadcast_to_actions(at)
        predicted = self.network(wide.into * noisy, at.noise, batch.observations, goal, generator=dropout)
        return (predicted.float() - network_target(clean, noisy, wide)).square().mean()

    def denoise(
        self, actions: Tensor, sigma: float, observations: Tensor, goal: Tensor, last_only: bool = True
    ) -> Tensor:
        """D(a, s, g, sigma): (B, T, A) -> denoised actions (B, T, A), or (B, 1, A) for the last one."""
        skip, out, into, noise = _scales_of_one(sigma, self.diffusion.sigma_data)
        level = actions.new_full((len(actions),), noise)
        predicted = self.network(into * actions, level, observations, goal, last_only=last_only)
        kept = actions[:, -1:] if last_only else actions
        return skip * kept + out * predicted

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """Generate the next action.

        Args:
            observations: (B, T, O) scaled, oldest first, the current one last.
            actions: (B, T-1, A) scaled previous actions.
            goal: (B, G, O) scaled.
            noise: source of the initial sample and of injected noise.
            memory: not used.

        Returns:
            (B, A) scaled action.
        """
        assert self.sampling is not None, "made without a sampling"
        return self.sampling.act(self, observations, actions, goal, noise)
