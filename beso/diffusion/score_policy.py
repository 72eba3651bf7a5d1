"""A score-based diffusion policy: training objective (paper, Alg. 1) and action generation (Alg. 2).

One window of T steps:

    observations   s_1  s_2  ..  s_T          T grows from 1 to the window at the start of an episode
    actions        a_1  ..  a_{T-1}  [a_T]    previous actions are known; the last one is generated
    goal           g_1 .. g_G

Training noises all T actions at one level sigma a window and learns to denoise them all. At inference only a_T is
noisy.
"""

import functools
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor, nn

from beso.config import require, require_positive
from beso.data.windows import Batch
from beso.diffusion.densities import DENSITIES
from beso.diffusion.guidance import classifier_free
from beso.diffusion.preconditioning import broadcast_to_actions, network_target, scales
from beso.diffusion.samplers import SAMPLERS, Denoise
from beso.diffusion.schedules import SCHEDULES
from beso.memory import Memory
from beso.noise import Noise


@dataclass(frozen=True)
class DiffusionConfig:
    """The training noise.

    Attributes:
        sigma_data: the data's standard deviation, for the preconditioning.
        sigma_min, sigma_max: range of noise levels.
        density: name in densities.DENSITIES, with its location and scale.
    """

    sigma_data: float
    sigma_min: float
    sigma_max: float
    density: Literal["log_logistic", "log_normal", "uniform"]
    location: float
    scale: float

    def __post_init__(self) -> None:
        require(self.sigma_data > 0, f"sigma_data = {self.sigma_data}: must be above 0")
        _check_range(self.sigma_min, self.sigma_max)
        require(self.scale > 0, f"scale = {self.scale}: must be above 0")


@dataclass(frozen=True)
class SamplingConfig:
    """How actions are generated from a trained model.

    Attributes:
        sampler, schedule: names in samplers.SAMPLERS and schedules.SCHEDULES.
        steps: number of denoising steps.
        sigma_min, sigma_max: range of the schedule.
        context: "clean" keeps the previous actions as executed; "published" pushes them through the sampler together
            with the new one, as the published code does (facts in docs/fidelity.md).
        context_length: time steps of the context in rollouts; null takes the training window.
    """

    sampler: Literal[
        "euler",
        "euler_ancestral",
        "heun",
        "ddim",
        "dpm_2",
        "dpm_2_ancestral",
        "dpmpp_2s",
        "dpmpp_2s_ancestral",
        "dpmpp_2m",
    ]
    schedule: Literal["exponential", "linear", "karras", "iddpm", "ve", "vp"]
    steps: int
    sigma_min: float
    sigma_max: float
    context: Literal["clean", "published"]
    context_length: int | None

    def __post_init__(self) -> None:
        require_positive(self, "steps", "context_length")
        _check_range(self.sigma_min, self.sigma_max)
        SCHEDULES[self.schedule](self.steps, self.sigma_min, self.sigma_max)  # some refuse too many steps


def _check_range(sigma_min: float, sigma_max: float) -> None:
    require(0 < sigma_min < sigma_max, f"sigma_min = {sigma_min}: must be above 0 and below sigma_max = {sigma_max}")


@functools.lru_cache
def _scales_of_one(sigma: float, sigma_data: float) -> list[float]:
    """c_skip, c_out, c_in and c_noise of a noise level, computed once: a sampler meets few of them."""
    return [value.item() for value in scales(torch.tensor(sigma), sigma_data)]


def validation_sampling(diffusion: DiffusionConfig) -> SamplingConfig:
    """The paper's default sampler over the training range; validation errors are measured with it."""
    return SamplingConfig("ddim", "exponential", 3, diffusion.sigma_min, diffusion.sigma_max, "clean", None)


class ScorePolicy(nn.Module):
    """Denoiser, loss and sampling around an inner network.

    Args:
        network: F, called as networks.transformer.ScoreTransformer is.
        diffusion, sampling: configurations of training noise and of action generation.
        goal_dropout: probability that a training sample loses its goal (zeros in scaled units).
        guidance_scale: lambda of classifier-free guidance: 1 conditional, 0 unconditional.
    """

    def __init__(
        self,
        network: nn.Module,
        diffusion: DiffusionConfig,
        sampling: SamplingConfig,
        goal_dropout: float = 0.0,
        guidance_scale: float = 1.0,
    ) -> None:
        super().__init__()
        self.network = network
        self.diffusion, self.sampling = diffusion, sampling
        self.goal_dropout, self.guidance_scale = goal_dropout, guidance_scale
        schedule = SCHEDULES[sampling.schedule]
        self.sigmas = schedule(sampling.steps, sampling.sigma_min, sampling.sigma_max).tolist()

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Denoising score matching (paper, Eq. 6 and Alg. 1), a scalar.

        sigma ~ p_train, one a window; eps ~ N(0, sigma^2); the squared error of D against the clean actions with the
        weight alpha(sigma) = 1 / c_out^2, as a mean over samples, steps and dimensions.
        """
        clean, config = batch.actions, self.diffusion
        dropout = generator if self.training else None
        uniform = torch.rand(len(clean), generator=generator, device=clean.device, dtype=torch.float64)
        density = DENSITIES[config.density]
        sigma = density(uniform, config.sigma_min, config.sigma_max, config.location, config.scale).to(clean.dtype)
        goal = batch.goal
        if self.goal_dropout and self.training:
            kept = torch.rand(len(goal), 1, 1, generator=generator, device=goal.device) >= self.goal_dropout
            goal = goal * kept
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
        batch, previous = len(observations), actions.shape[1]
        guided = self.guidance_scale not in (0.0, 1.0)
        if self.guidance_scale == 0:
            goal = torch.zeros_like(goal)
        elif guided:
            goal = torch.cat([goal, torch.zeros_like(goal)])
            observations, actions = torch.cat([observations, observations]), torch.cat([actions, actions])

        clean = self.sampling.context == "clean"

        def bound(a: Tensor, sigma: float) -> Tensor:
            """D with state and goal bound, on the current action (B, 1, A) or, as published, on all of them."""
            if clean:
                return self.denoise(torch.cat([actions, a], dim=1), sigma, observations, goal)
            return self.denoise(a, sigma, observations, goal, last_only=False)

        denoise: Denoise = classifier_free(bound, self.guidance_scale) if guided else bound
        action_size = actions.shape[-1]
        a = self.sigmas[0] * noise.normal(1, action_size)
        if not clean:
            a = torch.cat([actions[:batch], a], dim=1)
        noise_steps = 1 if clean else previous + 1
        sampler = SAMPLERS[self.sampling.sampler]
        return sampler(denoise, a, self.sigmas, lambda: noise.normal(noise_steps, action_size))[:, -1]
