"""C-IBC: goal-conditioned implicit behaviour cloning (Florence et al. 2022; paper, "GC-IBC").

An MLP gives the energy of an action in a state for a goal. It is trained to tell the demonstrated action from random
ones, and actions are found by a search that needs no gradients.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.config import require, require_positive
from beso.core.memory import Memory
from beso.core.method import BaseMethod, ModelConfig, SamplingConfig
from beso.core.noise import Noise, categorical
from beso.data.scaling import CLIP
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.networks.mlp import MLP

GRADIENT_MARGIN = 1.0  # Florence et al.: the energy's slope is free up to here


@dataclass(frozen=True)
class Config(ModelConfig):
    """Size of the energy network and its loss.

    Attributes:
        width, layers: neurons a hidden layer and number of hidden layers.
        counter_examples: random actions for each demonstrated one.
        energy_penalty: weight of the mean squared energy.
        gradient_penalty: weight of what the slope of the energy exceeds GRADIENT_MARGIN by, squared.
    """

    width: int
    layers: int
    counter_examples: int
    energy_penalty: float
    gradient_penalty: float

    def __post_init__(self) -> None:
        require_positive(self, "width", "layers", "counter_examples")
        for name in ("energy_penalty", "gradient_penalty"):
            require(getattr(self, name) >= 0, f"{name} = {getattr(self, name)}: must not be negative")

    @property
    def window(self) -> int:
        """The energy looks at the current state alone."""
        return 1


@dataclass(frozen=True)
class Sampling(SamplingConfig):
    """The derivative-free search (Florence et al. 2022, Alg. 1).

    Attributes:
        candidates: actions in the search.
        iterations: rounds of resampling and perturbing; the last candidates' energies are looked at once more.
        noise_scale: standard deviation of what the first round adds; it is multiplied by noise_shrink every round.
    """

    candidates: int
    iterations: int
    noise_scale: float
    noise_shrink: float

    def __post_init__(self) -> None:
        require_positive(self, "candidates")
        require(self.iterations >= 0, f"iterations = {self.iterations}: must not be negative")
        require(self.noise_scale > 0, f"noise_scale = {self.noise_scale}: must be above 0")
        require(0 < self.noise_shrink <= 1, f"noise_shrink = {self.noise_shrink}: must be in (0, 1]")


VALIDATION = Sampling(candidates=256, iterations=2, noise_scale=0.3, noise_shrink=0.5)


class Method(nn.Module, BaseMethod):
    """The policy. See beso.core.method.BaseMethod."""

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__()
        self.config, self.sampling = config, sampling or VALIDATION
        inputs = sizes.observation * (1 + sizes.goal_window) + sizes.action
        self.network = MLP(inputs, 1, config.width, config.layers, 0.0, generator)

    def energy(self, observation: Tensor, goal: Tensor, actions: Tensor) -> Tensor:
        """(B, O), (B, G, O), (B, N, A) -> energies (B, N) of N actions in each state."""
        condition = torch.cat([observation, goal.flatten(1)], dim=1)
        condition = condition[:, None].expand(-1, actions.shape[1], -1)
        return self.network(torch.cat([condition, actions], dim=-1)).squeeze(-1).float()

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """InfoNCE, energy penalty and gradient penalty, a scalar.

        Counter-examples are uniform in the box that actions are clipped to. InfoNCE is the cross entropy of picking
        the demonstrated action out of all by softmax(-E).
        """
        config, demonstrated = self.config, batch.actions[:, -1:]
        size, _, action_size = demonstrated.shape
        shape = (size, config.counter_examples, action_size)
        uniform = torch.rand(shape, generator=generator, device=demonstrated.device)
        actions = torch.cat([demonstrated, CLIP * (2 * uniform - 1)], dim=1)
        with torch.enable_grad():
            actions.requires_grad_(config.gradient_penalty > 0)
            energy = self.energy(batch.observations[:, -1], batch.goal, actions)
            loss = info_nce(energy) + config.energy_penalty * energy.square().mean()
            if config.gradient_penalty:
                (slope,) = torch.autograd.grad(energy.sum(), actions, create_graph=True)
                excess = (slope.abs().amax(dim=-1) - GRADIENT_MARGIN).clamp(min=0)
                loss = loss + config.gradient_penalty * excess.square().mean()
        return loss

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> (B, A)."""
        sampling, action_size = self.sampling, actions.shape[-1]
        candidates = CLIP * (2 * noise.uniform(sampling.candidates, action_size) - 1)
        scale = sampling.noise_scale
        for _ in range(sampling.iterations):
            energy = self.energy(observations[:, -1], goal, candidates)
            chosen = categorical((-energy).softmax(dim=1), noise.uniform(sampling.candidates))
            candidates = candidates.gather(1, chosen[..., None].expand_as(candidates))
            candidates = (candidates + scale * noise.normal(*candidates.shape[1:])).clamp(-CLIP, CLIP)
            scale *= sampling.noise_shrink
        best = self.energy(observations[:, -1], goal, candidates).argmin(dim=1)
        return candidates[torch.arange(len(best), device=best.device), best]


def info_nce(energy: Tensor) -> Tensor:
    """(B, 1 + N) energies, the demonstrated action's first -> mean of -log softmax(-E) of the first."""
    return functional.cross_entropy(-energy, energy.new_zeros(len(energy), dtype=torch.long))
