"""How score-based diffusion policies act (paper, Alg. 2): what their Samplings say, and do.

An action is generated from noise, with the previous actions, states and goal as the network's other inputs
(beso.diffusion.score_policy).
"""

import functools
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor

from beso.config import require, require_name, require_positive
from beso.core.method import ContextSampling, SamplingConfig
from beso.core.noise import Noise
from beso.diffusion.score_policy import DiffusionConfig, ScorePolicy, check_range
from beso.sampling.guidance import classifier_free
from beso.sampling.samplers import SAMPLERS
from beso.sampling.schedules import SCHEDULES

MOST_STEPS = 10_000


@functools.lru_cache
def _sigmas(schedule: str, steps: int, sigma_min: float, sigma_max: float) -> list[float]:
    return SCHEDULES[schedule](steps, sigma_min, sigma_max).tolist()


@dataclass(frozen=True)
class DiffusionSampling(SamplingConfig):
    """How actions are generated from a trained model.

    Attributes:
        sampler, schedule: names in samplers.SAMPLERS and schedules.SCHEDULES.
        steps: number of denoising steps.
        sigma_min, sigma_max: range of the schedule.
        context: "clean" keeps the previous actions as executed; "published" pushes them through the sampler together
            with the new one, as the published code does (docs/fidelity.md); "renoised" adds noise of each denoising
            step's level to them, as training does.
        context_length: time steps of the context in rollouts; null takes the training window.
    """

    sampler: str
    schedule: str
    steps: int
    sigma_min: float
    sigma_max: float
    context: Literal["clean", "published", "renoised"]
    context_length: int | None

    def __post_init__(self) -> None:
        require_name(self, "sampler", SAMPLERS)
        require_name(self, "schedule", SCHEDULES)
        require_positive(self, "steps", "context_length")
        require(self.steps <= MOST_STEPS, f"steps = {self.steps}: must be at most {MOST_STEPS}")
        check_range(self.sigma_min, self.sigma_max)
        self.sigmas()  # some schedules refuse too many steps

    def sigmas(self) -> list[float]:
        """The noise levels that the sampler stops at, `steps` + 1 of them."""
        return _sigmas(self.schedule, self.steps, self.sigma_min, self.sigma_max)

    @classmethod
    def default(cls, config: Any) -> "DiffusionSampling":
        """The paper's default sampler over the training range of a Config."""
        noise: DiffusionConfig = config.diffusion
        return cls("ddim", "exponential", 3, noise.sigma_min, noise.sigma_max, "clean", None)

    def act(
        self,
        policy: ScorePolicy,
        observations: Tensor,
        actions: Tensor,
        goal: Tensor,
        noise: Noise,
        scale: float = 1.0,
    ) -> Tensor:
        """Generate the next action, see ScorePolicy.act.

        Args:
            scale: lambda of classifier-free guidance: 1 conditional, 0 unconditional.
        """
        batch, previous = len(observations), actions.shape[1]
        actions = policy.diffusion.action_range * actions
        guided = scale not in (0.0, 1.0)
        if scale == 0:
            goal = policy.without_goal(goal)
        elif guided:
            goal = torch.cat([goal, policy.without_goal(goal)])
            observations, actions = torch.cat([observations, observations]), torch.cat([actions, actions])

        alone, action_size = self.context != "published", actions.shape[-1]
        eps: Tensor | float = 0.0  # of the previous actions, for each of the levels alike
        if self.context == "renoised":
            eps = noise.normal(previous, action_size)
            eps = torch.cat([eps, eps]) if guided else eps

        def bound(a: Tensor, sigma: float) -> Tensor:
            """D with state and goal bound, on the current action (B, 1, A) or, as published, on all of them."""
            if alone:
                return policy.denoise(torch.cat([actions + sigma * eps, a], dim=1), sigma, observations, goal)
            return policy.denoise(a, sigma, observations, goal, last_only=False)

        denoise = classifier_free(bound, scale) if guided else bound
        sigmas = self.sigmas()
        a = self.sigma_max * noise.normal(1, action_size)
        if not alone:
            a = torch.cat([actions[:batch], a], dim=1)
        noise_steps = 1 if alone else previous + 1
        sampler = SAMPLERS[self.sampler]
        sampled = sampler(denoise, a, sigmas, lambda: noise.normal(noise_steps, action_size))
        return sampled[:, -1] / policy.diffusion.action_range


@dataclass(frozen=True)
class GuidedSampling(DiffusionSampling):
    """As DiffusionSampling, with classifier-free guidance of scale lambda."""

    guidance_scale: float

    @classmethod
    def default(cls, config: Any) -> "GuidedSampling":
        """The paper's default sampler without guidance."""
        return cls(**vars(DiffusionSampling.default(config)), guidance_scale=1.0)

    def act(
        self,
        policy: ScorePolicy,
        observations: Tensor,
        actions: Tensor,
        goal: Tensor,
        noise: Noise,
        scale: float = 1.0,
    ) -> Tensor:
        """Generate the next action with the guidance scale of this sampling."""
        return super().act(policy, observations, actions, goal, noise, self.guidance_scale)


@dataclass(frozen=True)
class StudentSampling(ContextSampling):
    """Sampler and steps of a student are those of its training (beso.methods.distilled)."""

    @classmethod
    def default(cls, config: Any) -> "StudentSampling":
        """With the training's context."""
        return cls(None)

    def act(self, policy: Any, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise) -> Tensor:
        """Generate the next action, see ScorePolicy.act."""
        levels = policy.diffusion.sigma_min, policy.diffusion.sigma_max
        return _student(policy.steps, *levels).act(policy, observations, actions, goal, noise)


@functools.lru_cache
def _student(steps: int, sigma_min: float, sigma_max: float) -> DiffusionSampling:
    return DiffusionSampling("ddim", "exponential", steps, sigma_min, sigma_max, "clean", None)
