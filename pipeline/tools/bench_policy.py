"""`beso bench policy CELL` measures speed and memory of a policy of the paper's size, with random weights.

It takes about a minute and needs the play data of the cell's environment; close other programs first. Times are medians
with quartiles in brackets.
"""

import platform
import resource
import time
from typing import Any

import numpy as np
import torch

from beso import envs
from beso.core.checkpoint import LoadedModel
from beso.core.noise import BatchNoise
from beso.data import play
from beso.data.scaling import Scaling
from beso.policy import BatchPolicy
from pipeline import paths, profile
from pipeline.machine import Machine, available_workers
from pipeline.params import Cell
from pipeline.pool import map_jobs
from stages.latency import build, time_calls

EPISODES = 100  # played in chunks, over all workers
STEPS = 20
CALLS = 100


def bench(name: str) -> None:
    """Print what is measured. Raises UserError if the paper's profile lacks the cell, or there are no play data."""
    paper = profile.load(profile.COMPLETE)
    cell = paper.cell_named(name)
    spec, chunk = envs.spec(cell.env), paper.environments[cell.env].evaluation.chunk
    play.load(paths.play(cell.env), spec)  # missing data is better told now
    policy, context = _policy(cell)
    cores = available_workers()
    count = sum(p.numel() for p in policy.parameters())
    print(f"{platform.machine()}, {cores} cores, torch {torch.__version__}; {name}, {count:,} parameters")
    for threads in sorted({1, cores}):
        torch.set_num_threads(threads)
        for batch in (1, chunk):
            q1, median, q3 = np.percentile(time_calls(policy, context, spec.sizes, batch, CALLS), [25, 50, 75])
            print(f"an action of each of {batch}, {threads} threads: {median:.4g} ms [{q1:.4g}, {q3:.4g}]")
    start, end, _ = _play(cell, 1, 5 * STEPS)
    single = 5 * STEPS / (end - start)
    print(f"rollouts, one environment: {single:.1f} steps/s")
    jobs = [(cell, min(chunk, EPISODES - first), STEPS) for first in range(0, EPISODES, chunk)]
    starts, ends, memory = zip(*map_jobs(_play, jobs, Machine()), strict=True)
    rate = EPISODES * STEPS / (max(ends) - min(starts))
    print(f"rollouts, {EPISODES} in chunks of {chunk}, {cores} workers: {rate:.1f} steps/s, {rate / single:.1f} times")
    print(f"peak memory of such a worker: {max(memory) / 2**20:.2f} GiB")


def _policy(cell: Cell) -> tuple[Any, int]:
    """A policy with random weights, and how many steps it sees."""
    model, sampling = cell.train.first.config.model, cell.evaluate.sampling
    return build(cell.of, model, sampling, envs.spec(cell.env).sizes), sampling.context_steps(model.context)


def _play(cell: Cell, count: int, steps: int) -> tuple[float, float, int]:
    """Start and end (seconds) of `steps` steps of `count` environments, and the process's peak memory, KiB."""
    spec, (policy, context) = envs.spec(cell.env), _policy(cell)
    environments = [envs.evaluation(cell.env).make() for _ in range(count)]
    observations = np.stack([env.reset(seed=i)[0] for i, env in enumerate(environments)])
    dataset = play.load(paths.play(cell.env), spec)
    scaling = Scaling.fit(dataset, np.arange(len(dataset)), spec)
    goals = np.repeat(observations[:, None], spec.goal_window, axis=1)
    agent = BatchPolicy(LoadedModel(policy, scaling, context), goals, torch.device("cpu"))
    noise = BatchNoise(count, torch.Generator().manual_seed(0))
    start = time.time()
    for _ in range(steps):
        actions = agent.act(observations, noise)
        observations = np.stack([env.step(a)[0] for env, a in zip(environments, actions, strict=True)])
    end = time.time()
    for env in environments:
        env.close()
    return start, end, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
