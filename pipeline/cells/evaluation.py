"""Evaluation of one cell, and of the samplings of a study: chunks of episodes over worker processes."""

from dataclasses import replace
from typing import Any

import pandas as pd

from beso.evaluation_config import chunks
from beso.files import write_text
from beso.rollout import EvaluationJob, Row, evaluate
from pipeline import paths
from pipeline.params import Params
from pipeline.pool import available_workers, map_jobs


def evaluate_cell(params: Params, environment: str, method: str) -> None:
    """Play all episodes of one cell and write their rows."""
    jobs = evaluation_jobs(params, environment, method, params.sampling(environment, method))
    rows = play_all(params, jobs, f"evaluate {environment} {method}")
    write_text(paths.episodes(environment, method), pd.DataFrame(rows).to_csv(index=False))


def run_study(params: Params, name: str) -> None:
    """Play a cell's episodes with every sampling of a study, from the same starts and with the same noise.

    The rows are those of an evaluation, with the changed parameters in front.
    """
    samplings = params.samplings(name)
    study = params.studies[name]
    jobs: list[EvaluationJob] = []
    changes: list[dict[str, Any]] = []
    for changed, sampling in samplings:
        for job in evaluation_jobs(params, study.env, study.method, sampling):
            config = replace(job.config, goals=job.config.goals[:1], rollouts=study.rollouts)
            jobs.append(replace(job, config=config))
            changes.append(changed)
    rows = play_all(params, jobs, f"study {name}", changes)
    write_text(paths.study(name), pd.DataFrame(rows).to_csv(index=False))


def evaluation_jobs(params: Params, environment: str, method: str, sampling: Any) -> list[EvaluationJob]:
    """One job for each model seed of a cell."""
    settings = params.environments[environment]
    return [
        EvaluationJob(
            environment=environment,
            data=paths.play(environment),
            trials=paths.trials(environment),
            models=paths.models(environment, method),
            training=params.job(environment, method, seed),
            sampling=sampling,
            config=settings.evaluation,
            device=params.machine.device,
        )
        for seed in settings.seeds
    ]


def play_all(
    params: Params, jobs: list[EvaluationJob], description: str, labels: list[dict[str, Any]] | None = None
) -> list[Row]:
    """The rows of all episodes of some jobs, in order.

    A worker plays every n-th chunk of a job, so that it loads policy and environments once; n is chosen so that all
    workers have work.

    Args:
        labels: columns in front of each job's rows.
    """
    workers = params.machine.workers or available_workers()
    shares = -(-workers // len(jobs))
    parts = []
    for i, job in enumerate(jobs):
        planned = chunks(job.config)
        parts += [(i, job, planned[k::shares], k) for k in range(min(shares, len(planned)))]
    played = map_jobs(evaluate, [(job, share) for _, job, share, _ in parts], workers, description)
    by_chunk: dict[tuple[int, int], list[Row]] = {}
    for (i, _, _, first), found in zip(parts, played, strict=True):
        for n, rows in enumerate(found):
            by_chunk[i, first + n * shares] = [{**labels[i], **row} for row in rows] if labels else rows
    return [row for key in sorted(by_chunk) for row in by_chunk[key]]
