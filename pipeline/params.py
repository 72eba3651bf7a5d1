"""params.yaml as frozen objects, checked as a whole before any work.

`python -m pipeline.params` checks the file and says so.
"""

import dataclasses
import itertools
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from beso import envs, methods
from beso.config import build, require, require_positive
from beso.errors import UserError
from beso.evaluation_config import EvaluationConfig
from beso.images.pretraining import Pretraining
from beso.images.resnet import check_width
from beso.training_config import TrainingConfig, TrainingJob, ValidationConfig
from pipeline import paths

PATH = Path("params.yaml")


@dataclass(frozen=True)
class Machine:
    """What the machine offers. Only the page reruns for it; of results, only rounding and draws depend on `device`."""

    workers: int
    device: Literal["auto", "cpu", "cuda"]
    save_seconds: float
    engine: Literal["processes", "ray"]
    ray_address: str
    seeds_together: int
    cuda_graph: bool

    def __post_init__(self) -> None:
        require_positive(self, "seeds_together")
        require(self.workers >= 0, f"workers = {self.workers}: must be 0 (one a processor) or more")
        require(self.save_seconds >= 0, f"save_seconds = {self.save_seconds}: must not be negative")
        # auto would be decided on each node, and the nodes' results might differ.
        require(self.engine != "ray" or self.device == "cpu", f"device = {self.device}: engine ray needs cpu")


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
        width: channels of its first stage, see beso.images.resnet.
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
class Cell:
    """One method in one environment.

    Attributes:
        env, method: what `environments` and `methods` name.
        of: the method's file in beso/methods; a variant names the method that it changes.
        source: the folder of the play data; or of the models of another cell, its teacher.
    """

    env: str
    method: str
    of: str
    source: str


@dataclass(frozen=True)
class Film:
    """A trained cell to be filmed."""

    env: str
    method: str
    of: str


@dataclass(frozen=True)
class Study:
    """A trained cell, sampled in several ways from the same starts and with the same noise.

    Attributes:
        env, method, of: the cell.
        rollouts: episodes a seed and goal set, the first of each.
        vary: values by parameter of the cell's sampling; every combination is played.
        goals: some of the evaluation's goal sets; null is the first, which is the paper's.
    """

    env: str
    method: str
    of: str
    rollouts: int
    vary: dict[str, Any]
    goals: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        require_positive(self, "rollouts")
        for name, values in self.vary.items():
            require(
                isinstance(values, list) and len(values) > 0 and all(v not in values[:i] for i, v in enumerate(values)),
                f"vary.{name} = {values!r}: must be a list of different values, at least one",
            )
        require(len(self.vary) > 0, "vary = {}: must name at least one parameter")


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
class ForkMethod:
    """One method's network and sampling on the fork, as under `methods`."""

    model: Any
    sample: Any


@dataclass(frozen=True)
class Fork:
    """How long every method trains on the fork (see pipeline.cells.fork), how many actions are drawn, which methods."""

    updates: int
    samples: int
    methods: dict[str, ForkMethod]

    def __post_init__(self) -> None:
        require_positive(self, "updates", "samples")


@dataclass(frozen=True)
class MethodParams:
    """One method's parameters by environment, split so that a change of sampling never retrains.

    A variant gives only what differs from the method that it changes; `load` fills in the rest.

    Attributes:
        label: the report's name.
    """

    label: str
    train: dict[str, Any]
    sample: dict[str, Any]


@dataclass(frozen=True)
class Params:
    """The whole of params.yaml."""

    profile: str
    seed: int
    machine: Machine
    environments: dict[str, EnvironmentParams]
    images: dict[str, ImageParams]
    cells: dict[str, Cell]
    methods: dict[str, MethodParams]
    studies: dict[str, Study]
    films: dict[str, Film]
    latency: Latency
    fork: Fork

    def __post_init__(self) -> None:
        require(
            re.fullmatch("[a-z0-9-]+", self.profile) is not None,
            f"profile = {self.profile!r}: must be made of lower-case letters, digits and hyphens",
        )
        require(self.seed >= 0, f"seed = {self.seed}: must not be negative")
        require(len(self.cells) > 0, "cells = {}: at least one is needed")
        for name, cell in self.cells.items():
            require(
                name == f"{cell.env}-{cell.method}",
                f"cells.{name}: its name must be env and method with a hyphen between, {cell.env}-{cell.method}",
            )
        known = {name: (cell.env, cell.method, cell.of) for name, cell in self.cells.items()}
        for name, film in self.films.items():
            require(
                known.get(name) == (film.env, film.method, film.of), f"films.{name}: is not among the cells like that"
            )
        for name, study in self.studies.items():
            require(
                (study.env, study.method, study.of) in known.values(),
                f"studies.{name}: {study.env}-{study.method} of {study.of} is not among the cells",
            )

    @property
    def envs(self) -> list[str]:
        """The environments that have cells, in the order of the cells."""
        return list(dict.fromkeys(cell.env for cell in self.cells.values()))

    def methods_in(self, env: str) -> list[str]:
        """The methods of one environment, in the order of the cells."""
        return [cell.method for cell in self.cells.values() if cell.env == env]

    def environment(self, env: str) -> EnvironmentParams:
        """One environment's block. Raises UserError if params.yaml does not have it."""
        if env not in self.environments:
            raise UserError(f"environment {env!r} is not in {PATH}: {', '.join(self.environments)} are")
        return self.environments[env]

    def image(self, env: str) -> ImageParams:
        """How one environment's frames become features. Raises UserError if params.yaml does not have it."""
        self.environment(env)
        if env not in self.images:
            raise UserError(f"images.{env} is not in {PATH}: {', '.join(self.images) or 'none'} are")
        return self.images[env]

    def cell(self, env: str, method: str) -> Cell:
        """One cell. Raises UserError if params.yaml does not have it."""
        self.environment(env)
        return self.cell_named(f"{env}-{method}")

    def cell_named(self, name: str) -> Cell:
        """One cell, by its key. Raises UserError if params.yaml does not have it."""
        if name not in self.cells:
            raise UserError(f"{PATH} has no cell {name}: {', '.join(self.cells)} are there")
        return self.cells[name]

    def teacher(self, env: str, method: str) -> str | None:
        """The method whose trained models one cell learns from; None is the play data. Raises UserError as `cell`."""
        folder = self.cell(env, method).source
        return next((name for name in self.methods_in(env) if str(paths.models(env, name)) == folder), None)

    def job(self, env: str, method: str, seed: int) -> TrainingJob:
        """The training run of one model. Raises UserError as `cell` does."""
        cell, training = self.cell(env, method), self.environments[env].training
        return TrainingJob(
            method=cell.of,
            config=self.methods[method].train[env],
            validation=training.validation,
            train_fraction=training.train_fraction,
            goal_horizon=training.goal_horizon,
            root_seed=self.seed,
            seed=seed,
        )

    def sampling(self, env: str, method: str, **changes: Any) -> Any:
        """How one method generates actions in one environment, with some values changed. Raises UserError as `cell`."""
        self.cell(env, method)
        sampling = self.methods[method].sample[env]
        return dataclasses.replace(sampling, **changes) if changes else sampling

    def goals(self, study: str) -> tuple[str, ...]:
        """The goal sets of one study."""
        entry = self.studies[study]
        return entry.goals or self.environments[entry.env].evaluation.goals[:1]

    def samplings(self, study: str) -> list[tuple[dict[str, Any], Any]]:
        """The samplings of one study: what was changed, and the whole."""
        if study not in self.studies:
            raise UserError(f"study {study!r} is not in {PATH}: {', '.join(self.studies) or 'none'} are")
        entry = self.studies[study]
        combinations = itertools.product(*entry.vary.values())
        changes = [dict(zip(entry.vary, values, strict=True)) for values in combinations]
        return [(change, self.sampling(entry.env, entry.method, **change)) for change in changes]


def read_yaml(path: Path) -> Any:
    """Read a YAML 1.2 file (PyYAML would read 1e-4 as text and `on` as true; DVC does not).

    Raises:
        UserError: the file is missing or is not YAML.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise UserError(f"{path} is missing") from None
    return parse_yaml(text, str(path))


def parse_yaml(text: str, where: str, yaml: YAML | None = None) -> Any:
    """Read YAML 1.2, with a given parser if not for plain mappings. Raises UserError if it is none."""
    try:
        return (yaml or YAML(typ="safe")).load(text)
    except YAMLError as error:
        raise UserError(f"{where} is not valid YAML: {' '.join(str(error).split())}") from None


def load(path: Path = PATH) -> Params:
    """Read and check a parameter file.

    Raises:
        UserError: one line with the key, the value and what is allowed.
    """
    return parse(read_yaml(path), str(path))


def parse(values: Any, where: str) -> Params:
    """Check parameters given as plain mappings. Raises UserError as `load` does."""
    params = build(Params, values, where)
    for name, environment in params.environments.items():
        known, goals = envs.spec(name).goal_sets, environment.evaluation.goals
        if goals != known[: len(goals)]:
            allowed = " or ".join(str(list(known[:n])) for n in range(1, len(known) + 1))
            raise UserError(f"{where}.environments.{name}.evaluation: goals = {list(goals)}: must be {allowed}")
        _single_tasks(name, environment.evaluation.tasks, f"{where}.environments.{name}.evaluation.tasks")
        images = envs.sees_images(name)
        if (environment.collect.to == "raw") != images:
            allowed = "raw: its policies see images" if images else "play: its policies see states"
            raise UserError(f"{where}.environments.{name}.collect.to = {environment.collect.to!r}: must be {allowed}")
        if images and name not in params.images:
            raise UserError(f"{where}.images.{name} is missing: its policies see images")
        if images:
            _sizes(environment.collect, params.images[name], f"{where}.images.{name}")
    for name in params.images:
        if name not in params.environments:
            raise UserError(f"{where}.environments.{name} is missing: images.{name} names it")
        if not envs.sees_images(name):
            raise UserError(f"{where}.images.{name}: the policies of this environment see states")
    for key, cell in params.cells.items():
        if cell.env not in params.environments:
            raise UserError(f"{where}.environments.{cell.env} is missing: cells.{key} names it")
        if cell.method not in params.methods:
            raise UserError(f"{where}.methods.{cell.method} is missing: cells.{key} names it")
        for part in ("train", "sample"):
            if cell.env not in getattr(params.methods[cell.method], part):
                raise UserError(f"{where}.methods.{cell.method}.{part}.{cell.env} is missing: cells.{key} names it")
    bases = {cell.method: cell.of for cell in params.cells.values()}
    checked = {
        name: _method(params.methods, name, bases.get(name, name), f"{where}.methods") for name in params.methods
    }
    for name, chosen in params.fork.methods.items():
        module, key = methods.load(name), f"{where}.fork.methods.{name}"
        sampling = build(methods.sampling(name), chosen.sample, f"{key}.sample")
        _fits(build(module.Config, chosen.model, f"{key}.model"), sampling, f"{key}.sample")
    params = dataclasses.replace(params, methods=checked)
    for key, cell in params.cells.items():
        _teacher(params, cell, f"{where}.cells.{key}")
    for name, study in params.studies.items():
        _study(params, study, f"{where}.studies.{name}")
    return params


def _single_tasks(env: str, chosen: tuple[str, ...] | None, where: str) -> None:
    """A list of single tasks is given where the environment takes one, and has only tasks that a trial can ask for."""
    known = envs.single_tasks(env)
    if not known and chosen is not None:
        raise UserError(f"{where} = {list(chosen)}: must be left out: trials of this environment are not by tasks")
    if known and chosen is None:
        raise UserError(f"{where} is missing: expected a list of tasks, of {', '.join(known)}")
    for task in chosen or ():
        if task not in known:
            why = "no trial can ask for it alone" if task in envs.spec(env).tasks else "there is no such task"
            raise UserError(f"{where} = {task!r}: {why}; allowed are {', '.join(known)}")


def _sizes(collect: Collect, images: ImageParams, where: str) -> None:
    """Frames can be made smaller, not larger."""
    assert collect.camera is not None
    size, recorded = images.preprocess.size, collect.camera.size
    if size > recorded:
        raise UserError(f"{where}.preprocess.size = {size}: must be at most collect.camera.size, {recorded}")


def _method(blocks: dict[str, MethodParams], name: str, of: str, where: str) -> MethodParams:
    """One method's block, checked; a variant's is filled up with that of the method it changes."""
    block, module = blocks[name], methods.load(of)
    if of != name and of not in blocks:
        raise UserError(f"{where}.{of} is missing: {name} changes it")
    train, sample = {}, {}
    for env in block.train | block.sample:
        envs.spec(env)
    for env, values in block.train.items():
        key = f"{where}.{name}.train.{env}"
        whole = values if of == name else merge(blocks[of].train.get(env), values, key)
        config = build(TrainingConfig, whole, key)
        train[env] = dataclasses.replace(config, model=build(module.Config, config.model, f"{key}.model"))
    for env, values in block.sample.items():
        key = f"{where}.{name}.sample.{env}"
        whole = values if of == name else merge(blocks[of].sample.get(env), values, key)
        sample[env] = build(methods.sampling(of), whole, key)
        if env in train:
            _fits(train[env].model, sample[env], key)
    return MethodParams(block.label, train, sample)


def _fits(model: Any, sampling: Any, where: str) -> None:
    try:
        model.check(sampling)
    except ValueError as error:
        raise UserError(f"{where}: {error}") from None


def _teacher(params: Params, cell: Cell, where: str) -> None:
    """A cell learns from what is there and what its method can learn from."""
    play, others = paths.play(cell.env), [name for name in params.methods_in(cell.env) if name != cell.method]
    folders = [str(play), *(str(paths.models(cell.env, name)) for name in others)]
    if cell.source not in folders:
        raise UserError(f"{where}.source = {cell.source!r}: must be one of {', '.join(folders)}")
    teacher = params.teacher(cell.env, cell.method)
    model = params.methods[cell.method].train[cell.env].model
    try:
        model.check_teacher(params.methods[teacher].train[cell.env].model if teacher else None)
    except ValueError as error:
        raise UserError(f"{where}.source = {cell.source!r}: {cell.of}: {error}") from None
    if teacher and cell.env in params.images and params.images[cell.env].features.finetune:
        raise UserError(f"{where}.source = {cell.source!r}: images.{cell.env}.features.finetune must be false")


def _study(params: Params, study: Study, where: str) -> None:
    """Every sampling of a study must be one that its cell could have, and its episodes among the evaluation's."""
    evaluation = params.environments[study.env].evaluation
    if study.rollouts > evaluation.rollouts:
        raise UserError(f"{where}.rollouts = {study.rollouts}: must be at most the evaluation's, {evaluation.rollouts}")
    goals = study.goals
    if goals is not None and not (len(set(goals)) == len(goals) > 0 and {*goals} <= {*evaluation.goals}):
        allowed = ", ".join(evaluation.goals)
        raise UserError(f"{where}.goals = {list(goals)}: must be different ones of the evaluation's, {allowed}")
    whole = dataclasses.asdict(params.sampling(study.env, study.method))
    for combination in itertools.product(*study.vary.values()):
        changed = {**whole, **dict(zip(study.vary, combination, strict=True))}
        sampling = build(methods.sampling(study.of), changed, where)
        _fits(params.methods[study.method].train[study.env].model, sampling, where)


def merge(base: Any, changes: Any, where: str) -> dict[str, Any]:
    """Nested mappings with some leaves changed.

    Raises:
        UserError: a key of `changes` is not one of `base`.
    """
    merged = dict(base or {})
    for key, value in (changes or {}).items():
        if key not in merged:
            raise UserError(f"{where}.{key} = {value!r}: unknown key; allowed are {', '.join(merged) or 'none'}")
        merged[key] = merge(merged[key], value, f"{where}.{key}") if isinstance(merged[key], dict) else value
    return merged


if __name__ == "__main__":
    from pipeline.stage import run

    def main() -> None:
        params = load()
        print(f"{PATH}: profile {params.profile}, {len(params.cells)} cells, {len(params.studies)} studies, valid")

    run(main)
