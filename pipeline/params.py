"""params.yaml as frozen objects, checked as a whole before any work.

`python -m pipeline.params` checks the file and says so.
"""

import dataclasses
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beso import methods
from beso.config import build, require, require_positive
from beso.data.spec import spec
from beso.errors import UserError
from beso.evaluation_config import EvaluationConfig
from beso.training_config import TrainingConfig, TrainingJob, ValidationConfig

PATH = Path("params.yaml")


@dataclass(frozen=True)
class Machine:
    """What the machine offers. Only the page reruns for it; of results, only rounding and draws depend on `device`."""

    workers: int
    device: Literal["auto", "cpu", "cuda"]
    save_seconds: float

    def __post_init__(self) -> None:
        require(self.workers >= 0, f"workers = {self.workers}: must be 0 (one a processor) or more")
        require(self.save_seconds >= 0, f"save_seconds = {self.save_seconds}: must not be negative")


@dataclass(frozen=True)
class Grid:
    """The cells of the comparison: every method in every environment."""

    envs: tuple[str, ...]
    methods: tuple[str, ...]

    def __post_init__(self) -> None:
        for name in ("envs", "methods"):
            values = getattr(self, name)
            require(len(set(values)) == len(values) > 0, f"{name} = {list(values)}: must be different, at least one")


@dataclass(frozen=True)
class Collect:
    """Where play data comes from: scripted demonstrations made here, or published files in a local folder."""

    source: Literal["scripted", "published"]
    demonstrations: int
    folder: str | None

    def __post_init__(self) -> None:
        require(self.demonstrations >= 2, f"demonstrations = {self.demonstrations}: must be at least 2")
        require(self.source == "scripted" or bool(self.folder), "folder = null: source published needs a folder")


@dataclass(frozen=True)
class Training:
    """What all methods share in training."""

    train_fraction: float
    validation: ValidationConfig

    def __post_init__(self) -> None:
        require(0 < self.train_fraction < 1, f"train_fraction = {self.train_fraction}: must be between 0 and 1")


@dataclass(frozen=True)
class Latency:
    """How policy calls are timed: medians over `repeats` calls at each batch size."""

    repeats: int
    batches: tuple[int, ...]

    def __post_init__(self) -> None:
        require_positive(self, "repeats")


@dataclass(frozen=True)
class Fork:
    """How long every method trains on the fork (see pipeline.fork), and how many actions are drawn."""

    updates: int
    samples: int

    def __post_init__(self) -> None:
        require_positive(self, "updates", "samples")


@dataclass(frozen=True)
class MethodParams:
    """One method's parameters by environment, split so that a change of sampling never retrains."""

    train: dict[str, TrainingConfig]
    sample: dict[str, Any]


@dataclass(frozen=True)
class Params:
    """The whole of params.yaml."""

    profile: str
    seed: int
    seeds: tuple[int, ...]
    machine: Machine
    grid: Grid
    collect: dict[str, Collect]
    training: Training
    evaluation: EvaluationConfig
    latency: Latency
    fork: Fork
    methods: dict[str, MethodParams]

    def __post_init__(self) -> None:
        require(
            re.fullmatch("[a-z0-9-]+", self.profile) is not None,
            f"profile = {self.profile!r}: must be made of lower-case letters, digits and hyphens",
        )
        require(self.seed >= 0, f"seed = {self.seed}: must not be negative")
        require(
            len(set(self.seeds)) == len(self.seeds) > 0 and min(self.seeds) >= 0,
            f"seeds = {list(self.seeds)}: must be different numbers from 0 upward, at least one",
        )

    def job(self, environment: str, method: str, seed: int) -> TrainingJob:
        """The training run of one model. Raises UserError for a cell that params.yaml does not have."""
        return TrainingJob(
            method=method,
            config=self._cell(environment, method).train[environment],
            validation=self.training.validation,
            train_fraction=self.training.train_fraction,
            root_seed=self.seed,
            seed=seed,
        )

    def sampling(self, environment: str, method: str) -> Any:
        """How one method generates actions in one environment. Raises UserError as `job` does."""
        return self._cell(environment, method).sample[environment]

    def _cell(self, environment: str, method: str) -> MethodParams:
        spec(environment)
        if method not in self.methods:
            raise UserError(f"method {method!r} is not in {PATH}: {', '.join(self.methods)} are")
        block = self.methods[method]
        if environment not in block.train or environment not in block.sample:
            raise UserError(f"{PATH}.methods.{method} has no environment {environment!r}")
        return block


def read_yaml(path: Path) -> Any:
    """Read a YAML 1.2 file (PyYAML would read 1e-4 as text and `on` as true; DVC does not).

    Raises:
        UserError: the file is missing or is not YAML.
    """
    try:
        return YAML(typ="safe").load(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise UserError(f"{path} is missing") from None
    except YAMLError as error:
        raise UserError(f"{path} is not valid YAML: {' '.join(str(error).split())}") from None


def load(path: Path = PATH) -> Params:
    """Read and check a parameter file.

    Raises:
        UserError: one line with the key, the value and what is allowed.
    """
    return parse(read_yaml(path), str(path))


def parse(values: Any, where: str) -> Params:
    """Check parameters given as plain mappings. Raises UserError as `load` does."""
    params = build(Params, values, where)
    checked = {
        name: MethodParams(
            train={env: _model(name, env, config, where) for env, config in block.train.items()},
            sample={
                env: build(methods.load(name).Sampling, values, f"{where}.methods.{name}.sample.{env}")
                for env, values in block.sample.items()
            },
        )
        for name, block in params.methods.items()
    }
    for name, block in checked.items():
        for environment in block.train.keys() & block.sample.keys():
            try:
                methods.check_sampling(block.train[environment].model, block.sample[environment])
            except ValueError as error:
                raise UserError(f"{where}.methods.{name}.sample.{environment}: {error}") from None
    for environment in [*params.grid.envs, *params.collect]:
        spec(environment)
    for environment in params.grid.envs:
        if environment not in params.collect:
            raise UserError(f"{where}.collect.{environment} is missing: grid.envs names it")
        for name in params.grid.methods:
            for part in ("train", "sample"):
                if name not in checked or environment not in getattr(checked[name], part):
                    raise UserError(f"{where}.methods.{name}.{part}.{environment} is missing: the grid names this cell")
    return dataclasses.replace(params, methods=checked)


def _model(name: str, environment: str, config: TrainingConfig, where: str) -> TrainingConfig:
    spec(environment)
    model = build(methods.load(name).Config, config.model, f"{where}.methods.{name}.train.{environment}.model")
    return dataclasses.replace(config, model=model)


if __name__ == "__main__":
    from pipeline.stage import run

    def main() -> None:
        params = load()
        print(f"{PATH}: profile {params.profile}, {len(params.grid.envs) * len(params.grid.methods)} cells, valid")

    run(main)
