"""params.yaml as frozen objects, checked as a whole before any work."""

import dataclasses
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beso import envs, methods
from beso.config import build
from beso.core.training_config import TrainingConfig, TrainingJob
from beso.errors import UserError
from pipeline import paths
from pipeline.inheritance import Inheritance, Layers, build_merged
from pipeline.recipes import CellPaths, EvaluateRecipe, StudyRecipe, TrainRecipe, check_fit
from pipeline.settings import CellEntry, EnvironmentParams, File, ForkEntry, ImageParams, Latency, StudyEntry
from pipeline.yaml import read_yaml

PATH = Path("params.yaml")


@dataclass(frozen=True)
class Cell(CellPaths):
    """One method in one environment, with all that shapes it.

    Attributes:
        of: the method's file in beso/methods.
        train: what shapes its trained models.
        evaluate: how they are sampled and evaluated.
    """

    of: str
    train: TrainRecipe
    evaluate: EvaluateRecipe


@dataclass(frozen=True)
class Params:
    """The whole of params.yaml, resolved.

    Attributes:
        labels: the methods' names in the report, in the order of params.yaml.
        fork: None in an archive that does not have it.
    """

    profile: str
    seed: int
    environments: dict[str, EnvironmentParams]
    images: dict[str, ImageParams]
    cells: dict[str, Cell]
    studies: dict[str, StudyRecipe]
    labels: dict[str, str]
    latency: Latency
    fork: ForkEntry | None

    @property
    def envs(self) -> list[str]:
        """The environments that have cells, in the order of the cells."""
        return list(dict.fromkeys(cell.env for cell in self.cells.values()))

    def cells_in(self, env: str) -> list[Cell]:
        """The cells of one environment, in their order."""
        return [cell for cell in self.cells.values() if cell.env == env]

    def cell(self, env: str, method: str) -> Cell:
        """One cell. Raises UserError if there is none."""
        return self.cell_named(f"{env}-{method}")

    def cell_named(self, name: str) -> Cell:
        """One cell, by its key. Raises UserError if there is none."""
        if name not in self.cells:
            raise UserError(f"profile {self.profile} has no cell {name}: {', '.join(self.cells)} are there")
        return self.cells[name]


def load(path: Path = PATH) -> Params:
    """Read and check a parameter file.

    Raises:
        UserError: one line with the key, the value and what is allowed.
    """
    return parse(read_yaml(path), str(path))


def parse(values: Any, where: str) -> Params:
    """Check parameters given as plain mappings. Raises UserError as `load` does."""
    file = build(File, values, where)
    environments = {
        name: build_merged(
            EnvironmentParams,
            [(f"{where}.all_environments", file.all_environments), (f"{where}.environments.{name}", block)],
            f"{where}.environments.{name}",
        )
        for name, block in file.environments.items()
    }
    for name, environment in environments.items():
        _environment(name, environment, file.images.get(name), f"{where}")
    for name in file.images:
        if name not in environments:
            raise UserError(f"{where}.environments.{name} is missing: images.{name} names it")
        if not envs.sees_images(name):
            raise UserError(f"{where}.images.{name}: the policies of this environment see states")
    inheritance = Inheritance(file, f"{where}.methods")
    cells: dict[str, Cell] = {}
    for key, entry in file.cells.items():
        if entry.env not in environments:
            raise UserError(f"{where}.environments.{entry.env} is missing: cells.{key} names it")
        cells[key] = _cell(entry, environments[entry.env], inheritance, file, f"{where}.cells.{key}")
    for key, cell in cells.items():
        _teacher(cells, cell, file.images, f"{where}.cells.{key}")
    studies = {
        name: _study(
            name,
            [(f"{where}.all_studies", file.all_studies), (f"{where}.studies.{name}", block)],
            cells,
            f"{where}.studies.{name}",
        )
        for name, block in file.studies.items()
    }
    labels = {name: block.label for name, block in file.methods.items()}
    return Params(file.profile, file.seed, environments, file.images, cells, studies, labels, file.latency, file.fork)


def _environment(name: str, block: EnvironmentParams, images: ImageParams | None, where: str) -> None:
    """An environment's values fit what it is."""
    here, known, goals = f"{where}.environments.{name}", envs.spec(name).goal_sets, block.evaluation.goals
    if goals != known[: len(goals)]:
        allowed = " or ".join(str(list(known[:n])) for n in range(1, len(known) + 1))
        raise UserError(f"{here}.evaluation: goals = {list(goals)}: must be {allowed}")
    _single_tasks(name, block.evaluation.tasks, f"{here}.evaluation.tasks")
    sees_images = envs.sees_images(name)
    if (block.collect.to == "raw") != sees_images:
        allowed = "raw: its policies see images" if sees_images else "play: its policies see states"
        raise UserError(f"{here}.collect.to = {block.collect.to!r}: must be {allowed}")
    if sees_images and images is None:
        raise UserError(f"{where}.images.{name} is missing: its policies see images")
    if images is not None and block.collect.camera is not None:
        size, recorded = images.preprocess.size, block.collect.camera.size
        if size > recorded:  # frames can be made smaller, not larger
            raise UserError(
                f"{where}.images.{name}.preprocess.size = {size}: must be at most collect.camera.size, {recorded}"
            )


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


def _cell(entry: CellEntry, environment: EnvironmentParams, inheritance: Inheritance, file: File, where: str) -> Cell:
    """A cell with its recipes."""
    env, method, top = entry.env, entry.method, where.partition(".cells.")[0]
    if method not in file.methods:
        raise UserError(f"{top}.methods.{method} is missing: cells.{env}-{method} names it")
    if entry.of not in methods.names():
        raise UserError(f"{where}.of = {entry.of!r}: must be a file in beso/methods: {', '.join(methods.names())}")
    others = {other.of for other in file.cells.values() if other.method == method}
    if len(others) > 1:
        raise UserError(f"{where}.of = {entry.of!r}: {method} is of {', '.join(sorted(others))}; it must be one method")
    module = methods.load(entry.of)
    config, layers = inheritance.whole(TrainingConfig, method, "train", env)
    model = build_merged(module.Config, layers, f"{top}.methods.{method}.train.{env}", ("model", config.model))
    sampling, _ = inheritance.whole(methods.sampling(entry.of), method, "sample", env)
    check_fit(model, sampling, f"{top}.methods.{method}.sample.{env}")
    teacher = None if entry.source == str(paths.play(env)) else Path(entry.source).name
    training, seeds = (
        environment.training,
        _some_of("the environment's", environment.seeds, entry.seeds, f"{where}.seeds"),
    )
    job = TrainingJob(
        method=entry.of,
        config=dataclasses.replace(config, model=model),
        validation=training.validation,
        train_fraction=training.train_fraction,
        goal_horizon=training.goal_horizon,
        relative_goals=training.relative_goals,
        root_seed=file.seed,
        seed=seeds[0],
    )
    train = TrainRecipe(env, method, teacher, seeds, job)
    evaluate = EvaluateRecipe(env, method, entry.of, seeds, sampling, environment.evaluation, entry.film)
    folders = [str(paths.play(env)), *(str(other.models) for other in file.cells.values() if other.env == env)]
    if entry.source not in folders or entry.source == str(train.models):
        allowed = ", ".join(folder for folder in folders if folder != str(train.models))
        raise UserError(f"{where}.source = {entry.source!r}: must be one of {allowed}")
    return Cell(env, method, entry.of, train, evaluate)


def _some_of(whose: str, known: tuple[Any, ...], chosen: tuple[Any, ...] | None, where: str) -> tuple[Any, ...]:
    """All of `known`, or what was chosen of it."""
    if chosen is None:
        return known
    if not (len(set(chosen)) == len(chosen) > 0 and {*chosen} <= {*known}):
        allowed = ", ".join(map(str, known))
        raise UserError(f"{where} = {list(chosen)}: must be different ones of {whose}, {allowed}")
    return chosen


def _teacher(cells: dict[str, Cell], cell: Cell, images: dict[str, ImageParams], where: str) -> None:
    """A cell's method can learn from what the cell gives it."""
    name = cell.train.teacher
    teacher = cells[f"{cell.env}-{name}"].train if name else None
    source = f"{where}.source = {str(cell.train.source)!r}"
    try:
        cell.train.first.config.model.check_teacher(teacher and teacher.first.config.model)
    except ValueError as error:
        raise UserError(f"{source}: {cell.of}: {error}") from None
    if teacher:
        _some_of("the teacher's", teacher.seeds, cell.train.seeds, f"{where}.seeds")
    if name and cell.env in images and images[cell.env].features.finetune:
        raise UserError(f"{source}: images.{cell.env}.features.finetune must be false")


def _study(name: str, layers: Layers, cells: dict[str, Cell], where: str) -> StudyRecipe:
    """A study whose samplings its cell could have, and whose episodes are among the evaluation's."""
    entry = build_merged(StudyEntry, layers, where)
    cell = cells.get(f"{entry.env}-{entry.method}")
    if cell is None or cell.of != entry.of:
        raise UserError(f"{where}: {entry.env}-{entry.method} of {entry.of} is not among the cells")
    evaluation, first = cell.evaluate.evaluation, cell.evaluate.evaluation.goals[:1]
    goals = (
        first if entry.goals is None else _some_of("the evaluation's", evaluation.goals, entry.goals, f"{where}.goals")
    )
    seeds = _some_of("the cell's", cell.evaluate.seeds, entry.seeds, f"{where}.seeds")
    if entry.rollouts > evaluation.rollouts:
        raise UserError(f"{where}.rollouts = {entry.rollouts}: must be at most the evaluation's, {evaluation.rollouts}")
    whole, changes, samplings = dataclasses.asdict(cell.evaluate.sampling), [], []
    for combination in itertools.product(*entry.vary.values()):
        varied = dict(zip(entry.vary, combination, strict=True))
        samplings.append(build(methods.sampling(entry.of), whole | varied, where))
        changes.append({name: getattr(samplings[-1], name) for name in varied})  # 1 is 1.0 where a decimal is wanted
        check_fit(cell.train.first.config.model, samplings[-1], where)
    evaluation = dataclasses.replace(evaluation, goals=goals, rollouts=entry.rollouts)
    return StudyRecipe(entry.env, entry.method, name, entry.of, seeds, tuple(changes), tuple(samplings), evaluation)
