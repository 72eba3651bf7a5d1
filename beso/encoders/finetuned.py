"""An encoder that is trained together with a policy, as in the paper, instead of being frozen before.

Samples name their frames by step (beso.data.windows); the frames are read when a batch needs them, shifted at random,
all states and the goal of a window alike, and encoded:

    steps (B, W + G)  ->  distinct pictures (M, size, size, 3)  ->  features (M, 512)  ->  the policy's (B, W + G, 512)

A picture's features are brought to mean 0 and variance 1 over themselves (Ba et al. 2016, without parameters): the
statistics of a data set, by which frozen features are scaled, would be those of an encoder that is no more.

Batch normalisation uses the statistics of the batch while it trains. The averaged weights, which are evaluated, need
others than the last batches': they are measured anew, on training frames, whenever the averaged weights are measured or
saved (Izmailov et al. 2018). They follow from the weights alone, so that a resumed training finds the same.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from beso.encoders import encoder
from beso.encoders.encoder import DESCRIPTION, Encoding, shifted
from beso.encoders.resnet import FEATURES, ResNet18
from beso.errors import UserError
from beso.files import read_json

if TYPE_CHECKING:
    from beso.data.play import PlayDataset
    from beso.data.scaling import Scaling
    from beso.data.windows import Batch

PART: Final = 128  # pictures encoded at a time without gradients: memory
STATISTICS_FRAMES: Final = 1024  # on which batch normalisation is measured


class Normalised(nn.Module):
    """A ResNet-18 and the normalisation of its features."""

    def __init__(self, network: ResNet18) -> None:
        super().__init__()
        self.network = network

    def forward(self, pictures: Tensor) -> Tensor:
        """(B, 3, H, W) standardised -> (B, 512) float32."""
        return functional.layer_norm(self.network(pictures).float(), (FEATURES,))


class Finetuned(nn.Module):
    """Policy and encoder as one, as far as training asks (beso.core.method.BaseMethod).

    Args:
        policy: a policy that sees features.
        network: where the encoder starts; it is changed.
        encoding: how frames are given to it.
        shift: the largest random shift, pixels.
        read: the frames (M, H, W, 3) uint8 of some steps (M,).
        statistics: steps on whose frames batch normalisation is measured.
        scaling: tells whether goals are relative.
    """

    def __init__(
        self,
        policy: Any,
        network: ResNet18,
        encoding: Encoding,
        shift: int,
        read: Callable[[np.ndarray], np.ndarray],
        statistics: np.ndarray,
        scaling: Scaling,
    ) -> None:
        super().__init__()
        self.policy, self.encoder = policy, Normalised(network)
        self.encoding, self.shift = encoding, shift
        self._read, self._statistics, self._scaling = read, statistics, scaling
        self._norms = [module for module in network.modules() if isinstance(module, nn.BatchNorm2d)]
        for norm in self._norms:
            norm.momentum = None  # of all batches since a reset, each counts the same

    def prepare(self, actions: Tensor, seed: int) -> None:
        """See beso.core.method.BaseMethod."""
        self.policy.prepare(actions, seed)

    def schedule(self, done: float) -> bool:
        """See beso.core.method.BaseMethod."""
        return self.policy.schedule(done)

    def loss(self, batch: Batch, generator: torch.Generator) -> Tensor:
        """The policy's loss of a batch whose states and goals are steps (B, ..., 1).

        States after the window are targets, or stand for goals; no gradient goes through them. Otherwise an encoder
        could make them easy to predict, by making all pictures alike.
        """
        window = batch.observations.shape[1]
        shifts = torch.zeros(len(batch.actions), 2, dtype=torch.long, device=batch.actions.device)
        if self.training:
            size = (len(shifts), 2)
            shifts = torch.randint(-self.shift, self.shift + 1, size, generator=generator, device=shifts.device)
        seen = self._encode(torch.cat([batch.observations, batch.goal], dim=1)[..., 0], shifts)
        future = batch.future
        if future.numel():
            with torch.no_grad():
                future = self._encode(future[..., 0], shifts)
        states, goal = seen[:, :window], self._scaling.seen_goals(seen[:, window:], seen)
        return self.policy.loss(batch._replace(observations=states, goal=goal, future=future), generator)

    def _encode(self, steps: Tensor, shifts: Tensor) -> Tensor:
        """Features (B, T, 512) of the frames of some steps (B, T), each sample's shifted by its own (B, 2) pixels.

        A picture that stands in a sample several times is encoded once; without shifts, one in the whole batch.
        """
        samples = torch.arange(len(steps), device=steps.device)[:, None].expand_as(steps)
        pictures = torch.stack([samples if self.training else torch.zeros_like(samples), steps], dim=-1)
        distinct, places = pictures.flatten(0, 1).unique(dim=0, return_inverse=True)
        count = 1 if torch.is_grad_enabled() else -(-len(distinct) // PART)
        features = [self._features(part[:, 1], shifts[part[:, 0]]) for part in distinct.tensor_split(count)]
        return torch.cat(features).index_select(0, places).unflatten(0, steps.shape)

    def _features(self, steps: Tensor, shifts: Tensor) -> Tensor:
        corners = (self.shift + shifts).cpu().numpy()
        frames = shifted(self._read(steps.cpu().numpy()), corners, self.shift)
        pictures = self.encoding.standardise(torch.from_numpy(frames).to(steps.device))
        # Weights are cast anew each time: those cast without gradients must not serve where there are some.
        enabled = self.encoding.precision == "bf16"
        with torch.autocast(steps.device.type, torch.bfloat16, enabled=enabled, cache_enabled=False):
            return self.encoder(pictures)

    @torch.no_grad()
    def settle(self) -> None:
        """Measure the statistics of batch normalisation with the weights as they are."""
        for norm in self._norms:
            norm.reset_running_stats()
            norm.train()
        device = next(self.parameters()).device
        steps = torch.from_numpy(self._statistics).to(device)
        for part in steps.tensor_split(-(-len(steps) // PART)):
            self._features(part, part.new_zeros(len(part), 2))
        for norm in self._norms:
            norm.eval()


def join(policy: Any, folder: Path, dataset: PlayDataset, episodes: np.ndarray, scaling: Scaling) -> Finetuned:
    """A policy with the encoder in a folder, for training on some episodes of a dataset of frames.

    Raises:
        UserError: the encoder is missing or damaged, or is a frozen one.
    """
    shift = read_json(folder / DESCRIPTION).get("shift")
    if not isinstance(shift, int) or shift < 0:
        raise UserError(f"{folder / DESCRIPTION}: shift = {shift!r}: must be a number of pixels")
    start = encoder.load(folder, torch.device("cpu"))
    chosen = np.isin(np.arange(len(dataset)), episodes)
    steps = np.flatnonzero(np.repeat(chosen, dataset.lengths))
    spread = steps[np.linspace(0, len(steps) - 1, min(STATISTICS_FRAMES, len(steps))).astype(int)]

    def read(rows: np.ndarray) -> np.ndarray:  # a function, as copies of the model must not copy a map of all frames
        return np.asarray(dataset.observations[rows])

    return Finetuned(policy, start.network, start.encoding, shift, read, spread, scaling)


def modules(policy: nn.Module, encoding: Encoding) -> nn.ModuleDict:
    """A policy and an encoder whose weights have the names that they have in Finetuned."""
    network = encoder.untrained(encoding, torch.Generator())  # initial weights, to be overwritten
    return nn.ModuleDict({"policy": policy, "encoder": Normalised(network)})
