"""Play data of one environment: scripted demonstrations, or published files from a local folder.

Where policies see states, it becomes a play dataset at once; where they see images, it stays raw play, frames and all,
for the stages `preprocess` and `features`.
"""

import dataclasses
import importlib.metadata
import math
import shutil
from pathlib import Path
from typing import Any

from beso import envs
from beso.data import play
from beso.files import from_home
from pipeline import paths, recipes, scratch
from pipeline.film import FRAMES_PER_SECOND, write_film, write_video
from pipeline.machine import Machine, available_workers
from pipeline.pool import map_jobs
from pipeline.recipes import EnvironmentRecipe
from pipeline.settings import Collect


def main(env: str) -> None:
    collect(recipes.read_environment(Collect, "collect", env), Machine.load())


def collect(recipe: EnvironmentRecipe, machine: Machine) -> None:
    """Make or import the play of one environment and write it; where it was made here, with a film of some."""
    waiting = None
    if recipe.settings.to == "play":
        collect_play(recipe, machine)
    else:
        waiting = collect_raw(recipe, machine)
    against = "" if recipe.settings.source == "scripted" else "its play was recorded elsewhere"
    write_film(paths.film_of_play(recipe.env), film_play, (recipe,), against)
    if waiting:
        shutil.rmtree(waiting)


def collect_play(recipe: EnvironmentRecipe, machine: Machine) -> None:
    """Write a play dataset."""
    settings, spec = recipe.settings, envs.spec(recipe.env)
    if settings.source == "published":
        dataset = envs.importer(recipe.env)(from_home(settings.folder or ""))
    else:
        jobs = [(recipe.seed, i) for i in range(settings.demonstrations)]
        episodes = list(map_jobs(envs.recorder(recipe.env), jobs, machine, f"collect {recipe.env}"))
        versions = {name: importlib.metadata.version(name) for name in spec.packages}
        meta = {"source": "scripted", "seed": recipe.seed, "versions": versions}
        if failed := sum(episode.failed_takes for episode in episodes):
            meta["failed_takes"] = failed
        dataset = play.assemble(episodes, spec, meta)
    play.save(dataset, paths.play(recipe.env))
    print(f"{len(dataset)} demonstrations, {dataset.lengths.mean():.1f} steps on average")


def collect_raw(recipe: EnvironmentRecipe, machine: Machine) -> Path | None:
    """Write raw play; the scratch folder of the recorded episodes, which can be removed when the stage is done."""
    settings, room = recipe.settings, envs.recording(recipe.env)
    assert settings.camera is not None  # checked with the parameters
    size, length, target = settings.camera.size, settings.camera.length, paths.raw(recipe.env)
    if settings.source == "published":
        workers = machine.workers or available_workers()
        room.convert(from_home(settings.folder or ""), target, size, workers)
        return None
    waiting = scratch.folder("collect", recipe.env, dataclasses.asdict(settings), recipe.seed)
    parts: list[Path] = []
    steps, wanted = 0, settings.demonstrations * length
    while steps < wanted:  # an episode may end early; then there are more of them
        new = range(len(parts), len(parts) + math.ceil((wanted - steps) / length))
        jobs = [(recipe.seed, i, length, size, waiting / f"episode{i}") for i in new]
        steps += sum(map_jobs(room.record, jobs, machine, f"collect {recipe.env}"))
        parts += [job[-1] for job in jobs]
    room.join(parts, target, recipe.seed)
    print(f"{len(parts)} episodes, {steps} steps")
    return waiting


def film_play(recipe: EnvironmentRecipe, path: Path) -> dict[str, Any]:
    """Film what the environment shows of its play; what that is, in words."""
    if recipe.settings.to == "raw":
        pictures, row = envs.recording(recipe.env).film(paths.raw(recipe.env))
    else:
        pictures, row = envs.filmer(recipe.env)(recipe.seed)
    write_video(path, pictures, FRAMES_PER_SECOND)
    return row
