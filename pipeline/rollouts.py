"""Episodes over worker processes: what evaluations and studies share."""

from collections.abc import Sequence
from math import gcd
from pathlib import Path
from typing import Any

import numpy as np

from beso.envs.protocol import Outcome
from beso.evaluation.config import Chunk, chunks
from beso.evaluation.rollout import EvaluationJob, Row, evaluate
from pipeline.machine import Machine
from pipeline.pool import map_jobs, workers
from pipeline.recipes import EvaluateRecipe


def evaluation_jobs(recipe: EvaluateRecipe, machine: Machine, run: Path = Path()) -> list[EvaluationJob]:
    """One job for each model seed of a cell, in the folder of a run."""
    return [
        EvaluationJob(
            environment=recipe.env,
            data=run / recipe.play,
            trials=run / recipe.trials,
            models=run / recipe.models,
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

    A worker plays every n-th chunk of a job, so that it loads policy and environments once; n is the least with which
    the shares of all jobs, if each has n chunks, divide evenly among the workers.

    Args:
        labels: columns in front of each job's rows.
        scenes: how many, of the first episodes with the first goal set.
    """
    shares = workers(machine) // gcd(workers(machine), len(jobs))
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
    rows = [row for key in sorted(by_chunk) for row in by_chunk[key]]
    wanted = sum(chunk.last - chunk.first for job in jobs for chunk in chunks(job.config))
    if len(rows) != wanted:
        raise RuntimeError(f"{description}: {len(rows)} of {wanted} episodes were played")
    return rows, [seen[number] for number in sorted(seen)]


def _play(job: EvaluationJob, share: Sequence[Chunk], scenes: int) -> tuple[list[list[Row]], dict[int, np.ndarray]]:
    """A worker's share: rows by chunk, and scenes by number of the episode."""
    seen: dict[int, np.ndarray] = {}

    def note(row: Row, outcome: Outcome) -> None:
        if row["goals"] == job.config.goals[0] and row["episode"] < scenes:
            seen[row["episode"]] = np.stack([outcome.start, outcome.goal[-1], outcome.observation])

    return evaluate(job, share, witness=note), seen
