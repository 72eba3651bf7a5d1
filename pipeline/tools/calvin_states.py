"""`beso calvin-states METHOD` judges CALVIN's play and recipes without pictures.

Policies see the simulator's state, 39 numbers, instead of a picture's features. Play, tasks, trials, recipe and
sampling are CALVIN's, as params.yaml has them. No step waits for a picture, and no encoder stands between play and
policy.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import gymnasium
import numpy as np
import torch

from beso.core import checkpoint
from beso.core.noise import EpisodeNoise
from beso.core.seeding import generator
from beso.core.training_config import TrainingJob
from beso.data import play
from beso.data.play import Episode
from beso.envs.calvin.demonstrations.scripted import record
from beso.envs.calvin.simulator import CalvinEnv
from beso.envs.calvin.simulator.play_table import PlayTable
from beso.envs.calvin.spec import SPEC
from beso.envs.calvin.trials import trial
from beso.envs.protocol import TrialRequest
from beso.evaluation.rollout import play_chunk
from beso.training.loop import Training, side_by_side
from pipeline.machine import Machine
from pipeline.params import load
from pipeline.pool import map_jobs

SIZE: Final = 39  # robot_obs and scene_obs
STATES: Final = replace(SPEC, observation_size=SIZE, visible=tuple(range(SIZE)))
LENGTH: Final = 500  # steps of a stretch of play
CHUNK: Final = 26  # trials played together
CPU: Final = torch.device("cpu")


def see(table: PlayTable) -> np.ndarray:
    """The state of arm and table, (39,)."""
    return np.concatenate([table.robot_obs(), table.scene_obs()]).astype(np.float32)


class StatesEnv(CalvinEnv):
    """CALVIN whose observations and goals are states."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """As CalvinEnv; the goal is (1, 39)."""
        goal = (options or {}).get("goal")
        observation, info = super().reset(seed=seed, options={k: v for k, v in (options or {}).items() if k != "goal"})
        return observation, {**info, "goal": goal}

    def _see(self) -> np.ndarray:
        return see(self.table)


def judge(method: str, steps: int, updates: int | None, trials: int, seed: int, folder: Path) -> None:
    """Record play, train one model on it, play trials, and print what it does.

    Args:
        method: of a cell of CALVIN in params.yaml; its first seed is trained.
        steps: of play.
        updates: of the training; None is the recipe's number.
        trials: for each goal set.
        seed: root of the trials' random numbers.
        folder: play and models; what is there is not made again.

    Raises:
        UserError: params.yaml has no such cell, or the folder holds files that are damaged or of another recipe.
    """
    params, machine = load(), Machine.load()
    cell, tasks = params.cell("calvin", method), params.environment("calvin").evaluation.tasks or ()
    job = cell.train.first
    if updates:
        job = replace(job, config=replace(job.config, optimization=replace(job.config.optimization, steps=updates)))
    data = folder / f"play-{steps}"
    if not data.is_dir():
        stretches = [(params.seed, index) for index in range(-(-steps // LENGTH))]
        episodes = [episode for episode in map_jobs(_stretch, stretches, machine, "play") if len(episode.actions) > 30]
        play.save(play.assemble(episodes, STATES, {"source": "scripted"}), data)
    models = folder / f"{method}-{steps}-{job.config.optimization.steps}"
    if not checkpoint.paths(models, job.seed)[1].is_file():
        _train(job, data, models)
    checkpoint.check(models, job)
    for goals in SPEC.goal_sets:
        chunks = [
            TrialRequest(goals, job.seed, range(first, min(first + CHUNK, trials)), seed, data, 0.5, 0, tasks)
            for first in range(0, trials, CHUNK)
        ]
        jobs = [(chunk, models, cell.evaluate.sampling) for chunk in chunks]
        played = [one for part in map_jobs(_play, jobs, machine, goals) for one in part]
        print(f"{method}, {goals}: {np.mean([done for _, done in played]):.2f} of {len(played)}")
        for name in sorted({name for name, _ in played}):
            of_task = [done for other, done in played if other == name]
            print(f"  {name}: {sum(of_task)} of {len(of_task)}")


def _stretch(seed: int, index: int) -> Episode:
    """A stretch of play, its states instead of frames."""
    steps = list(record(seed, index, LENGTH, None))
    return Episode(
        np.array([[*step.robot_obs, *step.scene_obs] for step in steps]),
        np.array([step.rel_action for step in steps]),
        np.array([step.tasks for step in steps]),
    )


def _train(job: TrainingJob, data: Path, models: Path) -> None:
    dataset = play.load(data, STATES)
    models.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(1)
    state = models / "state.safetensors"
    for training in side_by_side([Training(job, dataset, STATES, CPU, state)], 120):
        checkpoint.save(models, job, STATES.sizes, training.result(), play.data_digest(dataset))
    state.unlink(missing_ok=True)


def _play(request: TrialRequest, models: Path, sampling: Any) -> list[tuple[str, bool]]:
    """What each trial asked for, and whether it was done."""
    environments: list[gymnasium.Env] = [StatesEnv() for _ in request.numbers]
    table = PlayTable()
    try:
        chosen = [trial(table, request, number, lambda: see(table)) for number in request.numbers]
        draws = [generator(request.seed, f"policy noise, {request.goals}", number) for number in request.numbers]
        policy = checkpoint.load(models, request.model_seed, sampling, CPU)
        outcomes = play_chunk(chosen, environments, policy, EpisodeNoise(draws, CPU), CPU, None)
    finally:
        table.close()
        for environment in environments:
            environment.close()
    names = [" and ".join(SPEC.tasks[task] for task in one.tasks) for one in chosen]
    return [(name, outcome.reward > 0) for name, outcome in zip(names, outcomes, strict=True)]
