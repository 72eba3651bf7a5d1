"""What params.yaml says of an environment: its play, its frames, training and evaluation."""

from dataclasses import dataclass
from typing import Literal

from beso.config import require, require_positive
from beso.core.training_config import ValidationConfig
from beso.encoders.resnet import check_width
from beso.evaluation.config import EvaluationConfig
from beso.images.pretraining import Pretraining


@dataclass(frozen=True)
class Camera:
    """How play is recorded where policies see images.

    Attributes:
        length: steps of an episode, at most.
        size: height and width of the frames, pixels.
    """

    length: int
    size: int

    def __post_init__(self) -> None:
        require_positive(self, "length", "size")


@dataclass(frozen=True)
class Collect:
    """Where play data comes from: scripted demonstrations made here, or published files in a local folder.

    Attributes:
        to: "play", a play dataset; or "raw", raw play, where policies see images.
        demonstrations: how many, of `camera.length` steps each where there is a camera.
        camera: for raw play.
    """

    to: Literal["play", "raw"]
    source: Literal["scripted", "published"]
    demonstrations: int
    folder: str | None
    camera: Camera | None = None

    def __post_init__(self) -> None:
        require((self.to == "raw") == (self.camera is not None), f"camera is missing or out of place: to = {self.to}")
        require(self.demonstrations >= 2, f"demonstrations = {self.demonstrations}: must be at least 2")
        require(self.source == "scripted" or bool(self.folder), "folder = null: source published needs a folder")


@dataclass(frozen=True)
class Preprocess:
    """How raw frames are packed.

    Attributes:
        size: height and width, pixels.
        held_out: share of the episodes that the encoder is not trained on; published data with a split keep theirs.
    """

    size: int
    held_out: float

    def __post_init__(self) -> None:
        require_positive(self, "size")
        require(0 < self.held_out < 1, f"held_out = {self.held_out}: must be between 0 and 1")


@dataclass(frozen=True)
class Weights:
    """Given weights of an encoder, torchvision's for instance.

    Attributes:
        path, sha256: a .safetensors or .pth file.
        mean, std: of red, green and blue in [0, 1], as in its training.
    """

    path: str
    sha256: str
    mean: tuple[float, ...]
    std: tuple[float, ...]


@dataclass(frozen=True)
class Features:
    """The encoder.

    Attributes:
        width: channels of its first stage, see beso.encoders.resnet.
        precision: "fp32", "bf16" for autocast, in training and afterwards, or "auto" for what the device is fast at.
        weights: if given, nothing is trained before.
        finetune: every policy trains its own copy on, as in the paper; else it is frozen.
    """

    width: int
    precision: Literal["auto", "fp32", "bf16"]
    weights: Weights | None
    pretraining: Pretraining
    finetune: bool

    def __post_init__(self) -> None:
        check_width(self.width)
        untrained = self.pretraining.steps == 0 and self.weights is None
        require(self.finetune or not untrained, "pretraining.steps = 0: must be at least 1 unless finetune is true")


@dataclass(frozen=True)
class ImageParams:
    """What turns the frames of one environment into features."""

    preprocess: Preprocess
    features: Features


@dataclass(frozen=True)
class Training:
    """What all methods share in training.

    Attributes:
        train_fraction: share of the demonstrations; the rest is held out.
        goal_horizon: the largest number of steps from a training window to its goal; null is the demonstration's rest.
        validation: measurements of the held-out loss.
    """

    train_fraction: float
    goal_horizon: int | None
    validation: ValidationConfig

    def __post_init__(self) -> None:
        require(0 < self.train_fraction < 1, f"train_fraction = {self.train_fraction}: must be between 0 and 1")
        require_positive(self, "goal_horizon")


@dataclass(frozen=True)
class Trials:
    """Which episodes are made: for each model seed, with goals of the demonstrations that it was trained on or not."""

    seeds: tuple[int, ...]
    train_fraction: float
    evaluation: EvaluationConfig


@dataclass(frozen=True)
class EnvironmentParams:
    """What all cells of one environment share.

    Attributes:
        seeds: one trained model each.
    """

    seeds: tuple[int, ...]
    collect: Collect
    training: Training
    evaluation: EvaluationConfig

    def __post_init__(self) -> None:
        require(
            len(set(self.seeds)) == len(self.seeds) > 0 and min(self.seeds) >= 0,
            f"seeds = {list(self.seeds)}: must be different numbers from 0 upward, at least one",
        )
