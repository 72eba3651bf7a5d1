"""`beso demo`: policies of an archived run play, without training: those whose weights it keeps.

Each plays the first episodes of the run's evaluation: their starts and goals lie in the archive. One is filmed: the
first that reaches its goal, or else the first. Nothing is chosen by hand.
"""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from beso import envs
from beso.core import checkpoint
from beso.errors import CannotDrawError, UserError
from beso.evaluation import trials
from beso.evaluation.config import Chunk
from beso.evaluation.rollout import EvaluationJob, Row, evaluate
from beso.files import replacing
from pipeline.film import FRAMES_PER_SECOND
from pipeline.machine import Machine
from pipeline.params import PATH, load
from pipeline.pool import map_jobs
from pipeline.rollouts import evaluation_jobs
from stages.evaluate import film_episode

HEIGHT = 180  # pixels of the moving picture
SKIPPED = 4  # of its frames, one in so many is shown
QUALITY = 60  # of its WebP, up to 100

NEXT = """
What next:
  another episode                    source .venv/bin/activate
                                     beso watch {cell} --run {run} --episode 3
  train and evaluate all of it here  make reproduce
  one policy, parameters, methods    README.md"""


def demo(cells: Sequence[str], run: Path, episodes: int, folder: Path, picture: Path | None) -> None:
    """Play, film and print.

    Args:
        cells: none means those with `film: true`, or else all, of which the run keeps weights.
        run: the folder of an archived run.
        episodes: how many each plays; the archive has the first of the evaluation.
        folder: of the films, CELL.webm.
        picture: a .webp file for all films side by side.

    Raises:
        UserError: the run has no such weights, or fewer episodes; or the file's name is not right.
    """
    if picture is not None and (picture.suffix != ".webp" or not picture.parent.is_dir()):
        raise UserError(f"--picture {picture}: must be a .webp file in a folder that exists")
    params, machine = load(run / PATH), Machine.load()
    kept = [
        name
        for name, cell in params.cells.items()
        if checkpoint.paths(run / cell.models, cell.evaluate.seeds[0])[0].is_file()
    ]
    if not kept:
        raise UserError(f"{run} keeps no weights: `beso publish --weights METHOD` keeps them")
    for name in cells:
        if params.cell_named(name).name not in kept:
            raise UserError(f"{run} keeps no weights of {name}, but of {', '.join(kept)}")
    cells = cells or [name for name in kept if params.cells[name].evaluate.film] or kept
    folder.mkdir(parents=True, exist_ok=True)
    planned = []
    for name in cells:
        job = evaluation_jobs(params.cells[name].evaluate, machine, run)[0]
        made = trials.load(job.trials).get((job.config.goals[0], job.seed), ())
        if episodes > len(made):
            raise UserError(f"--episodes {episodes}: {run} has {len(made)} of {name}")
        planned.append((job, episodes, folder / f"{name}.webm"))
    print(f"policies of {run} play {episodes} episodes each ...", flush=True)
    films = []
    played = map_jobs(play, planned, machine, "demo")
    for name, (job, _, film), (rows, filmed, trouble) in zip(cells, planned, played, strict=True):
        label, tasks = envs.report(job.environment).LABEL, envs.spec(job.environment).tasks
        method = params.labels[params.cells[name].method]
        print(f"{method} in {label}: {sum(map(reached, rows))} of {len(rows)} goals reached")
        asked = ", ".join(tasks[int(task)].replace("_", " ") for task in filmed["goal_tasks"].split())
        done = "reached" if reached(filmed) else "not reached"
        print(f"  episode {filmed['episode']}: {asked}: {done}, {filmed['length']} actions")
        print(f"  {trouble or film}")
        films += [] if trouble else [film]
    if picture is not None:
        side_by_side(films, picture)
        print(f"{picture}: {picture.stat().st_size:,} bytes")
    print(NEXT.format(run=run, cell=cells[0]))


def reached(row: Row) -> bool:
    """Whether an episode did all that its goal asks for."""
    return set(row["goal_tasks"].split()) <= set(row["tasks"].split())


def play(job: EvaluationJob, episodes: int, film: Path) -> tuple[list[Row], Row, str]:
    """Rows of an environment's first episodes, the row of the filmed one, and why there is no film.

    Each is played by itself, as the film is: batches of another size round otherwise.
    """
    goals = job.config.goals[0]
    rows = [row for (row,) in evaluate(job, [Chunk(goals, i, i + 1) for i in range(episodes)])]
    filmed = next(filter(reached, rows), rows[0])
    try:
        film_episode(job, film, filmed["episode"])
    except CannotDrawError as error:
        return rows, filmed, f"no film: {error}"
    return rows, filmed, ""


def side_by_side(films: Sequence[Path], target: Path) -> None:
    """Write films beside each other as an animated WebP; one that has ended shows its last frame.

    Raises:
        UserError: there is no film.
    """
    if not films:
        raise UserError(f"{target}: there is no film to make it of")
    shown = [read(film) for film in films]
    pictures = [np.hstack([frames[min(i, len(frames) - 1)] for frames in shown]) for i in range(max(map(len, shown)))]
    animation = cv2.Animation()
    animation.frames = pictures
    animation.durations = [1000 * SKIPPED // (2 * FRAMES_PER_SECOND)] * len(pictures)  # ms, at twice the films' speed
    with replacing(target) as temporary:
        written = temporary.with_suffix(".webp")  # OpenCV takes the format from it
        cv2.imwriteanimation(str(written), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
        written.replace(temporary)


def read(film: Path) -> list[np.ndarray]:
    """One in so many frames of a film, and its last, (HEIGHT, W, 3) uint8 BGR."""
    capture, frames = cv2.VideoCapture(str(film)), []
    while (found := capture.read())[0]:
        frames.append(found[1])
    capture.release()
    chosen = [*frames[:-1:SKIPPED], frames[-1]]
    width = round(frames[0].shape[1] * HEIGHT / frames[0].shape[0])
    return [cv2.resize(frame, (width, HEIGHT), interpolation=cv2.INTER_AREA) for frame in chosen]
