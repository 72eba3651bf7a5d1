"""Evaluation of one cell: chunks of episodes over worker processes."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from beso.evaluation_config import Chunk, EvaluationConfig, chunks
from beso.files import replacing, write_json, write_text
from beso.rollout import evaluate_chunk
from beso.training_config import TrainingJob
from pipeline import names, paths
from pipeline.params import Params
from pipeline.pool import map_jobs
from pipeline.statistics import over_seeds
from pipeline.video import FRAMES_PER_SECOND, write_video

COLUMNS = [
    "seed",
    "goals",
    "episode",
    "goal_demonstration",
    "goal_tasks",
    "tasks",
    "reward",
    "result",
    "length",
    "goal_distance",
]


def evaluate_cell(params: Params, environment: str, method: str) -> None:
    """Play all episodes of one cell; write rows, metrics and a film of the first episode."""
    config = params.evaluation
    sampling = params.sampling(environment, method)
    data, models = paths.play(environment), paths.models(environment, method)
    arguments: list[tuple[Any, ...]] = []
    with replacing(paths.videos(environment, method)) as videos:
        videos.mkdir()
        for seed in params.seeds:
            job = params.job(environment, method, seed)
            for chunk in chunks(config):
                film = videos / "rollout.webm" if config.video and not arguments else None
                arguments.append((environment, data, models, job, sampling, config, chunk, params.machine.device, film))
        parts = map_jobs(_play, arguments, params.machine.workers, f"evaluate {environment} {method}")
        rows = pd.DataFrame([row for part in parts for row in part])[COLUMNS]
    write_text(paths.episodes(environment, method), rows.to_csv(index=False))
    write_json(paths.metrics(environment, method), _metrics(rows))


def _play(
    environment: str,
    data: Path,
    models: Path,
    job: TrainingJob,
    sampling: Any,
    config: EvaluationConfig,
    chunk: Chunk,
    device: str,
    film: Path | None,
) -> list[dict[str, Any]]:
    frames: list[np.ndarray] = []
    rows = evaluate_chunk(
        environment, data, models, job, sampling, config, chunk, device, frames.append if film else None
    )
    if film:
        write_video(film, frames, FRAMES_PER_SECOND)
    return rows


def _metrics(rows: pd.DataFrame) -> dict[str, dict[str, float]]:
    """Mean and standard deviation over seeds of reward and result, by goal set; mean length and distance."""
    metrics: dict[str, dict[str, float]] = {}
    several = rows["seed"].nunique() > 1
    for goals, part in rows.groupby("goals", sort=False):
        values = metrics.setdefault(f"{goals}_goals", {})
        for name in names.METRICS:
            estimate = over_seeds(part, name)
            values[name] = round(estimate.mean, 4)
            if several:
                values[f"{name}_std"] = round(estimate.deviation, 4)
        values["length"] = round(float(part["length"].mean()), 1)
        values["goal_distance"] = round(float(part["goal_distance"].mean()), 4)
    return metrics
