"""`python -m pipeline.watch ENV METHOD [--seed 1] [--episode 0] [--film watch.webm]` films a trained policy.

The episode is that of the evaluation: the same start, goal and policy noise.
"""

import argparse
import dataclasses
import sys
from pathlib import Path

from beso.errors import UserError
from pipeline.cells.evaluation import evaluation_jobs
from pipeline.cells.film import film_episode
from pipeline.params import load
from pipeline.stage import guard


def main(*arguments: str) -> None:
    parser = argparse.ArgumentParser(prog="python -m pipeline.watch", description="film one rollout")
    parser.add_argument("environment")
    parser.add_argument("method")
    parser.add_argument("--seed", type=int, default=1, help="the trained model (default: %(default)s)")
    parser.add_argument("--episode", type=int, default=0, help="its number in the evaluation (default: %(default)s)")
    parser.add_argument("--film", type=Path, default=Path("watch.webm"), help="file to write (default: %(default)s)")
    options = parser.parse_args(arguments)
    params = load()
    sampling = params.sampling(options.environment, options.method)
    jobs = evaluation_jobs(params, options.environment, options.method, sampling)
    if options.episode < 0:
        raise UserError(f"--episode {options.episode}: must not be negative")
    job = dataclasses.replace(jobs[0], training=params.job(options.environment, options.method, options.seed))
    row = film_episode(job, options.film, options.episode)
    print(", ".join(f"{key} {value}" for key, value in row.items()))
    print(f"film: {options.film}")


if __name__ == "__main__":
    guard(main, *sys.argv[1:])
