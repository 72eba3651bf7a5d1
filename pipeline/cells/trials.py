"""The episodes that all methods of one environment are evaluated on: made once, read by whatever plays them."""

from beso import envs, trials
from beso.envs.protocol import Trial, TrialRequest
from beso.evaluation_config import chunks
from pipeline import paths
from pipeline.engine import map_jobs
from pipeline.params import Params


def make_trials(params: Params, environment: str) -> None:
    """Make the trials of every goal set and model seed, and write them."""
    settings = params.environment(environment)
    requests = [
        TrialRequest(
            goals=chunk.goals,
            model_seed=seed,
            numbers=range(chunk.first, chunk.last),
            seed=settings.evaluation.seed,
            data=paths.play(environment),
            train_fraction=settings.training.train_fraction,
            root_seed=params.seed,
            tasks=settings.evaluation.tasks or (),
        )
        for seed in settings.seeds
        for chunk in chunks(settings.evaluation)
    ]
    jobs = [(request,) for request in requests]
    made = map_jobs(envs.trial_maker(environment), jobs, params.machine, f"trials {environment}")
    found: dict[tuple[str, int], list[Trial]] = {}
    for request, part in zip(requests, made, strict=True):
        found.setdefault((request.goals, request.model_seed), []).extend(part)
    trials.save(found, paths.trials(environment))
