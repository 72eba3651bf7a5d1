"""Raw play data of one environment: scripted demonstrations, or published files from a local folder."""

import importlib
import importlib.metadata
from pathlib import Path

from beso.data import play, published
from beso.data.spec import spec
from beso.errors import UserError
from pipeline import params, paths
from pipeline.pool import map_jobs
from pipeline.stage import run


def main(environment: str) -> None:
    configuration, environment_spec = params.load(), spec(environment)
    if environment not in configuration.collect:
        raise UserError(f"{params.PATH}.collect.{environment} is missing")
    collect = configuration.collect[environment]
    if collect.source == "published":
        dataset = published.IMPORTERS[environment](Path(collect.folder or ""), environment_spec)
    else:
        record = importlib.import_module(f"beso.demonstrators.{environment}").record
        jobs = [(configuration.seed, i) for i in range(collect.demonstrations)]
        episodes = map_jobs(record, jobs, configuration.machine.workers, f"collect {environment}")
        versions = {name: importlib.metadata.version(name) for name in ("numpy", "pybullet")}
        meta = {"source": "scripted", "seed": configuration.seed, "versions": versions}
        dataset = play.assemble(episodes, environment_spec, meta)
    play.save(dataset, paths.play(environment))
    success = dataset.succeeded(environment_spec).mean()
    print(f"{len(dataset)} demonstrations, {dataset.lengths.mean():.1f} steps on average, {success:.1%} successful")


if __name__ == "__main__":
    run(main, "environment")
