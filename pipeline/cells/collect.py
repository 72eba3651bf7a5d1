"""Raw play data of one environment: scripted demonstrations, or published files from a local folder."""

import importlib.metadata
from pathlib import Path

from beso import envs
from beso.data import play
from pipeline import paths
from pipeline.params import Params
from pipeline.pool import map_jobs


def collect(params: Params, environment: str) -> None:
    """Make or import one play dataset and write it."""
    settings, spec = params.environment(environment).collect, envs.spec(environment)
    if settings.source == "published":
        dataset = envs.importer(environment)(Path(settings.folder or ""))
    else:
        jobs = [(params.seed, i) for i in range(settings.demonstrations)]
        workers = params.machine.workers
        episodes = list(map_jobs(envs.recorder(environment), jobs, workers, f"collect {environment}"))
        versions = {name: importlib.metadata.version(name) for name in spec.packages}
        meta = {"source": "scripted", "seed": params.seed, "versions": versions}
        if failed := sum(episode.failed_takes for episode in episodes):
            meta["failed_takes"] = failed
        dataset = play.assemble(episodes, spec, meta)
    play.save(dataset, paths.play(environment))
    print(f"{len(dataset)} demonstrations, {dataset.lengths.mean():.1f} steps on average")
