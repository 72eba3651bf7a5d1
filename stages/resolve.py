"""params.yaml, checked and resolved: a file for each stage and cell with the parameters that are its own."""

import dataclasses
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from beso.config import build
from beso.files import replacing, write_text
from pipeline.params import Params, load
from pipeline.recipes import (
    FOLDER,
    EnvironmentRecipe,
    ForkMethod,
    ForkRecipe,
    LatencyRecipe,
    fork_method,
)
from pipeline.settings import Trials
from pipeline.yaml import read_yaml

FORK = Path("profiles/fork.yaml")


def main() -> None:
    params = load()
    with replacing(FOLDER) as temporary:
        for name, recipe in recipes(params):
            # Not sorted: the order of what a study varies is that of its rows' columns.
            write_text(temporary / f"{name}.json", json.dumps(dataclasses.asdict(recipe), indent=1) + "\n")


def recipes(params: Params) -> Iterator[tuple[str, Any]]:
    """Every stage's parameters, by the name of its file. Raises UserError if profiles/fork.yaml is wrong."""
    for env, block in params.environments.items():
        trials = Trials(block.seeds, block.training.train_fraction, block.evaluation)
        yield f"collect/{env}", EnvironmentRecipe(env, params.seed, block.collect)
        yield f"trials/{env}", EnvironmentRecipe(env, params.seed, trials)
    for env, images in params.images.items():
        yield f"preprocess/{env}", EnvironmentRecipe(env, params.seed, images.preprocess)
        yield f"features/{env}", EnvironmentRecipe(env, params.seed, images.features)
    for cell in params.cells.values():
        yield f"train/{cell.env}/{cell.method}", cell.train
        yield f"evaluate/{cell.env}/{cell.method}", cell.evaluate
    for name, study in params.studies.items():
        yield f"study/{name}", study
    assert params.fork is not None  # as in every params.yaml
    yield "latency", LatencyRecipe(params.latency.repeats, params.latency.batches, tuple(params.cells))
    on_fork = {name: build(ForkMethod, block, f"{FORK}.{name}") for name, block in read_yaml(FORK).items()}
    checked = {name: fork_method(name, block, str(FORK)) for name, block in on_fork.items()}
    yield "fork", ForkRecipe(params.seed, params.fork.updates, params.fork.samples, checked)
    yield "report", params
