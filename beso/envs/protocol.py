"""What an environment's room offers, as types; and what several protocols of evaluation share."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from beso.core.seeding import integer_seed
from beso.data import play
from beso.data.play import Episode, PlayDataset
from beso.data.spec import PlaySpec
from beso.data.split import model_split

if TYPE_CHECKING:
    import gymnasium
    import pandas as pd
    import torch
    from matplotlib.figure import Figure

Recorder = Callable[[int, int], Episode]  # (root seed, index of the demonstration)
Filmer = Callable[[int], tuple[list[np.ndarray], dict[str, Any]]]  # root seed -> pictures (H, W, 3), what they show
Importer = Callable[[Path], PlayDataset]
Encoder = Callable[[np.ndarray], np.ndarray]  # raw observations (B, ...) -> what the spec describes, (B, O)


class Recording(Protocol):
    """How raw play comes to be: the module `beso.envs.<name>.demonstrations.recording`."""

    def record(self, seed: int, index: int, length: int, size: int, folder: Path) -> int:
        """Record episode `index` with frames of `size` pixels into a folder, unless it is there; its steps.

        There are `length` of them, or fewer.
        """

    def join(self, parts: list[Path], folder: Path, seed: int) -> None:
        """Write the raw play made of recorded episodes."""

    def film(self, folder: Path) -> tuple[list[np.ndarray], dict[str, Any]]:
        """Pictures (H, W, 3) of some raw play in a folder, and what they show, under "shows"."""

    def convert(self, published: Path, folder: Path, size: int, workers: int) -> None:
        """Write the raw play of published data."""

    def export(self, play: Any, folder: Path, form: str) -> None:
        """Write raw play, as `Raw.load` gives it, in a form that others use."""


class RawPlay(Protocol):
    """Raw play in memory, memory-mapped; its frames lie in `frames.npy` beside the rest.

    `meta` may name "held_out_episodes", where the data come with a split.
    """

    meta: dict[str, Any]
    episode_ends: np.ndarray

    def __len__(self) -> int:
        """Number of episodes."""

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """What is packed with the frames, by the names in beso.images.frames.COLUMNS."""


class Raw(Protocol):
    """How raw play is read: the module `beso.envs.<name>.demonstrations.raw`."""

    def load(self, folder: Path) -> RawPlay:
        """Read and check raw play."""


class TrialRequest(NamedTuple):
    """Which trials are wanted.

    Attributes:
        goals: one of the spec's goal sets.
        model_seed: number of the model that plays them.
        numbers: their numbers; trial i depends on i alone, not on the others asked for.
        seed: root of evaluation's random numbers.
        data: the play data's folder.
        train_fraction, root_seed: what decides which demonstrations that model was trained on (beso.data.split).
        tasks: what trials for single tasks ask for in turn, in environments whose spec has SINGLE_TASKS.
    """

    goals: str
    model_seed: int
    numbers: range
    seed: int
    data: Path
    train_fraction: float
    root_seed: int
    tasks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Trial:
    """One episode before it is played.

    Attributes:
        seed, options: for the environment's `reset`, which answers with `info["goal"]`, (G, ...) raw goal states. All
            trials of an environment have the same options, of the same shapes.
        tasks: tasks that the goal asks for, positions in the spec's list.
        limit: the largest number of actions.
        labels: columns of the episode's row.
    """

    seed: int
    options: dict[str, np.ndarray]
    tasks: tuple[int, ...]
    limit: int
    labels: dict[str, int | str]


@dataclass
class Outcome:
    """What came of a trial: the sum of rewards, the number of actions, the last raw observation and info, the goal, and
    the first raw observation."""

    reward: float
    length: int
    observation: np.ndarray
    info: dict[str, Any]
    goal: np.ndarray
    start: np.ndarray


class States(Protocol):
    """An environment with states for images: the module `beso.envs.<name>.states`.

    Attributes:
        SPEC: of states.
        LENGTH: steps of a stretch of play.
        record: one stretch.
        make_trials: as the module `trials` makes them, with states for goals.
        make: an environment whose observations are states.
    """

    SPEC: PlaySpec
    LENGTH: int
    record: Recorder
    make_trials: TrialMaker
    make: Callable[[], gymnasium.Env]


class Evaluation(Protocol):
    """How policies are evaluated in an environment: the module `beso.envs.<name>.evaluation`."""

    def make(self, render_mode: str | None = None) -> gymnasium.Env:
        """An environment; its episodes depend on their reset alone."""

    def score(self, trial: Trial, outcome: Outcome) -> dict[str, Any]:
        """Further columns of the episode's row, among them every metric of the report."""

    def encoder(self, data: Path, device: torch.device) -> Encoder:
        """What stands between the environment's observations and the policy; `data` is the play data's folder."""


class Metric(NamedTuple):
    """A column of evaluation rows: its name, the paper's name for it, its largest value."""

    name: str
    label: str
    maximum: float


class Drawing(NamedTuple):
    """A figure of the report: the name of its file, what it shows in a sentence, and itself."""

    name: str
    caption: str
    figure: Figure


class Table(NamedTuple):
    """A table of the report: its LaTeX label, what it shows in a sentence, column heads, rows of text and numbers."""

    name: str
    caption: str
    columns: tuple[str, ...]
    rows: list[tuple[Any, ...]]


Episodes = Mapping[str, "pd.DataFrame"]  # rows of evaluation by the methods' labels, in the report's order


TrialMaker = Callable[[TrialRequest], list[Trial]]


def identity(observations: np.ndarray) -> np.ndarray:
    """The encoder of environments whose observations are states."""
    return observations


def demonstration_trials(request: TrialRequest, spec: PlaySpec, limit: int) -> list[Trial]:
    """Trials whose goals are the last states of demonstrations: "training" ones, as in the paper, or "held_out" ones.

    The goal of trial i is that of demonstration i of the set, counted round; `reset` gets it as the option "goal".

    Raises:
        UserError: the play data are missing or damaged.
    """
    dataset = play.load(request.data, spec)
    split = model_split(len(dataset), request.train_fraction, request.root_seed, request.model_seed)
    candidates = split[0 if request.goals == "training" else 1]
    trials = []
    for i in request.numbers:
        demonstration = int(candidates[i % len(candidates)])
        end, tasks = dataset.episode_ends[demonstration], dataset.completed(demonstration)
        trials.append(
            Trial(
                seed=integer_seed(request.seed, f"start, {request.goals} goals", request.model_seed, i),
                options={"goal": np.array(dataset.observations[end - spec.goal_window : end])},
                tasks=tasks,
                limit=limit,
                labels={"goal_demonstration": demonstration, "goal_tasks": " ".join(map(str, tasks))},
            )
        )
    return trials
