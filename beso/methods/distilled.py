"""C-BESO in fewer network calls: a student of a trained C-BESO (Luhman & Luhman 2021, "Knowledge Distillation in
Iterative Generative Models for Improved Sampling Speed").

From one noise, teacher and student solve the probability-flow ODE (paper, Eq. 3) with DDIM on exponential steps:

    teacher    sigma_max -> .. -> sigma_min -> 0        `teacher_steps` calls
    student    sigma_max (-> .. -> sigma_min) -> 0      `steps` calls, from the teacher's weights

The student learns to end where the teacher does. Actions of the demonstrations are only the context; a policy that is
asked for one action at a time needs no other noise levels than those it stops at. Targets have no noise, so that there
is no dropout.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from beso.config import require, require_positive
from beso.core.method import ModelConfig
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.diffusion.score_policy import Acting, DenoiserConfig, DiffusionConfig, ScorePolicy
from beso.networks.transformer import ScoreTransformer


@dataclass(frozen=True)
class Config(DenoiserConfig):
    """Network and noise range, which are the teacher's, and the number of calls.

    Attributes:
        steps: denoising steps of the student.
        teacher_steps: denoising steps of the teacher, at least as many.
    """

    diffusion: DiffusionConfig
    steps: int
    teacher_steps: int

    def __post_init__(self) -> None:
        super().__post_init__()
        require_positive(self, "steps")
        require(
            self.teacher_steps >= self.steps,
            f"teacher_steps = {self.teacher_steps}: must be at least steps = {self.steps}",
        )

    def check_teacher(self, teacher: ModelConfig | None) -> None:
        """The teacher must have the same network and noise."""
        require(teacher is not None, "needs a teacher, not play data")
        for name in ("transformer", "diffusion"):
            own, other = getattr(self, name), getattr(teacher, name, None)
            require(other == own, f"the teacher's {name} is {other} and the student's {own}; they must be the same")


SAMPLING = "beso.sampling.diffusion:StudentSampling"


class Method(ScorePolicy):
    """The student. See beso.core.method.BaseMethod."""

    def __init__(self, config: Config, sampling: Acting | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__(
            ScoreTransformer(config.transformer, *sizes, generator=generator),
            config.diffusion,
            sampling,
        )
        self.steps = config.steps
        self.levels, self.teacher_levels = (
            _levels(steps, config.diffusion) for steps in (config.steps, config.teacher_steps)
        )
        self.taught: Callable[..., Tensor] | None = None

    def learn_from(self, teacher: ScorePolicy) -> None:
        """Start from the teacher's weights; its own stay as they are."""
        self.load_state_dict(teacher.state_dict())
        # In a function, as copies of the student must not copy the teacher, nor its state dict have it.
        levels = self.teacher_levels
        self.taught = lambda *inputs: _solve(teacher, levels, *inputs)

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Mean squared distance of the student's scaled action from the teacher's, a scalar.

        Samples have contexts of 1 to the window's steps in turn, as contexts grow at the start of an episode.
        """
        assert self.taught is not None, "no teacher"
        count, window, size = batch.actions.shape
        noise = torch.randn(count, 1, size, generator=generator, device=batch.actions.device)
        total = torch.zeros((), device=noise.device)
        for length in range(1, min(window, count) + 1):
            rows = slice(length - 1, None, window)
            context = self.diffusion.action_range * batch.actions[rows, : length - 1]
            inputs = (
                self.diffusion.sigma_max * noise[rows],
                context,
                batch.observations[rows, :length],
                batch.goal[rows],
            )
            with torch.no_grad():
                target = self.taught(*inputs)
            total = total + (_solve(self, self.levels, *inputs) - target).square().sum()
        return total / (count * size * self.diffusion.action_range**2)


def _levels(steps: int, diffusion: DiffusionConfig) -> list[float]:
    """The exponential schedule: `steps` noise levels from sigma_max to sigma_min (one alone is sigma_max), then 0."""
    return [*np.geomspace(diffusion.sigma_max, diffusion.sigma_min, steps).tolist(), 0.0]


def _solve(
    policy: ScorePolicy, levels: list[float], a: Tensor, context: Tensor, observations: Tensor, goal: Tensor
) -> Tensor:
    """DDIM from noise (B, 1, A) at levels[0] to the action (B, 1, A) that follows its context (B, T - 1, A).

    As beso.sampling.diffusion with this sampler (a test compares them), which training must not depend on.
    """
    for sigma, to in itertools.pairwise(levels):
        denoised = policy.denoise(torch.cat([context, a], dim=1), sigma, observations, goal)
        a = (to / sigma) * a + (1 - to / sigma) * denoised
    return a
