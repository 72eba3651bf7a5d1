"""How long a policy takes to choose an action, at the paper's size.

Timings differ from run to run; they stay out of everything that is meant to be reproduced byte for byte.
"""

import time
from typing import Any

import numpy as np
import pandas as pd
import torch

from beso import envs, methods
from beso.core.memory import Memory
from beso.core.noise import BatchNoise
from beso.data.spec import Sizes
from beso.files import write_text
from pipeline import paths, pool, profile, recipes
from pipeline.params import Cell
from pipeline.recipes import LatencyRecipe

WARM_UP = 1  # calls that do not count


def main() -> None:
    write_text(paths.LATENCY, measure(recipes.read(LatencyRecipe, "latency")).to_csv(index=False))


def measure(recipe: LatencyRecipe) -> pd.DataFrame:
    """One row for each environment, method and batch size, with the paper's networks and samplers.

    Cells that the paper profile does not have are left out. One thread, as policies are evaluated with: more would
    wait for each other wherever another program is busy.

    Columns: environment, method, parameters, batch, median and quartiles of the milliseconds of one call with a full
    context. Weights are random: time does not depend on them.
    """
    paper = profile.load(profile.COMPLETE)
    jobs = [(recipe, paper.cells[name]) for name in recipe.cells if name in paper.cells]
    return pd.DataFrame([row for rows in pool.map_jobs(time_cell, jobs, pool.HERE, "latency") for row in rows])


def time_cell(recipe: LatencyRecipe, cell: Cell) -> list[dict[str, Any]]:
    """The rows of one cell."""
    sizes, (policy, context) = envs.spec(cell.env).sizes, build(cell)
    count = sum(p.numel() for p in policy.parameters())
    rows = []
    for batch in recipe.batches:
        times = time_calls(policy, context, sizes, batch, recipe.repeats)
        q1, median, q3 = np.percentile(times, [25, 50, 75]).round(3)
        row = {"environment": cell.env, "method": cell.method, "parameters": count, "batch": batch}
        rows.append({**row, "median_ms": median, "q1_ms": q1, "q3_ms": q3})
    return rows


def build(cell: Cell) -> tuple[Any, int]:
    """A cell's policy with random weights, in evaluation mode, and how many steps it sees."""
    model, sampling, draws = cell.train.first.config.model, cell.evaluate.sampling, torch.Generator().manual_seed(0)
    policy = methods.load(cell.of).Method(model, sampling, envs.spec(cell.env).sizes, draws).eval()
    return policy, sampling.context_steps(model.context)


def time_calls(policy: Any, window: int, sizes: Sizes, batch: int, repeats: int) -> list[float]:
    """Milliseconds of `repeats` calls of `act`, after one that does not count."""
    draws = torch.Generator().manual_seed(0)
    observations = torch.randn(batch, window, sizes.observation, generator=draws)
    actions = torch.randn(batch, window - 1, sizes.action, generator=draws)
    goal = torch.randn(batch, sizes.goal_window, sizes.observation, generator=draws)
    noise = BatchNoise(batch, draws)
    memory: Memory = {}
    times = []
    with torch.inference_mode():
        for i in range(WARM_UP + repeats):
            start = time.perf_counter()
            policy.act(observations, actions, goal, noise, memory)
            if i >= WARM_UP:
                times.append(1000 * (time.perf_counter() - start))
    return times
