"""A score-based diffusion policy: training objective (paper, Alg. 1) and action generation (Alg. 2).

One window of T steps:

    observations   s_1  s_2  ..  s_T          T grows from 1 to the window at the start of an episode
    actions        a_1  ..  a_{T-1}  [a_T]    previous actions are known; the last one is generated
    goal           g_1 .. g_G

Training noises all T actions at one level sigma a window and learns to denoise them all. At inference only a_T is
noisy. Samplers, schedules and guidance are imported where a policy acts: training needs none of them, so that a new
sampler retrains nothing.
"""

import functools
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor, nn

from beso.config import require, require_name, require_positive, require_rate
from beso.data.windows import Batch
from beso.diffusion.densities import DENSITIES
from beso.diffusion.preconditioning import broadcast_to_actions, network_target, scales
from beso.memory import Memory
from beso.methods import ModelConfig, Policy, SamplingConfig
from beso.networks.transformer import TransformerConfig
from beso.noise import Noise


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
        _check_range(self.sigma_min, self.sigma_max)
        require_name(self, "density", DENSITIES)
        require(self.scale > 0, f"scale = {self.scale}: must be above 0")


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
        from beso.diffusion.samplers import SAMPLERS
        from beso.diffusion.schedules import SCHEDULES

        require_name(self, "sampler", SAMPLERS)
        require_name(self, "schedule", SCHEDULES)
        require_positive(self, "steps", "context_length")
        _check_range(self.sigma_min, self.sigma_max)
        self.sigmas()  # some schedules refuse too many steps

    def sigmas(self) -> list[float]:
        """The noise levels that the sampler stops at, `steps` + 1 of them."""
        from beso.diffusion.schedules import SCHEDULES

        return SCHEDULES[self.schedule](self.steps, self.sigma_min, self.sigma_max).tolist()


def _check_range(sigma_min: float, sigma_max: float) -> None:
    require(0 < sigma_min < sigma_max, f"sigma_min = {sigma_min}: must be above 0 and below sigma_max = {sigma_max}")


@functools.lru_cache
def _scales_of_one(sigma: float, sigma_data: float) -> list[float]:
    """c_skip, c_out, c_in and c_noise of a noise level, computed once: a sampler meets few of them."""
    return [value.item() for value in scales(torch.tensor(sigma), sigma_data)]


def default_sampling(diffusion: DiffusionConfig) -> DiffusionSampling:
    """The paper's default sampler over the training range."""
    return DiffusionSampling("ddim", "exponential", 3, diffusion.sigma_min, diffusion.sigma_max, "clean", None)


class ScorePolicy(nn.Module, Policy):
    """Denoiser, loss and sampling around an inner network.

    Args:
        network: F, called as networks.transformer.ScoreTransformer is.
        diffusion, sampling: configurations of training noise and of action generation; None is the default sampling.
        goal_dropout: probability that a training sample loses its goal.
        goal_dropout_from: share of the training before which no goal is lost.
        null_goal: (G, O) what a network gets for a lost goal before training, which learns it; None is zeros, always.
        guidance_scale: lambda of classifier-free guidance: 1 conditional, 0 unconditional.
    """

    def __init__(
        self,
        network: nn.Module,
        diffusion: DiffusionConfig,
        sampling: DiffusionSampling | None,
        goal_dropout: float = 0.0,
        goal_dropout_from: float = 0.0,
        null_goal: Tensor | None = None,
        guidance_scale: float = 1.0,
    ) -> None:
        super().__init__()
        self.network = network
        self.diffusion, self.sampling = diffusion, sampling or default_sampling(diffusion)
        self.goal_dropout, self.goal_dropout_from = goal_dropout, goal_dropout_from
        self.drops_goals = goal_dropout > 0
        # Three dimensions, so that optimizers do not take it for a hidden matrix.
        self.null_goal = None if null_goal is None else nn.Parameter(null_goal[None].clone())
        self.guidance_scale = guidance_scale

    def schedule(self, done: float) -> bool:
        """Goals are lost from a share of the training on: a network must first find out what they are good for."""
        before, self.drops_goals = self.drops_goals, self.goal_dropout > 0 and done >= self.goal_dropout_from
        return self.drops_goals != before

    def without_goal(self, goal: Tensor) -> Tensor:
        """What stands for no goal, in the shape (B, G, O) of a batch of goals."""
        return torch.zeros_like(goal) if self.null_goal is None else self.null_goal.expand_as(goal)

    @functools.cached_property
    def _sigmas(self) -> list[float]:
        return self.sampling.sigmas()

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
        from beso.diffusion.guidance import classifier_free
        from beso.diffusion.samplers import SAMPLERS

        batch, previous = len(observations), actions.shape[1]
        actions = self.diffusion.action_range * actions
        guided = self.guidance_scale not in (0.0, 1.0)
        if self.guidance_scale == 0:
            goal = self.without_goal(goal)
        elif guided:
            goal = torch.cat([goal, self.without_goal(goal)])
            observations, actions = torch.cat([observations, observations]), torch.cat([actions, actions])

        alone, action_size = self.sampling.context != "published", actions.shape[-1]
        eps: Tensor | float = 0.0  # of the previous actions, for each of the levels alike
        if self.sampling.context == "renoised":
            eps = noise.normal(previous, action_size)
            eps = torch.cat([eps, eps]) if guided else eps

        def bound(a: Tensor, sigma: float) -> Tensor:
            """D with state and goal bound, on the current action (B, 1, A) or, as published, on all of them."""
            if alone:
                return self.denoise(torch.cat([actions + sigma * eps, a], dim=1), sigma, observations, goal)
            return self.denoise(a, sigma, observations, goal, last_only=False)

        denoise = classifier_free(bound, self.guidance_scale) if guided else bound
        sigmas = self._sigmas
        a = self.sampling.sigma_max * noise.normal(1, action_size)
        if not alone:
            a = torch.cat([actions[:batch], a], dim=1)
        noise_steps = 1 if alone else previous + 1
        sampler = SAMPLERS[self.sampling.sampler]
        sampled = sampler(denoise, a, sigmas, lambda: noise.normal(noise_steps, action_size))
        return sampled[:, -1] / self.diffusion.action_range
