"""The episodes that all methods of one environment are evaluated on: made once, read by whatever plays them."""

from beso import envs
from beso.envs.protocol import Trial, TrialRequest
from beso.evaluation import trials
from beso.evaluation.config import chunks
from pipeline import paths, recipes
from pipeline.machine import Machine
from pipeline.pool import map_jobs
from pipeline.recipes import EnvironmentRecipe
from pipeline.settings import Trials


def main(env: str) -> None:
    make_trials(recipes.read_environment(Trials, "trials", env), Machine.load())


def make_trials(recipe: EnvironmentRecipe, machine: Machine) -> None:
    """Make the trials of every goal set and model seed, and write them."""
    requests = [
        TrialRequest(
            goals=chunk.goals,
            model_seed=seed,
            numbers=range(chunk.first, chunk.last),
            seed=recipe.settings.evaluation.seed,
            data=paths.play(recipe.env),
            train_fraction=recipe.settings.train_fraction,
            root_seed=recipe.seed,
            tasks=recipe.settings.evaluation.tasks or (),
        )
        for seed in recipe.settings.seeds
        for chunk in chunks(recipe.settings.evaluation)
    ]
    jobs = [(request,) for request in requests]
    made = map_jobs(envs.trial_maker(recipe.env), jobs, machine, f"trials {recipe.env}")
    found: dict[tuple[str, int], list[Trial]] = {}
    for request, part in zip(requests, made, strict=True):
        found.setdefault((request.goals, request.model_seed), []).extend(part)
    trials.save(found, paths.trials(recipe.env))
