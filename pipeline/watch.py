"""`python -m pipeline.watch ENV METHOD [--seed 1] [--episode 0] [--run FOLDER] [--film watch.webm]` films a policy.

The episode is that of the evaluation: the same start, goal and policy noise. The run is the repository's own, or an
archived one, which has all that is needed for the policies whose weights it keeps (pipeline.tools.publish).
"""

import argparse
import dataclasses
import sys
from pathlib import Path

from beso import checkpoint
from beso.errors import UserError
from pipeline.cells.evaluation import evaluation_jobs
from pipeline.cells.film import film_episode
from pipeline.params import PATH, load
from pipeline.stage import guard


def main(*arguments: str) -> None:
    parser = argparse.ArgumentParser(prog="python -m pipeline.watch", description="film one rollout")
    parser.add_argument("environment")
    parser.add_argument("method")
    parser.add_argument("--seed", type=int, default=1, help="the trained model (default: %(default)s)")
    parser.add_argument("--episode", type=int, default=0, help="its number in the evaluation (default: %(default)s)")
    parser.add_argument("--film", type=Path, default=Path("watch.webm"), help="file to write (default: %(default)s)")
    parser.add_argument("--run", type=Path, default=Path(), help="a folder like reports/published/cpu")
    options = parser.parse_args(arguments)
    params = load(options.run / PATH)
    sampling = params.sampling(options.environment, options.method)
    jobs = evaluation_jobs(params, options.environment, options.method, sampling)
    if options.episode < 0:
        raise UserError(f"--episode {options.episode}: must not be negative")
    if options.film.suffix != ".webm" or not options.film.parent.is_dir():
        raise UserError(f"--film {options.film}: must be a .webm file in a folder that exists")
    job = dataclasses.replace(
        jobs[0],
        training=params.job(options.environment, options.method, options.seed),
        **{name: options.run / getattr(jobs[0], name) for name in ("data", "trials", "models")},
    )
    weights = checkpoint.paths(job.models, options.seed)[0]
    if options.run != Path() and not weights.is_file():
        kept = sorted(map(str, (options.run / "models").glob("*/*/*.safetensors")))
        raise UserError(f"{weights} was not archived: {', '.join(kept) or 'no weights'} were; others need training")
    row = film_episode(job, options.film, options.episode)
    print(", ".join(f"{key} {value}" for key, value in row.items()))
    print(f"film: {options.film}")


if __name__ == "__main__":
    guard(main, *sys.argv[1:])
