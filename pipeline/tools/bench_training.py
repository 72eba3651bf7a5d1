"""`beso bench training CELL ...` measures how fast cells train on this machine.

It takes what `beso train` takes, and no more: a GPU machine may lack the rest. Every cell is measured
in each precision, on a GPU with and without a CUDA graph, one seed alone and several in one process. A rate counts the
updates of all of them together: the median of blocks, quartiles in brackets.
"""

import gc
import itertools
import platform
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from beso import envs
from beso.core.device import Precision, pick_device
from beso.core.training_config import TrainingJob
from beso.data import play
from beso.training.loop import Training
from pipeline.machine import Machine
from pipeline.params import load
from pipeline.recipes import TrainRecipe

WARM_UP = 5  # updates before the clock starts: libraries set themselves up, a graph is recorded
BLOCKS = 5


def bench(cells: Sequence[str], seeds_together: Sequence[int], precisions: Sequence[Precision], seconds: float) -> None:
    """Print a Markdown table.

    Args:
        seeds_together: numbers of seeds in one process.
        seconds: a measurement takes about so long.

    Raises:
        UserError: params.yaml lacks a cell, or there are no play data of it.
    """
    torch.set_num_threads(1)
    params = load()
    device = pick_device(Machine.load().device)
    name = torch.cuda.get_device_name(device) if device.type == "cuda" else platform.processor() or "CPU, one thread"
    print(f"{name}, torch {torch.__version__}")
    print("| cell | batch | precision | graph | seeds | updates/s | samples/s | peak memory, MiB |")
    print("|---|---|---|---|---|---|---|---|")
    graphs = (False, True) if device.type == "cuda" else (False,)
    for cell in cells:
        recipe = params.cell_named(cell).train
        job = recipe.first
        for precision, graph, seeds in itertools.product(precisions, graphs, seeds_together):
            rates, memory = _measure(recipe, _endless(job, precision), device, graph, seeds, seconds)
            low, median, high = np.percentile(rates, [25, 50, 75])
            batch = job.config.optimization.batch_size
            print(
                f"| {cell} | {batch} | {precision} | {'yes' if graph else 'no'} | {seeds}"
                f" | {median:.4g} [{low:.4g}, {high:.4g}] | {median * batch:,.0f} | {memory} |",
                flush=True,
            )


def _endless(job: TrainingJob, precision: Precision) -> TrainingJob:
    """The job in that precision, without measurements of its losses."""
    optimization = replace(job.config.optimization, precision=precision, steps=10**9)
    validation = replace(job.validation, every=10**9)
    return replace(job, config=replace(job.config, optimization=optimization), validation=validation)


def _measure(
    recipe: TrainRecipe, job: TrainingJob, device: torch.device, graph: bool, seeds: int, seconds: float
) -> tuple[list[float], int | str]:
    """Updates a second in each block, and the GPU's peak memory in MiB."""
    data, spec = recipe.play, envs.spec(recipe.env)
    dataset, teacher = play.load(data, spec), recipe.source if recipe.teacher else None
    if device.type == "cuda":
        gc.collect()  # what was measured before would count
        torch.cuda.empty_cache()
        torch.cuda.reset_peak_memory_stats()
    jobs = [replace(job, seed=job.seed + i) for i in range(seeds)] if teacher is None else [job] * seeds
    trainings = [Training(one, dataset, spec, device, Path("none"), data, teacher, graph) for one in jobs]

    def updates_in(updates: int) -> float:
        start = time.perf_counter()
        for _ in range(updates):
            for training in trainings:
                training.step()
        if device.type == "cuda":
            torch.cuda.synchronize()
        return time.perf_counter() - start

    updates_in(WARM_UP)
    block = max(1, round(WARM_UP * seconds / BLOCKS / updates_in(WARM_UP)))
    rates = [block * seeds / updates_in(block) for _ in range(BLOCKS)]
    return rates, torch.cuda.max_memory_allocated() // 2**20 if device.type == "cuda" else "-"
