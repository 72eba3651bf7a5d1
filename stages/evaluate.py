"""Evaluation of one cell: chunks of episodes over worker processes; scenes and a film of some of them."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from beso.data.store import write_npy
from beso.envs.protocol import Outcome
from beso.evaluation_config import Chunk, chunks
from beso.files import replacing, write_text
from beso.rollout import EvaluationJob, Row, evaluate
from pipeline import recipes
from pipeline.engine import map_jobs, workers
from pipeline.film import film_cell
from pipeline.machine import Machine
from pipeline.recipes import EvaluateRecipe


def main(env: str, method: str) -> None:
    evaluate_cell(recipes.read_evaluate(env, method), Machine.load())


def evaluate_cell(recipe: EvaluateRecipe, machine: Machine) -> None:
    """Play all episodes of one cell; write their rows, and scenes of the first model's first episodes, one a task.

    A scene is the first raw observation, the goal and the last raw observation. Where there is no list of single tasks
    there are none, and the array is empty.
    """
    jobs = evaluation_jobs(recipe, machine)
    tasks = recipe.evaluation.tasks or ()
    rows, scenes = play_all(machine, jobs, f"evaluate {recipe.env} {recipe.method}", scenes=len(tasks))
    with replacing(recipe.scenes) as temporary:
        write_npy(temporary, np.array(scenes))
    film_cell(jobs[0] if recipe.film else None, recipe.film_folder)
    write_text(recipe.episodes, pd.DataFrame(rows).to_csv(index=False))


def evaluation_jobs(recipe: EvaluateRecipe, machine: Machine) -> list[EvaluationJob]:
    """One job for each model seed of a cell."""
    return [
        EvaluationJob(
            environment=recipe.env,
            data=recipe.play,
            trials=recipe.trials,
            models=recipe.models,
            seed=seed,
            sampling=recipe.sampling,
            config=recipe.evaluation,
            device=machine.device,
        )
        for seed in recipe.seeds
    ]


def play_all(
    machine: Machine,
    jobs: list[EvaluationJob],
    description: str,
    labels: list[dict[str, Any]] | None = None,
    scenes: int = 0,
) -> tuple[list[Row], list[np.ndarray]]:
    """The rows of all episodes of some jobs, in order; and some scenes (3, ...) of the first job.

    A worker plays every n-th chunk of a job, so that it loads policy and environments once; n is chosen so that all
    workers have work.

    Args:
        labels: columns in front of each job's rows.
        scenes: how many, of the first episodes with the first goal set.
    """
    shares = -(-workers(machine) // len(jobs))
    parts = []
    for i, job in enumerate(jobs):
        planned = chunks(job.config)
        parts += [(i, job, planned[k::shares], k) for k in range(min(shares, len(planned)))]
    planned_shares = [(job, share, 0 if i else scenes) for i, job, share, _ in parts]
    shares_played = map_jobs(_play, planned_shares, machine, description)
    by_chunk: dict[tuple[int, int], list[Row]] = {}
    seen: dict[int, np.ndarray] = {}
    for (i, _, _, first), (found, seen_there) in zip(parts, shares_played, strict=True):
        seen |= seen_there
        for n, rows in enumerate(found):
            by_chunk[i, first + n * shares] = [{**labels[i], **row} for row in rows] if labels else rows
    return [row for key in sorted(by_chunk) for row in by_chunk[key]], [seen[number] for number in sorted(seen)]


def _play(job: EvaluationJob, share: Sequence[Chunk], scenes: int) -> tuple[list[list[Row]], dict[int, np.ndarray]]:
    """A worker's share: rows by chunk, and scenes by number of the episode."""
    seen: dict[int, np.ndarray] = {}

    def note(row: Row, outcome: Outcome) -> None:
        if row["goals"] == job.config.goals[0] and row["episode"] < scenes:
            seen[row["episode"]] = np.stack([outcome.start, outcome.goal[-1], outcome.observation])

    return evaluate(job, share, witness=note), seen
