"""`beso states CELL` judges play and a recipe where policies see images, on the simulator's states instead.

Play, tasks, trials, recipe and sampling are the cell's, as params.yaml has them. No step waits for a picture, and no
encoder stands between play and policy. What is in the folder is used again if it is of the same parameters and code.
"""

from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
import torch

from beso import envs
from beso.core import checkpoint
from beso.core.noise import EpisodeNoise
from beso.core.seeding import generator
from beso.core.training_config import TrainingJob
from beso.data import play
from beso.envs.protocol import TrialRequest
from beso.evaluation.rollout import play_chunk
from beso.training.loop import train
from pipeline import scratch
from pipeline.machine import Machine
from pipeline.params import load
from pipeline.pool import HERE, map_jobs

CHUNK: Final = 26  # trials played together
SHORTEST: Final = 30  # steps; a stretch that ends sooner is left out
CPU: Final = torch.device("cpu")


def judge(name: str, steps: int, updates: int | None, trials: int, seed: int, folder: Path) -> None:
    """Record play, train one model on it, play trials, and print what it does.

    Args:
        name: a cell of params.yaml; its first seed is trained.
        steps: of play.
        updates: of the training; None is the recipe's number.
        trials: for each goal set.
        seed: root of the trials' random numbers.
        folder: play and models.

    Raises:
        UserError: params.yaml has no such cell, its environment has no states, or a file in the folder is damaged.
    """
    params, machine = load(), Machine.load()
    cell = params.cell_named(name)
    states, job, tasks = envs.states(cell.env), cell.train.first, params.environments[cell.env].evaluation.tasks or ()
    if updates:
        job = replace(job, config=replace(job.config, optimization=replace(job.config.optimization, steps=updates)))
    data = folder / cell.env / f"play-{scratch.fingerprint(cell.env, params.seed, steps)}"
    if not data.is_dir():
        stretches = [(cell.env, params.seed, index) for index in range(-(-steps // states.LENGTH))]
        episodes = [one for one in map_jobs(_record, stretches, machine, "play") if len(one.actions) > SHORTEST]
        play.save(play.assemble(episodes, states.SPEC, {"source": "scripted"}), data)
    models = folder / cell.env / f"{cell.method}-{scratch.fingerprint(asdict(job), data.name)}"
    if not checkpoint.paths(models, job.seed)[1].is_file():
        list(map_jobs(_train, [(cell.env, job, data, models)], HERE, name))
    for goals in states.SPEC.goal_sets:
        chunks = [
            TrialRequest(goals, job.seed, range(first, min(first + CHUNK, trials)), seed, data, 0.5, 0, tasks)
            for first in range(0, trials, CHUNK)
        ]
        jobs = [(cell.env, chunk, models, cell.evaluate.sampling) for chunk in chunks]
        played = [one for part in map_jobs(_play, jobs, machine, goals) for one in part]
        print(f"{name}, {goals}: {np.mean([done for _, done in played]):.2f} of {len(played)}")
        for wanted in sorted({wanted for wanted, _ in played}):
            of_task = [done for other, done in played if other == wanted]
            print(f"  {wanted}: {sum(of_task)} of {len(of_task)}")


def _record(env: str, seed: int, index: int) -> play.Episode:
    return envs.states(env).record(seed, index)


def _train(env: str, job: TrainingJob, data: Path, models: Path) -> None:
    spec, state = envs.states(env).SPEC, models / "state.safetensors"
    dataset = play.load(data, spec)
    models.mkdir(parents=True, exist_ok=True)
    trained = train(job, dataset, spec, CPU, state)
    checkpoint.save(models, job, spec.sizes, trained, play.data_digest(dataset))
    state.unlink(missing_ok=True)


def _play(env: str, request: TrialRequest, models: Path, sampling: Any) -> list[tuple[str, bool]]:
    """What each trial asked for, and whether it was done."""
    states = envs.states(env)
    chosen = states.make_trials(request)
    draws = [generator(request.seed, f"policy noise, {request.goals}", number) for number in request.numbers]
    policy = checkpoint.load(models, request.model_seed, sampling, CPU)
    environments: list[gymnasium.Env] = [states.make() for _ in chosen]
    try:
        outcomes = play_chunk(chosen, environments, policy, EpisodeNoise(draws, CPU), CPU, None)
    finally:
        for environment in environments:
            environment.close()
    wanted = [" and ".join(states.SPEC.tasks[task] for task in one.tasks) for one in chosen]
    return [(tasks, outcome.reward > 0) for tasks, outcome in zip(wanted, outcomes, strict=True)]
