"""C-BeT: the conditional behaviour transformer (Cui et al. 2023, after Shafiullah et al. 2022; paper, "C-BeT").

Actions are clustered into bins before training. A causal transformer over goals and states predicts, at every state,
the bin of its action and the action's offset from the centre of each bin; acting draws a bin and adds its offset.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.config import require, require_positive, require_rate
from beso.core.memory import Memory
from beso.core.method import BaseMethod, ContextSampling, ModelConfig
from beso.core.noise import Noise, categorical
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.errors import UserError
from beso.networks.sequence import SequenceTransformer

FOCUS = 2.0  # gamma of the focal loss (Lin et al. 2017)


@dataclass(frozen=True)
class Config(ModelConfig):
    """The network, the bins, and the loss.

    Attributes:
        width, layers, heads: size of a token, number of blocks and of attention heads.
        window: largest number of states.
        dropout: rate on embeddings, attention and residuals.
        bins: number of clusters.
        offset_weight: weight of the offset's mean squared error, in scaled actions.
    """

    width: int
    layers: int
    heads: int
    window: int
    dropout: float
    bins: int
    offset_weight: float

    def __post_init__(self) -> None:
        require_positive(self, "width", "layers", "heads", "window", "bins")
        require(self.width % self.heads == 0, f"heads = {self.heads}: must divide width = {self.width}")
        require_rate(self, "dropout")
        require(self.offset_weight > 0, f"offset_weight = {self.offset_weight}: must be above 0")


Sampling = ContextSampling  # the bin is always drawn


class Method(nn.Module, BaseMethod):
    """The policy. See beso.core.method.BaseMethod."""

    centres: Tensor

    def __init__(self, config: Config, sampling: Sampling | None, sizes: Sizes, generator: torch.Generator) -> None:
        super().__init__()
        self.offset_weight, self.goal_window = config.offset_weight, sizes.goal_window
        self.network = SequenceTransformer(
            inputs=sizes.observation,
            outputs=config.bins * (1 + sizes.action),
            longest=sizes.goal_window + config.window,
            width=config.width,
            layers=config.layers,
            heads=config.heads,
            dropout_rate=config.dropout,
            causal=True,
            generator=generator,
        )
        self.register_buffer("centres", torch.zeros(config.bins, sizes.action))  # (K, A)

    def prepare(self, actions: Tensor, seed: int) -> None:
        """Find the bins by k-means.

        Args:
            actions: (N, A) scaled.
            seed: of the clustering.

        Raises:
            UserError: there are fewer actions than bins.
        """
        from sklearn.cluster import KMeans
        from threadpoolctl import threadpool_limits

        if len(actions) < len(self.centres):
            raise UserError(
                f"bins = {len(self.centres)}: must be at most the number of training actions, {len(actions)}"
            )
        with threadpool_limits(1):  # the order of its sums, and so their rounding, depends on the number of threads
            found = KMeans(len(self.centres), n_init=1, random_state=seed % 2**32).fit(actions.double().cpu().numpy())
        self.centres.copy_(torch.from_numpy(found.cluster_centers_))

    def _predict(
        self, observations: Tensor, goal: Tensor, dropout: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        """(B, T, O), (B, G, O) -> logits (B, T, K) and offsets (B, T, K, A)."""
        outputs = self.network(torch.cat([goal, observations], dim=1), dropout)[:, self.goal_window :].float()
        bins, action_size = self.centres.shape
        logits, offsets = outputs.split([bins, bins * action_size], dim=-1)
        return logits, offsets.unflatten(-1, (bins, action_size))

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """Focal loss of the bin and squared error of the true bin's offset, over all states of the window, a scalar."""
        logits, offsets = self._predict(batch.observations, batch.goal, generator if self.training else None)
        bins = torch.cdist(batch.actions, self.centres.expand(len(batch.actions), -1, -1)).argmin(dim=-1)  # (B, T)
        rows = bins[..., None, None].expand(*bins.shape, 1, self.centres.shape[1])
        offset_error = offsets.gather(2, rows).squeeze(2) - (batch.actions - self.centres[bins])
        return focal_loss(logits, bins) + self.offset_weight * offset_error.square().mean()

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """(B, T, O), (B, T-1, A), (B, G, O) -> (B, A)."""
        logits, offsets = self._predict(observations, goal)
        drawn = categorical(logits[:, -1].softmax(dim=-1), noise.uniform(1)).squeeze(1)
        return self.centres[drawn] + offsets[torch.arange(len(drawn), device=drawn.device), -1, drawn]


def focal_loss(logits: Tensor, classes: Tensor) -> Tensor:
    """Mean of -(1 - p)^gamma log p of the true class (Lin et al. 2017).

    Args:
        logits: (..., K).
        classes: (...) indices.
    """
    log_probability = -functional.cross_entropy(logits.flatten(0, -2), classes.flatten(), reduction="none")
    return -((1 - log_probability.exp()) ** FOCUS * log_probability).mean()
