"""LMP: latent motor plans (Lynch et al. 2020) in HULC's variant (Mees et al. 2022; paper, "Latent Motor Plans").

A conditional variational autoencoder over windows of play. Plan recognition sees the whole window and encodes what is
done in it into a latent plan z; the plan prior must guess z from the first state and the goal; a recurrent decoder
turns states, plan and goal into actions:

    training     z ~ q(z | s_1 .. s_W)       a_t ~ p(a | s_1 .. s_t, z, g)     NLL + beta KL(q || prior)
    acting       z ~ p(z | s, g)  every `replan` steps, when the decoder's state starts anew too

Plans are Gaussian with independent entries. The KL divergence is balanced: most of its gradient moves the prior. Goals
are later states, as for every method; Lynch et al.'s are the windows' ends, which say nothing of goals that are far.
"""

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.config import require, require_positive, require_rate
from beso.core.memory import Memory, replans
from beso.core.method import BaseMethod, ModelConfig, SamplingConfig
from beso.core.noise import Noise
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.networks import logistic_mixture
from beso.networks.layers import dropout
from beso.networks.mlp import MLP
from beso.networks.sequence import SequenceTransformer

KL_BALANCE = 0.8  # share of the KL divergence's gradient that moves the prior (HULC)
SMALLEST_STD = 0.1  # Hafner et al.'s (2019); with HULC's 1e-4 a single batch's divergence can grow beyond 1e6


@dataclass(frozen=True)
class Config(ModelConfig):
    """Sizes of the four parts.

    Attributes:
        window: states in a training window.
        plan: entries of a latent plan.
        recognition_width, recognition_layers, recognition_heads, recognition_dropout: plan recognition's transformer.
        prior_width, prior_layers: the plan prior's MLP.
        decoder_width, decoder_layers, decoder_dropout: the recurrent decoder; dropout between its layers.
        mixtures, classes: the discretised logistic mixture of an action's entries.
        kl_beta: weight of the KL divergence.
    """

    window: int
    plan: int
    recognition_width: int
    recognition_layers: int
    recognition_heads: int
    recognition_dropout: float
    prior_width: int
    prior_layers: int
    decoder_width: int
    decoder_layers: int
    decoder_dropout: float
    mixtures: int
    classes: int
    kl_beta: float

    def __post_init__(self) -> None:
        require_positive(self, "plan", "recognition_width", "recognition_layers", "recognition_heads", "prior_width")
        require_positive(self, "window", "prior_layers", "decoder_width", "decoder_layers", "mixtures")
        require(
            self.recognition_width % self.recognition_heads == 0,
            f"recognition_heads = {self.recognition_heads}: must divide recognition_width = {self.recognition_width}",
        )
        require_rate(self, "recognition_dropout", "decoder_dropout")
        require(self.classes >= 2, f"classes = {self.classes}: must be at least 2")
        require(self.kl_beta >= 0, f"kl_beta = {self.kl_beta}: must not be negative")

    @property
    def context(self) -> int:
        """What came before is in the decoder's state."""
        return 1


@dataclass(frozen=True)
class Sampling(SamplingConfig):
    """How the policy acts.

    Attributes:
        replan: steps between two plans.
    """

    replan: int

    def __post_init__(self) -> None:
        require_positive(self, "replan")


class Gaussian(NamedTuple):
    """Independent normal distributions, mean and standard deviation (..., Z)."""

    mean: Tensor
    std: Tensor

    def detach(self) -> "Gaussian":
        """The same without gradients."""
        return Gaussian(self.mean.detach(), self.std.detach())


class Method(nn.Module, BaseMethod):
    """The policy, see BaseMethod. It remembers plan, decoder state and steps since the episode's start."""

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__()
        self.config, self.replan = config, sampling.replan if sampling else 1
        state, goal = sizes.observation, sizes.observation * sizes.goal_window
        self.recognition = SequenceTransformer(
            inputs=state,
            outputs=2 * config.plan,
            longest=config.window,
            width=config.recognition_width,
            layers=config.recognition_layers,
            heads=config.recognition_heads,
            dropout_rate=config.recognition_dropout,
            causal=False,
            generator=generator,
        )
        self.prior = MLP(state + goal, 2 * config.plan, config.prior_width, config.prior_layers, 0.0, generator)
        widths = [state + config.plan + goal] + [config.decoder_width] * config.decoder_layers
        self.decoder = nn.ModuleList(
            nn.RNN(inputs, config.decoder_width, nonlinearity="relu", batch_first=True) for inputs in widths[:-1]
        )
        self.head = nn.Linear(config.decoder_width, sizes.action * config.mixtures * 3)
        bound = config.decoder_width**-0.5
        with torch.no_grad():
            for part in (self.decoder, self.head):
                for parameter in part.parameters():
                    parameter.uniform_(-bound, bound, generator=generator)  # PyTorch's default

    def _plan_prior(self, observation: Tensor, goal: Tensor) -> Gaussian:
        return _gaussian(self.prior(torch.cat([observation, goal.flatten(1)], dim=1)))

    def _decode(
        self,
        observations: Tensor,
        plan: Tensor,
        goal: Tensor,
        hidden: Tensor | None = None,
        generator: torch.Generator | None = None,
    ) -> tuple[logistic_mixture.LogisticMixture, Tensor]:
        """(B, T, O), (B, Z), (B, G, O), hidden (B, layers, width) -> mixtures (B, T, A, M) and the new hidden."""
        constant = torch.cat([plan, goal.flatten(1)], dim=1)[:, None].expand(-1, observations.shape[1], -1)
        x, states = torch.cat([observations, constant], dim=-1), []
        for i, layer in enumerate(self.decoder):
            if i:
                x = dropout(x, self.config.decoder_dropout, generator)
            x, state = layer(x, None if hidden is None else hidden[:, i][None].contiguous())
            states.append(state[0])
        mixture = logistic_mixture.from_outputs(self.head(x).float(), self.config.mixtures)
        return mixture, torch.stack(states, dim=1)

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Negative log-likelihood, added over an action's entries, and balanced KL divergence, a scalar."""
        drops = generator if self.training else None
        recognised = _gaussian(self.recognition(batch.observations, drops).mean(dim=1))
        prior = self._plan_prior(batch.observations[:, 0], batch.goal)
        eps = torch.randn(recognised.mean.shape, generator=generator, device=recognised.mean.device)
        plan = recognised.mean + recognised.std * eps
        mixture, _ = self._decode(batch.observations, plan, batch.goal, generator=drops)
        likelihood = logistic_mixture.negative_log_likelihood(mixture, batch.actions, self.config.classes)
        return likelihood.sum(dim=-1).mean() + self.config.kl_beta * balanced_kl(recognised, prior)

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> (B, A). Of the context, only the last state counts."""
        current, action_size = observations[:, -1], actions.shape[-1]
        prior = self._plan_prior(current, goal)
        fresh = prior.mean + prior.std * noise.normal(self.config.plan)
        silent = fresh.new_zeros(len(fresh), self.config.decoder_layers, self.config.decoder_width)
        due = replans(memory, self.replan, current)
        plan = torch.where(due, fresh, memory.get("plan", fresh))
        hidden = torch.where(due[..., None], silent, memory.get("hidden", silent))
        mixture, hidden = self._decode(current[:, None], plan, goal, hidden)
        memory.update(plan=plan, hidden=hidden)
        one = logistic_mixture.LogisticMixture(*(part[:, 0] for part in mixture))
        return logistic_mixture.sample(one, noise.uniform(action_size, 2))


def _gaussian(outputs: Tensor) -> Gaussian:
    """(..., 2 Z) outputs of a network -> a distribution of Z numbers."""
    mean, spread = outputs.float().chunk(2, dim=-1)
    return Gaussian(mean, functional.softplus(spread) + SMALLEST_STD)


def kl_divergence(q: Gaussian, p: Gaussian) -> Tensor:
    """KL(q || p), entries added, (...)."""
    ratio = (q.std / p.std).square()
    return 0.5 * (ratio + ((q.mean - p.mean) / p.std).square() - 1 - ratio.log()).sum(dim=-1)


def balanced_kl(recognised: Gaussian, prior: Gaussian) -> Tensor:
    """The mean KL divergence; its gradient moves the prior with KL_BALANCE and recognition with the rest (HULC)."""
    to_prior = kl_divergence(recognised.detach(), prior).mean()
    to_recognition = kl_divergence(recognised, prior.detach()).mean()
    return KL_BALANCE * to_prior + (1 - KL_BALANCE) * to_recognition
