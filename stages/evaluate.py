"""Evaluation of one cell: its rows, scenes of some episodes, and a film."""

from pathlib import Path

import numpy as np
import pandas as pd

from beso.data.store import write_npy
from beso.evaluation.config import Chunk
from beso.evaluation.rollout import EvaluationJob, Row, evaluate
from beso.files import replacing, write_text
from pipeline import recipes
from pipeline.film import FRAMES_PER_SECOND, write_film, write_video
from pipeline.machine import Machine
from pipeline.recipes import EvaluateRecipe
from pipeline.rollouts import evaluation_jobs, play_all


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
    unwanted = "" if recipe.film else "params.yaml does not ask for one"
    write_film(recipe.film_folder, film_episode, (jobs[0],), unwanted)
    write_text(recipe.episodes, pd.DataFrame(rows).to_csv(index=False))


def film_episode(job: EvaluationJob, path: Path, episode: int = 0) -> Row:
    """Play and film one episode with the paper's kind of goal; its row."""
    frames: list[np.ndarray] = []
    chunk = Chunk(job.config.goals[0], episode, episode + 1)
    ((row,),) = evaluate(job, [chunk], frames.append)
    write_video(path, frames, FRAMES_PER_SECOND)
    return row
