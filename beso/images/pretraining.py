"""Self-supervised training of the encoder on play frames, before any policy.

Two objectives, each with a weight; both see pairs of frames of one episode, up to `horizon` steps apart.

inverse dynamics   which action was taken in the first frame, from the features of both: what moves because of the arm
reconstruction     the frame itself at 28 x 28 pixels, by one linear map from its features. Every pixel counts in units
                   of its own standard deviation, so that a lamp, a few pixels that seldom change, weighs as much as the
                   arm. Colours are brightness and two opponent colours, so that what is colourful, blocks and lamps,
                   is not drowned by what is bright, the arm

A killed run continues from its last saved state and ends with the same bytes.
"""

import logging
import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional
from tqdm import trange

from beso.config import require, require_positive
from beso.core.seeding import torch_generator
from beso.encoders.encoder import Encoding, shifted, untrained
from beso.encoders.resnet import FEATURES, ResNet18
from beso.errors import UserError
from beso.images.frames import PackedPlay, resize
from beso.networks.mlp import MLP
from beso.training.loop_state import LoopState

log = logging.getLogger(__name__)

OPPONENT_COLOURS: Final = np.array([[1, 1, 1], [1, -1, 0], [1, 1, -2]]) / np.sqrt(
    [[3], [2], [6]]
)  # an orthonormal basis
GRID: Final = 28  # pixels: the LED of the play table still covers a few
LEAST_DEVIATION: Final = 4.0  # grey levels; below it a pixel is constant but for rounding
STATISTICS_FRAMES: Final = 1024
DYNAMICS_WIDTH: Final = 256
WARM_UP: Final = 50  # steps
MEASUREMENTS: Final = 10  # a training


@dataclass(frozen=True)
class Pretraining:
    """How an encoder is trained.

    Attributes:
        steps, batch_size: updates, 0 for random weights, and pairs of frames an update.
        learning_rate, weight_decay: of AdamW; the rate rises for 50 steps and then falls to 0 as a cosine.
        inverse_dynamics, reconstruction: weights of the two objectives; 0 leaves one out.
        horizon: the largest number of steps between two frames.
        shift: the largest random shift of a pair, pixels.
    """

    steps: int
    batch_size: int
    learning_rate: float
    weight_decay: float
    inverse_dynamics: float
    reconstruction: float
    horizon: int
    shift: int

    def __post_init__(self) -> None:
        require(self.steps >= 0, f"steps = {self.steps}: must not be negative")
        require_positive(self, "batch_size", "horizon")
        require(self.learning_rate > 0, f"learning_rate = {self.learning_rate}: must be above 0")
        for name in ("weight_decay", "inverse_dynamics", "reconstruction", "shift"):
            require(getattr(self, name) >= 0, f"{name} = {getattr(self, name)}: must not be negative")
        require(self.inverse_dynamics + self.reconstruction > 0, "inverse_dynamics and reconstruction are both 0")

    def learning_rate_at(self, step: int) -> float:
        """The learning rate of update `step`, counted from 0."""
        return self.learning_rate * min(1, (step + 1) / WARM_UP) * (1 + math.cos(math.pi * step / self.steps)) / 2


class Objectives(nn.Module):
    """The encoder and what the objectives add to it, dropped after training.

    Args:
        network: the encoder.
        actions: size of an action.
        generator: source of the initial weights of what is added.
    """

    def __init__(self, network: ResNet18, actions: int, generator: torch.Generator) -> None:
        super().__init__()
        self.network = network
        self.dynamics = MLP(2 * FEATURES, actions, DYNAMICS_WIDTH, 1, 0.0, generator)
        self.decoder = nn.Linear(FEATURES, GRID * GRID * 3)
        with torch.no_grad():
            self.decoder.weight.normal_(0, 1 / math.sqrt(FEATURES), generator=generator)
            self.decoder.bias.zero_()

    def losses(self, features: Tensor, actions: Tensor, pictures: Tensor) -> tuple[Tensor, Tensor]:
        """Mean squared errors of both objectives.

        Args:
            features: (2 B, 512), of the first frames of all pairs, then of the second ones.
            actions: (B, A) standardised, taken in the first frames.
            pictures: (2 B, 28 * 28 * 3) standardised.
        """
        predicted = self.dynamics(torch.cat(features.chunk(2), dim=1))
        return functional.mse_loss(predicted, actions), functional.mse_loss(self.decoder(features), pictures)


class Pairs:
    """Pairs of frames of the training episodes, drawn at random."""

    def __init__(self, play: PackedPlay, config: Pretraining) -> None:
        training, self._ends = ~play.held_out, play.ends
        # A frame needs a later one in its episode.
        self._first = np.flatnonzero(training & (np.arange(len(play)) < self._ends - 1))
        if not len(self._first):
            raise UserError("no training episode has two frames")
        self._play, self._config = play, config
        deviation = np.asarray(play.actions[training], dtype=np.float64).std(axis=0)
        self._action_scale = np.where(deviation > 0, deviation, 1)
        rows = np.flatnonzero(training)
        chosen = rows[np.linspace(0, len(rows) - 1, min(STATISTICS_FRAMES, len(rows))).astype(int)]
        sample = small_pictures(play.frames.read(chosen))
        self._mean, self._deviation = sample.mean(axis=0), np.maximum(sample.std(axis=0), LEAST_DEVIATION)

    def sample(self, draws: torch.Generator) -> tuple[np.ndarray, Tensor, Tensor]:
        """One batch: frames (2 B, H, W, 3) uint8, and the actions and pictures that `Objectives.losses` wants."""
        config = self._config

        def integers(high: np.ndarray) -> np.ndarray:
            """From 0 to before `high`."""
            uniform = torch.rand(high.shape, generator=draws, dtype=torch.float64).numpy()
            return (uniform * high).astype(np.int64)

        first = self._first[integers(np.full(config.batch_size, len(self._first)))]
        second = first + 1 + integers(np.minimum(config.horizon, self._ends[first] - 1 - first))
        corners = integers(np.full((config.batch_size, 2), 2 * config.shift + 1))
        frames = self._play.frames.read(np.concatenate([first, second]))
        pictures = (small_pictures(frames) - self._mean) / self._deviation
        actions = self._play.actions[first] / self._action_scale
        return (
            shifted(frames, np.concatenate([corners, corners]), config.shift),
            torch.from_numpy(actions.astype(np.float32)),
            torch.from_numpy(pictures.astype(np.float32)).flatten(1),
        )


def small_pictures(frames: np.ndarray) -> np.ndarray:
    """(B, H, W, 3) uint8 RGB -> (B, 28, 28, 3) in opponent colours, grey levels."""
    return resize(frames, GRID) @ OPPONENT_COLOURS.T


def pretrain(
    play: PackedPlay,
    encoding: Encoding,
    config: Pretraining,
    seed: int,
    device: torch.device,
    state_path: Path,
    save_seconds: float = 60.0,
) -> tuple[ResNet18, list[dict[str, float]]]:
    """Train an encoder, continuing from `state_path` where that file exists; it is the caller's to delete.

    Returns:
        The encoder, and the mean losses since the last measurement by step.

    Raises:
        UserError: no training episode has two frames, or the loss is not finite.
    """
    pairs = Pairs(play, config)
    generator = torch_generator(seed, "initial encoder weights")
    model = Objectives(untrained(encoding, generator), play.actions.shape[1], generator)
    model = model.to(device).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(
        model.parameters(), lr=config.learning_rate, weight_decay=config.weight_decay, fused=True
    )
    draws = torch_generator(seed, "pretraining")
    loss_sums = torch.zeros(2, device=device)
    loop = LoopState({"model": model}, [optimizer], draws, loss_sums)
    first_step, curve = loop.load(state_path)
    if first_step:
        log.info("encoder: continuing at step %d", first_step)
    weights = torch.tensor([config.inverse_dynamics, config.reconstruction], device=device)
    every = math.ceil(config.steps / MEASUREMENTS)
    saved_at = time.monotonic()

    for step in trange(first_step, config.steps, initial=first_step, total=config.steps, desc="encoder", disable=None):
        optimizer.param_groups[0]["lr"] = config.learning_rate_at(step)
        frames, actions, pictures = pairs.sample(draws)
        standardised = encoding.standardise(torch.from_numpy(frames).to(device))
        with torch.autocast(device.type, torch.bfloat16, enabled=encoding.precision == "bf16"):
            features = model.network(standardised)
        losses = torch.stack(model.losses(features.float(), actions.to(device), pictures.to(device)))
        (losses @ weights).backward()
        optimizer.step()
        optimizer.zero_grad()
        loss_sums += losses.detach()

        done = step + 1
        if done % every == 0 or done == config.steps:
            dynamics, reconstruction = (loss_sums / (done - (curve[-1]["step"] if curve else 0))).tolist()
            loss_sums.zero_()
            curve.append({"step": done, "inverse_dynamics": dynamics, "reconstruction": reconstruction})
            if not math.isfinite(dynamics + reconstruction):
                raise UserError(f"encoder: the loss is not finite after {done} steps; lower learning_rate")
            log.info(
                "encoder: step %d/%d, inverse dynamics %.4f, reconstruction %.4f",
                *(done, config.steps, dynamics, reconstruction),
            )
        if time.monotonic() - saved_at >= save_seconds:
            loop.save(state_path, done, curve)
            saved_at = time.monotonic()
    return model.network, curve
