"""`beso watch CELL` films a policy.

The episode is that of the evaluation: the same start, goal and policy noise. The run is the repository's own, or an
archived one, which has all that is needed for the policies whose weights it keeps (`beso publish`).
"""

from dataclasses import replace
from pathlib import Path

from beso.core import checkpoint
from beso.errors import UserError
from pipeline.film import film_episode
from pipeline.machine import Machine
from pipeline.params import PATH, load
from pipeline.play import evaluation_jobs
from pipeline.tools.train import finished


def watch(name: str, seed: int, episode: int, models: Path, run: Path, film: Path) -> None:
    """Film one episode and print its row.

    Args:
        seed: the trained model.
        models: a folder as `beso train` or a run has it; of another run than the repository's, its own is taken.
        run: the folder of params.yaml, play data and trials.
        film: the .webm file to write.

    Raises:
        UserError: something of that is missing, or this machine cannot draw.
    """
    params = load(run / PATH)
    cell = params.cell_named(name)
    if film.suffix != ".webm" or not film.parent.is_dir():
        raise UserError(f"--film {film}: must be a .webm file in a folder that exists")
    if run == Path():
        folder = finished(models, params, name, [seed])[seed]
    else:
        folder = run / cell.models
        weights = checkpoint.paths(folder, seed)[0]
        if not weights.is_file():
            kept = sorted(map(str, (run / "models").glob("*/*/*.safetensors")))
            raise UserError(f"{weights} was not archived: {', '.join(kept) or 'no weights'} were; others need training")
    (job,) = evaluation_jobs(replace(cell.evaluate, seeds=(seed,)), Machine.load())
    job = replace(job, data=run / job.data, trials=run / job.trials, models=folder)
    row = film_episode(job, film, episode)
    print(", ".join(f"{key} {value}" for key, value in row.items()))
    print(f"film: {film}")
