"""`beso bench stages METHOD` measures where each stage's cost grows, and extrapolates it.

It runs every stage on one core at three sizes, REPEATS times each, with the paper's networks, batches and frames, and
prints a Markdown table: medians, and a straight line through them at the size of a thousand seeds or of a hundred hours
of frames. It takes about ten minutes, works in temporary folders, and needs no data. The first environment of the
paper's profile stands for those whose policies see states, the first with images for the others.
"""

import contextlib
import importlib
import multiprocessing
import os
import resource
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import torch
from ruamel.yaml import YAML

from beso import envs
from beso.data import play
from beso.data.play import PlayDataset
from pipeline import paths, profile
from pipeline.params import PATH, Params
from pipeline.report.statistics import over_seeds

REPEATS = 3
SEEDS, ROLLOUTS = 1000, 100
FRAMES = 100 * 3600 * 30  # a hundred hours at CALVIN's rate
STRETCH = 50  # frames of a recorded stretch of play
PLAY_EPISODE = 500  # steps of an episode of made-up features
COLUMNS = ["stage", "at sizes", "s", "peak memory, MiB", "written, MiB", "at", "core-hours", "memory, GiB", "disk, GiB"]
START, INTERVAL = "train, start", "tables, one interval"
GROWING = (START, INTERVAL)  # peak memory is a straight line, too; of the others the largest measured is given
Work = Callable[[int], None]  # of one size, in the working folder


class Part(NamedTuple):
    """A stage, or a part of one.

    Attributes:
        name, unit: what is measured, and what its cost grows with.
        sizes, target: numbers of units, measured and extrapolated to.
        key: of params.yaml, dotted, that is the size; "": there is none.
        work: the last is measured, the others are what it needs.
    """

    name: str
    unit: str
    sizes: tuple[int, int, int]
    target: int
    key: str
    work: tuple[Work, ...]


def stage(name: str, arguments: tuple[str, ...], _: int) -> None:
    """Run a stage as dvc.yaml does; its size stands in params.yaml."""
    importlib.import_module(f"stages.{name}").main(*arguments)


def write_features(environment: str, steps: int) -> None:
    """Play data of that many steps, in episodes, of noise."""
    spec, rng = envs.spec(environment), np.random.default_rng(0)
    observations, actions = (rng.random((steps, n), np.float32) for n in (spec.observation_size, spec.action_size))
    tasks, ends = np.zeros((steps, len(spec.tasks)), np.uint8), np.arange(PLAY_EPISODE, steps + 1, PLAY_EPISODE)
    play.save(PlayDataset(observations, actions, tasks, ends, {"source": "none"}), paths.play(environment))


def interval(environment: str, seeds: int) -> None:
    """The interval of one number of the tables."""
    metric, scores = envs.report(environment).METRICS[0], np.random.default_rng(0).random(seeds * ROLLOUTS)
    over_seeds(pd.DataFrame({"seed": np.repeat(np.arange(seeds), ROLLOUTS), metric.name: scores}), metric)


def parts(paper: Params, states: str, images: str, method: str) -> list[Part]:
    updates = paper.methods[method].train[states].optimization.steps
    collect, record = partial(stage, "collect", (states,)), partial(stage, "collect", (images,))
    pack, encode = partial(stage, "preprocess", (images,)), partial(stage, "features", (images,))
    train, make_trials = partial(stage, "train", (states, method)), partial(stage, "trials", (states,))
    evaluate, first_update = partial(stage, "evaluate", (states, method)), partial(stage, "train", (images, method))
    demonstrations, stretches = (f"environments.{name}.collect.demonstrations" for name in (states, images))
    rollouts, steps = (
        f"environments.{states}.evaluation.rollouts",
        f"methods.{method}.train.{states}.optimization.steps",
    )
    recorded = (f"stretches of {STRETCH} frames", (2, 4, 8), FRAMES // STRETCH, stretches)
    played, zeros = SEEDS * 2 * ROLLOUTS, partial(write_features, images)
    return [
        Part("collect, states", "demonstrations", (4, 8, 16), 1000, demonstrations, (collect,)),
        Part("collect, images", *recorded, (record,)),
        Part("preprocess", *recorded, (record, pack)),
        Part("features", *recorded, (record, pack, encode)),
        Part("train, states", "updates", (1, 2, 4), SEEDS * updates, steps, (collect, train)),
        Part(START, "steps of play", (20_000, 40_000, 80_000), FRAMES, "", (zeros, first_update)),
        Part("trials", "episodes", (1000, 2000, 4000), played, rollouts, (collect, make_trials)),
        Part("evaluate", "episodes", (4, 8, 12), played, rollouts, (collect, make_trials, train, evaluate)),
        Part(INTERVAL, "seeds", (50, 100, 200), SEEDS, "", (partial(interval, states),)),
    ]


def _changes(paper: Params, states: str, images: str, method: str) -> dict[str, Any]:
    """What makes the paper's parameters one small seed on one core, by dotted key."""
    changes: dict[str, Any] = {"machine.workers": 1, "machine.device": "cpu", "studies": {}, "films": {}}
    for name in (states, images):
        of = f"environments.{name}"
        changes |= {
            f"{of}.seeds": [1],
            f"{of}.collect.demonstrations": 4,
            f"{of}.training.train_fraction": 0.5,
            f"{of}.training.validation.windows": 64,
            f"{of}.evaluation.rollouts": 4,
            f"{of}.evaluation.chunk": 4,
            f"{of}.evaluation.goals": list(paper.environments[name].evaluation.goals[:1]),
            f"methods.{method}.train.{name}.optimization.steps": 1,
        }
    changes[f"environments.{images}.collect.camera.length"] = STRETCH
    encoder = f"images.{images}.features"
    return changes | {
        f"{encoder}.pretraining.steps": 2,
        f"{encoder}.pretraining.batch_size": 8,
        f"{encoder}.precision": "fp32",
    }


def _write_parameters(text: str, changes: dict[str, Any]) -> None:
    yaml = YAML()
    values = yaml.load(text)
    for key, value in changes.items():
        *parents, last = key.split(".")
        inner = values
        for name in parents:
            inner = inner[name]
        inner[last] = value
    with PATH.open("w", encoding="utf-8") as file:
        yaml.dump(values, file)


def _run(work: Work, size: int) -> tuple[float, float]:
    """Seconds of some work and its peak memory, bytes, in this process and folder."""
    torch.set_num_threads(1)
    start = time.perf_counter()
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
        work(size)
    return time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _median(part: Part, size: int, text: str, changes: dict[str, Any]) -> tuple[float, float, float]:
    """Seconds and peak memory, medians over repeats in processes of their own, and bytes written."""

    def run(work: Work) -> tuple[float, float]:
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            return pool.apply(_run, (work, size))

    def written() -> int:
        return sum(path.stat().st_size for path in Path().rglob("*") if path.is_file())

    home = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        try:
            _write_parameters(text, changes | ({part.key: size} if part.key else {}))
            for work in part.work[:-1]:
                run(work)
            before = written()
            found = [run(part.work[-1]) for _ in range(REPEATS)]
            seconds, memory = (statistics.median(values) for values in zip(*found, strict=True))
            return seconds, memory, written() - before
        finally:
            os.chdir(home)


def _row(part: Part, measured: np.ndarray) -> list[str]:
    """A row of the table, from (3 sizes, 3) seconds, peak memory and bytes."""
    slopes, starts = np.polyfit(part.sizes, measured, 1)
    seconds, memory, disk = slopes * part.target + starts
    memory = memory if part.name in GROWING else measured[:, 1].max()
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


def bench(method: str) -> None:
    """Print the table. Raises UserError if the paper's profile lacks the method in an environment."""
    paper, text = profile.load(profile.COMPLETE), profile.render(profile.COMPLETE)
    setting = (next(e for e in paper.envs if e not in paper.images), next(iter(paper.images)), method)
    for environment in setting[:2]:
        paper.cell(environment, method)
    changes = _changes(paper, *setting)
    print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|", flush=True)
    for part in parts(paper, *setting):
        measured = np.array([_median(part, size, text, changes) for size in part.sizes])
        print("| " + " | ".join(_row(part, measured)) + " |", flush=True)
