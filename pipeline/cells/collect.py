"""Play data of one environment: scripted demonstrations, or published files from a local folder.

Where policies see states, it becomes a play dataset at once; where they see images, it stays raw play, frames and all,
for the stages `preprocess` and `features`.
"""

import dataclasses
import importlib.metadata
import math
import shutil
from pathlib import Path

from beso import envs
from beso.data import play
from pipeline import paths, scratch
from pipeline.engine import map_jobs
from pipeline.params import Params
from pipeline.pool import available_workers


def collect(params: Params, environment: str) -> None:
    """Make or import the play of one environment and write it."""
    {"play": collect_play, "raw": collect_raw}[params.environment(environment).collect.to](params, environment)


def collect_play(params: Params, environment: str) -> None:
    """Write a play dataset."""
    settings, spec = params.environment(environment).collect, envs.spec(environment)
    if settings.source == "published":
        dataset = envs.importer(environment)(Path(settings.folder or ""))
    else:
        jobs = [(params.seed, i) for i in range(settings.demonstrations)]
        episodes = list(map_jobs(envs.recorder(environment), jobs, params.machine, f"collect {environment}"))
        versions = {name: importlib.metadata.version(name) for name in spec.packages}
        meta = {"source": "scripted", "seed": params.seed, "versions": versions}
        if failed := sum(episode.failed_takes for episode in episodes):
            meta["failed_takes"] = failed
        dataset = play.assemble(episodes, spec, meta)
    play.save(dataset, paths.play(environment))
    print(f"{len(dataset)} demonstrations, {dataset.lengths.mean():.1f} steps on average")


def collect_raw(params: Params, environment: str) -> None:
    """Write raw play. Recorded episodes wait in the scratch folder until all are there."""
    settings, room = params.environment(environment).collect, envs.recording(environment)
    assert settings.camera is not None  # checked with the parameters
    size, length, target = settings.camera.size, settings.camera.length, paths.raw(environment)
    if settings.source == "published":
        workers = params.machine.workers or available_workers()
        room.convert(Path(settings.folder or ""), target, size, workers)
        return
    waiting = scratch.folder("collect", environment, dataclasses.asdict(settings), params.seed)
    parts: list[Path] = []
    steps, wanted = 0, settings.demonstrations * length
    while steps < wanted:  # an episode may end early; then there are more of them
        new = range(len(parts), len(parts) + math.ceil((wanted - steps) / length))
        jobs = [(params.seed, i, length, size, waiting / f"episode{i}") for i in new]
        steps += sum(map_jobs(room.record, jobs, params.machine, f"collect {environment}"))
        parts += [job[-1] for job in jobs]
    room.join(parts, target, params.seed)
    shutil.rmtree(waiting)
    print(f"{len(parts)} episodes, {steps} steps")
