"""`python -m pipeline.tools.scaling METHOD` measures where each stage's cost grows, and extrapolates it.

It runs every stage on one core at three sizes, REPEATS times each, with the paper's networks, batches and frames, and
prints a Markdown table: medians, and a straight line through them at the size of a thousand seeds or of a hundred hours
of frames. It takes about ten minutes, works in temporary folders, and needs no data. The first environment of the
paper's profile stands for those whose policies see states, the first with images for the others.
"""

import contextlib
import dataclasses
import multiprocessing
import os
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from beso import envs
from beso.data import play
from beso.data.play import PlayDataset
from pipeline import paths, profile
from pipeline.cells.collect import collect
from pipeline.cells.evaluation import evaluate_cell
from pipeline.cells.features import make_features
from pipeline.cells.preprocess import preprocess
from pipeline.cells.training import train_cell
from pipeline.cells.trials import make_trials
from pipeline.params import Params
from pipeline.report.statistics import over_seeds
from pipeline.stage import run

REPEATS = 3
SEEDS, ROLLOUTS = 1000, 100
FRAMES = 100 * 3600 * 30  # a hundred hours at CALVIN's rate
EPISODE = 50  # steps of a recorded stretch of play
PLAY_EPISODE = 500  # steps of an episode of made-up features


@dataclass(frozen=True)
class Setting:
    """What is measured: a method in an environment of states, an environment of images, a profile to start from."""

    states: str
    images: str
    method: str
    paper: Params


@dataclass(frozen=True)
class Part:
    """A stage, or a part of one.

    Attributes:
        name, unit: what is measured, and what its cost grows with.
        sizes: numbers of units.
        target: the number to extrapolate to.
        work: runs it at one size, in the working directory.
        before: what it needs, not measured.
        memory_grows: whether peak memory is a straight line, too; otherwise the largest measured is given.
    """

    name: str
    unit: str
    sizes: tuple[int, int, int]
    target: int
    work: Callable[[Setting, int], None]
    before: tuple[Callable[[Setting, int], None], ...] = ()
    memory_grows: bool = False


def _parameters(
    setting: Setting,
    environment: str,
    steps: int = 1,
    rollouts: int = 4,
    demonstrations: int = 4,
) -> Params:
    """The paper's, with one seed and with these sizes, on one core."""
    paper = setting.paper
    machine = dataclasses.replace(paper.machine, workers=1, device="cpu")
    block = paper.environments[environment]
    camera = block.collect.camera and dataclasses.replace(block.collect.camera, length=EPISODE)
    block = dataclasses.replace(
        block,
        seeds=(1,),
        collect=dataclasses.replace(block.collect, demonstrations=demonstrations, camera=camera),
        training=dataclasses.replace(
            block.training, train_fraction=0.5, validation=dataclasses.replace(block.training.validation, windows=64)
        ),
        evaluation=dataclasses.replace(block.evaluation, rollouts=rollouts, chunk=4, goals=block.evaluation.goals[:1]),
    )
    images = {}
    for name, settings in paper.images.items():
        pretraining = dataclasses.replace(settings.features.pretraining, steps=2, batch_size=8)
        features = dataclasses.replace(settings.features, pretraining=pretraining, precision="fp32")
        images[name] = dataclasses.replace(settings, features=features)
    method = paper.methods[setting.method]
    config = method.train[environment]
    config = dataclasses.replace(config, optimization=dataclasses.replace(config.optimization, steps=steps))
    method = dataclasses.replace(method, train={**method.train, environment: config})
    return dataclasses.replace(
        paper,
        machine=machine,
        environments={**paper.environments, environment: block},
        images=images,
        methods={**paper.methods, setting.method: method},
    )


def collect_states(setting: Setting, demonstrations: int) -> None:
    collect(_parameters(setting, setting.states, demonstrations=demonstrations), setting.states)


def four_demonstrations(setting: Setting, _: int) -> None:
    collect_states(setting, 4)


def record_frames(setting: Setting, frames: int) -> None:
    collect(_parameters(setting, setting.images, demonstrations=frames // EPISODE), setting.images)


def pack_frames(setting: Setting, _: int) -> None:
    preprocess(_parameters(setting, setting.images), setting.images)


def encode_frames(setting: Setting, _: int) -> None:
    make_features(_parameters(setting, setting.images), setting.images)


def train_updates(setting: Setting, updates: int) -> None:
    train_cell(_parameters(setting, setting.states, steps=updates), setting.states, setting.method)


def one_update(setting: Setting, _: int) -> None:
    train_updates(setting, 1)


def write_features(setting: Setting, steps: int) -> None:
    """Play data of that many steps, in episodes, of zeros and noise."""
    spec, rng = envs.spec(setting.images), np.random.default_rng(0)
    observations, actions = (rng.random((steps, n), np.float32) for n in (spec.observation_size, spec.action_size))
    tasks = np.zeros((steps, len(spec.tasks)), np.uint8)
    ends = np.arange(PLAY_EPISODE, steps + 1, PLAY_EPISODE)
    play.save(PlayDataset(observations, actions, tasks, ends, {"source": "none"}), paths.play(setting.images))


def train_on_features(setting: Setting, _: int) -> None:
    train_cell(_parameters(setting, setting.images, steps=1), setting.images, setting.method)


def play_trials(setting: Setting, episodes: int) -> None:
    make_trials(_parameters(setting, setting.states, rollouts=episodes), setting.states)


def play_episodes(setting: Setting, episodes: int) -> None:
    evaluate_cell(_parameters(setting, setting.states, rollouts=episodes), setting.states, setting.method)


def estimate(setting: Setting, seeds: int) -> None:
    """The interval of one number of the tables."""
    metric = envs.report(setting.states).METRICS[0]
    rng = np.random.default_rng(0)
    table = pd.DataFrame({"seed": np.repeat(np.arange(seeds), ROLLOUTS), metric.name: rng.random(seeds * ROLLOUTS)})
    over_seeds(table, metric)


def parts(setting: Setting) -> list[Part]:
    updates = setting.paper.methods[setting.method].train[setting.states].optimization.steps
    packed = (record_frames, pack_frames)
    return [
        Part("collect, states", "demonstrations", (4, 8, 16), 1000, collect_states),
        Part("collect, images", "frames", (100, 200, 400), FRAMES, record_frames),
        Part("preprocess", "frames", (100, 200, 400), FRAMES, pack_frames, packed[:1]),
        Part("features", "frames", (100, 200, 400), FRAMES, encode_frames, packed),
        Part("train, states", "updates", (1, 2, 4), SEEDS * updates, train_updates, (four_demonstrations,)),
        Part(
            "train, start",
            "steps of play",
            (20_000, 40_000, 80_000),
            FRAMES,
            train_on_features,
            (write_features,),
            True,
        ),
        Part("trials", "episodes", (1000, 2000, 4000), SEEDS * 2 * ROLLOUTS, play_trials, (four_demonstrations,)),
        Part(
            "evaluate",
            "episodes",
            (4, 8, 12),
            SEEDS * 2 * ROLLOUTS,
            play_episodes,
            (four_demonstrations, play_trials, one_update),
        ),
        Part("tables, one interval", "seeds", (50, 100, 200), SEEDS, estimate, (), True),
    ]


def measure(work: Callable[[Setting, int], None], setting: Setting, size: int) -> tuple[float, float]:
    """Seconds of some work and its peak memory, bytes, in this process and directory."""
    torch.set_num_threads(1)
    start = time.perf_counter()
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        work(setting, size)
    return time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _written() -> int:
    return sum(path.stat().st_size for path in Path().rglob("*") if path.is_file())


def _median(part: Part, setting: Setting, size: int) -> tuple[float, float, float]:
    """Seconds and peak memory, medians over repeats in processes of their own, and bytes written."""
    context, home = multiprocessing.get_context("spawn"), Path.cwd()

    def in_process(work: Callable[[Setting, int], None]) -> tuple[float, float]:
        with context.Pool(1) as pool:
            return pool.apply(measure, (work, setting, size))

    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            for work in part.before:
                in_process(work)
            before = _written()
            found = [in_process(part.work) for _ in range(REPEATS)]
            seconds, memory = (statistics.median(values) for values in zip(*found, strict=True))
            return seconds, memory, _written() - before
        finally:
            os.chdir(home)


def _row(part: Part, setting: Setting) -> list[Any]:
    """A row of the table."""
    measured = np.array([_median(part, setting, size) for size in part.sizes])
    slopes, starts = np.polyfit(part.sizes, measured, 1)
    seconds, memory, disk = slopes * part.target + starts
    memory = memory if part.memory_grows else measured[:, 1].max()
    return [
        part.name,
        f"{part.unit}: " + ", ".join(f"{size:,}" for size in part.sizes),
        ", ".join(f"{value:.2f}" for value in measured[:, 0]),
        ", ".join(f"{value / 2**20:.0f}" for value in measured[:, 1]),
        ", ".join(f"{value / 2**20:.2f}" for value in measured[:, 2]),
        f"{part.target:,}",
        f"{seconds / 3600:,.2f}",
        f"{memory / 2**30:,.1f}",
        f"{disk / 2**30:,.2f}",
    ]


COLUMNS = ["stage", "at sizes", "s", "peak memory, MiB", "written, MiB", "at", "core-hours", "memory, GiB", "disk, GiB"]


def main(method: str) -> None:
    paper = profile.load(profile.COMPLETE)
    setting = Setting(next(e for e in paper.envs if e not in paper.images), next(iter(paper.images)), method, paper)
    for environment in (setting.states, setting.images):
        paper.cell(environment, method)  # says which there are
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|", flush=True)
    for part in parts(setting):
        print("| " + " | ".join(_row(part, setting)) + " |", flush=True)


if __name__ == "__main__":
    run(main, "method")
