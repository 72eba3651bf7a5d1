"""What each cell's stages are told: the parameters that are theirs alone, all inheritance resolved.

The stage `resolve` writes them to recipes/, a JSON file a stage and cell, and the stage depends on its file. So a
change of params.yaml runs again what it changes, and nothing else.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from beso import methods
from beso.config import build
from beso.core.training_config import TrainingJob
from beso.errors import UserError
from beso.evaluation.config import EvaluationConfig
from beso.files import read_json
from pipeline import paths

FOLDER = Path("recipes")

Recipe = TypeVar("Recipe")


@dataclass(frozen=True)
class CellPaths:
    """One method in one environment, and where its files are."""

    env: str
    method: str

    @property
    def name(self) -> str:
        """As in dvc.yaml."""
        return f"{self.env}-{self.method}"

    @property
    def play(self) -> Path:
        """The play dataset."""
        return paths.play(self.env)

    @property
    def trials(self) -> Path:
        """The episodes that policies are evaluated on."""
        return paths.trials(self.env)

    @property
    def models(self) -> Path:
        """Trained models."""
        return Path("models") / self.env / self.method

    @property
    def curve(self) -> Path:
        """Training curves."""
        return Path("curves") / self.env / f"{self.method}.csv"

    @property
    def episodes(self) -> Path:
        """The evaluation, a row an episode."""
        return Path("results") / self.env / f"{self.method}.csv"

    @property
    def scenes(self) -> Path:
        """Start, goal and end of some episodes, (episodes, 3, ...); see stages.evaluate."""
        return Path("results/scenes") / self.env / f"{self.method}.npy"

    @property
    def film_folder(self) -> Path:
        """A folder with a film, `rollout.webm`, and the filmed episode's row, `rollout.json`."""
        return Path("films") / self.env / self.method


@dataclass(frozen=True)
class TrainRecipe(CellPaths):
    """What shapes the trained models of a cell.

    Attributes:
        teacher: the method of the same environment whose trained models it learns from; None: from play.
        seeds: one model each.
        first: the training run of the first; the others differ in their seed.
    """

    teacher: str | None
    seeds: tuple[int, ...]
    first: TrainingJob

    @property
    def source(self) -> Path:
        """The folder that it learns from."""
        return CellPaths(self.env, self.teacher).models if self.teacher else self.play

    @property
    def jobs(self) -> list[TrainingJob]:
        """The training run of every model."""
        return [replace(self.first, seed=seed) for seed in self.seeds]


@dataclass(frozen=True)
class EvaluateRecipe(CellPaths):
    """How the models of a cell, of the method in file `of`, are sampled and evaluated; whether an episode is filmed."""

    of: str
    seeds: tuple[int, ...]
    sampling: Any
    evaluation: EvaluationConfig
    film: bool


@dataclass(frozen=True)
class StudyRecipe(CellPaths):
    """A cell, sampled in several ways: a study's name, what each sampling changes, each as a whole, the episodes."""

    study: str
    of: str
    seeds: tuple[int, ...]
    changes: tuple[Any, ...]
    samplings: tuple[Any, ...]
    evaluation: EvaluationConfig

    @property
    def varied(self) -> list[str]:
        """The parameters of the sampling that it changes."""
        return list(self.changes[0])

    @property
    def rows(self) -> Path:
        """Its evaluation, a row an episode and sampling."""
        return Path("results/studies") / f"{self.study}.csv"


@dataclass(frozen=True)
class EnvironmentRecipe:
    """What a stage of one environment is told: the root seed, and its own block of params.yaml."""

    env: str
    seed: int
    settings: Any


@dataclass(frozen=True)
class LatencyRecipe:
    """How policy calls are timed: medians over `repeats` calls at each batch size, of these cells."""

    repeats: int
    batches: tuple[int, ...]
    cells: tuple[str, ...]


@dataclass(frozen=True)
class ForkMethod:
    """One method's network and sampling on the fork, as under `methods`."""

    model: Any
    sample: Any


@dataclass(frozen=True)
class ForkRecipe:
    """How long every method trains on the fork (see stages.fork), and how many actions are drawn."""

    seed: int
    updates: int
    samples: int
    methods: dict[str, ForkMethod]


def read(cls: type[Recipe], *parts: str) -> Recipe:
    """What one stage is told.

    Args:
        parts: of the file's name: train, ENV, METHOD.

    Raises:
        UserError: it is not there.
    """
    path = FOLDER.joinpath(*parts).with_suffix(".json")
    if not path.is_file():
        raise UserError(f"{path} is missing: params.yaml has no such entry, or `dvc repro resolve` has not run")
    return build(cls, read_json(path), str(path))


def read_environment(cls: type, stage: str, env: str) -> EnvironmentRecipe:
    """A stage of one environment, whose settings are of a class. Raises UserError as `read` does."""
    recipe = read(EnvironmentRecipe, stage, env)
    return replace(recipe, settings=build(cls, recipe.settings, f"{stage} {env}"))


def read_train(env: str, method: str) -> TrainRecipe:
    """A cell's training. Raises UserError as `read` does."""
    recipe = read(TrainRecipe, "train", env, method)
    job, config = recipe.first, recipe.first.config
    model = build(methods.load(job.method).Config, config.model, f"{env} {method}")
    return replace(recipe, first=replace(job, config=replace(config, model=model)))


def read_evaluate(env: str, method: str) -> EvaluateRecipe:
    """A cell's evaluation. Raises UserError as `read` does."""
    recipe = read(EvaluateRecipe, "evaluate", env, method)
    return replace(recipe, sampling=_sampling(recipe.of, recipe.sampling))


def read_study(name: str) -> StudyRecipe:
    """A study. Raises UserError as `read` does."""
    recipe = read(StudyRecipe, "study", name)
    return replace(recipe, samplings=tuple(_sampling(recipe.of, sampling) for sampling in recipe.samplings))


def read_fork() -> ForkRecipe:
    """The fork. Raises UserError as `read` does."""
    recipe = read(ForkRecipe, "fork")
    return replace(recipe, methods={name: fork_method(name, of, "fork") for name, of in recipe.methods.items()})


def fork_method(name: str, values: ForkMethod, where: str) -> ForkMethod:
    """One method's network and sampling on the fork, checked. Raises UserError if they do not fit."""
    module = methods.load(name)
    model = build(module.Config, values.model, f"{where}.{name}.model")
    sampling = build(methods.sampling(name), values.sample, f"{where}.{name}.sample")
    check_fit(model, sampling, f"{where}.{name}.sample")
    return ForkMethod(model, sampling)


def check_fit(model: Any, sampling: Any, where: str) -> None:
    """Raise UserError where a Sampling does not fit the model's Config."""
    try:
        model.check(sampling)
    except ValueError as error:
        raise UserError(f"{where}: {error}") from None


def _sampling(of: str, values: Any) -> Any:
    return build(methods.sampling(of), values, "sampling")
