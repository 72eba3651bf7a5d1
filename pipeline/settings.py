"""What params.yaml says, part by part: environments, their frames, cells, studies, methods."""

import re
from dataclasses import dataclass
from typing import Any, Literal

from beso.config import require, require_positive, shown
from beso.core.device import PrecisionOrAuto
from beso.core.training_config import ValidationConfig
from beso.encoders.resnet import Head, check_width
from beso.evaluation.config import EvaluationConfig
from beso.images.pretraining import Pretraining
from pipeline.recipes import CellPaths

NAME = re.compile("[a-z0-9_]+")  # of environments, methods, studies: dvc.yaml puts them into commands
MEANT_OTHERWISE = re.compile(r"[\\{}$%&#_^~\x00-\x1f]")  # by LaTeX or matplotlib
SHARED = ("all", "like")  # keys of a method's blocks beside the environments' names


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

    def __post_init__(self) -> None:
        for name in ("mean", "std"):
            numbers = getattr(self, name)
            require(len(numbers) == 3, f"{name} = {list(numbers)}: must be three numbers, of red, green and blue")
        require(min(self.std) > 0, f"std = {list(self.std)}: must be positive")


@dataclass(frozen=True)
class Features:
    """The encoder.

    Attributes:
        width, head: of the network, see beso.encoders.resnet.
        precision: "fp32", "bf16" for autocast, in training and afterwards, or "auto" for what the device is fast at.
        weights: if given, nothing is trained before.
        finetune: every policy trains its own copy on, as in the paper; else it is frozen.
    """

    width: int
    head: Head
    precision: PrecisionOrAuto
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
        relative_goals: policies get goals less the state, what is still to change.
        validation: measurements of the held-out loss.
    """

    train_fraction: float
    goal_horizon: int | None
    relative_goals: bool
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


@dataclass(frozen=True)
class CellEntry(CellPaths):
    """One method in one environment, as params.yaml names it.

    Attributes:
        of: the method's file in beso/methods.
        source: the folder of the play data; or of the models of another cell, its teacher.
        film: whether its first episode is filmed.
        seeds: some of the environment's; null is all.
    """

    of: str
    source: str
    film: bool = False
    seeds: tuple[int, ...] | None = None


@dataclass(frozen=True)
class StudyEntry:
    """A trained cell, sampled in several ways from the same starts and with the same noise.

    Attributes:
        env, method, of: the cell.
        rollouts: episodes a seed and goal set, the first of each.
        vary: values by parameter of the cell's sampling; every combination is played.
        goals: some of the evaluation's goal sets; null is the first, which is the paper's.
        seeds: some of the cell's; null is all.
    """

    env: str
    method: str
    of: str
    rollouts: int
    vary: dict[str, Any]
    goals: tuple[str, ...] | None = None
    seeds: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        require_positive(self, "rollouts")
        for name, values in self.vary.items():
            require(
                isinstance(values, list) and len(values) > 0 and all(v not in values[:i] for i, v in enumerate(values)),
                f"vary.{name} = {shown(values)}: must be a list of different values, at least one",
            )
        require(len(self.vary) > 0, "vary = {}: must name at least one parameter")


@dataclass(frozen=True)
class MethodEntry:
    """One method's blocks: by environment, for `all` of them, and the method that it is `like`.

    Attributes:
        label: the report's name.
        train, sample: apart, so that a change of sampling never retrains.
    """

    label: str
    train: dict[str, Any]
    sample: dict[str, Any]

    def __post_init__(self) -> None:
        require(
            0 < len(self.label) <= 40 and self.label.isprintable() and not MEANT_OTHERWISE.search(self.label),
            f"label = {shown(self.label)}: must have 1 to 40 characters, none of \\ {{ }} $ % & # _ ^ ~",
        )


@dataclass(frozen=True)
class Blocks:
    """The blocks that all methods begin with."""

    train: dict[str, Any]
    sample: dict[str, Any]


@dataclass(frozen=True)
class Latency:
    """How policy calls are timed: medians over `repeats` calls at each batch size."""

    repeats: int
    batches: tuple[int, ...]

    def __post_init__(self) -> None:
        require_positive(self, "repeats")
        require(
            len(self.batches) > 0 and min(self.batches) > 0,
            f"batches = {list(self.batches)}: must be positive, at least one",
        )


@dataclass(frozen=True)
class ForkEntry:
    """How long every method trains on the fork (see stages.fork), and how many actions are drawn."""

    updates: int
    samples: int

    def __post_init__(self) -> None:
        require_positive(self, "updates", "samples")


@dataclass(frozen=True)
class File:
    """The top of params.yaml."""

    profile: str
    seed: int
    all_environments: dict[str, Any]
    environments: dict[str, Any]
    images: dict[str, ImageParams]
    cells: dict[str, CellEntry]
    all_studies: dict[str, Any]
    studies: dict[str, Any]
    latency: Latency
    fork: ForkEntry
    all_methods: Blocks
    methods: dict[str, MethodEntry]

    def __post_init__(self) -> None:
        require(
            re.fullmatch("[a-z0-9-]+", self.profile) is not None,
            f"profile = {self.profile!r}: must be made of lower-case letters, digits and hyphens",
        )
        require(self.seed >= 0, f"seed = {self.seed}: must not be negative")
        require(len(self.cells) > 0, "cells = {}: at least one is needed")
        for part in ("environments", "methods", "studies"):
            for name in getattr(self, part):
                require(
                    NAME.fullmatch(name) is not None and name not in SHARED,
                    f"{part}.{name}: a name must be made of lower-case letters, digits and _, and not be all or like",
                )
        for name, cell in self.cells.items():
            require(
                name == cell.name,
                f"cells.{name}: its name must be env and method with a hyphen between, {cell.name}",
            )
        labels = [method.label for method in self.methods.values()]
        for name, method in self.methods.items():
            require(
                labels.count(method.label) == 1,
                f"methods.{name}: label = {shown(method.label)}: must be one that no other method has",
            )
