"""`beso bench policy CELL` measures speed and memory of a policy of the paper's size, with random weights.

It takes about a minute and needs the play data of the cell's environment; close other programs first. Times are medians
with quartiles in brackets. A call's parts are shares of its time, from torch's profiler, which itself takes time.
"""

import platform
import resource
import time
from collections import defaultdict
from typing import Any, get_args

import numpy as np
import torch

from beso import envs
from beso.core.checkpoint import LoadedModel
from beso.core.noise import BatchNoise
from beso.data import play
from beso.data.scaling import Scaling
from beso.data.spec import Sizes
from beso.policy import BatchPolicy
from beso.sampling.weights import Weights, choose
from pipeline import paths, profile
from pipeline.machine import Machine, available_workers
from pipeline.params import Cell
from pipeline.pool import map_jobs
from stages.latency import WARM_UP, build, time_calls

EPISODES = 100  # played in chunks, over all workers
STEPS = 20
CALLS = 200
ROUNDS = 4  # policies take turns, so that a slow moment is no one's
PARTS = {
    **dict.fromkeys(("addmm", "mm", "linear_dynamic_fp16"), "linear layers"),
    **dict.fromkeys(("bmm", "baddbmm", "_softmax"), "attention"),
    **dict.fromkeys(("native_layer_norm", "gelu"), "norms and GELU"),
    **dict.fromkeys(("cat", "stack", "copy_", "clone", "contiguous"), "copies"),
}


def bench(name: str) -> None:
    """Print what is measured. Raises UserError if the paper's profile lacks the cell, or there are no play data."""
    paper = profile.load(profile.COMPLETE)
    cell = paper.cell_named(name)
    spec, chunk = envs.spec(cell.env), paper.environments[cell.env].evaluation.chunk
    play.load(paths.play(cell.env), spec)  # missing data is better told now
    policies = {}
    for weights in get_args(Weights):
        policies[weights], context = _policy(cell)
        choose(policies[weights], weights)
    cores, policy = available_workers(), policies["fp32"]
    count = sum(p.numel() for p in policy.parameters())
    print(f"{platform.machine()}, {cores} cores, torch {torch.__version__}; {name}, {count:,} parameters")
    for threads in sorted({1, cores}):
        torch.set_num_threads(threads)
        for batch in (1, chunk):
            times: dict[str, list[float]] = {weights: [] for weights in policies}
            for weights in list(policies) * ROUNDS:
                times[weights] += time_calls(policies[weights], context, spec.sizes, batch, CALLS // ROUNDS)
            for weights, found in times.items():
                q1, median, q3 = np.percentile(found, [25, 50, 75])
                told = f"{median:.4g} ms [{q1:.4g}, {q3:.4g}]"
                print(f"an action of each of {batch}, {threads} threads, {weights}: {told}")
    torch.set_num_threads(1)
    for batch in (1, chunk):
        shares = _parts(policy, context, spec.sizes, batch)
        print(f"an action of each of {batch}, fp32: " + ", ".join(f"{p} {shares[p]:.0%}" for p in sorted(shares)))
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


def _parts(policy: Any, context: int, sizes: Sizes, batch: int) -> dict[str, float]:
    """Shares of a call's time by kind of operation."""
    with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU]) as profiler:
        times = time_calls(policy, context, sizes, batch, CALLS // ROUNDS)
    calls = len(times) + WARM_UP
    shares: dict[str, float] = defaultdict(float)
    for event in profiler.key_averages():
        part = PARTS.get(event.key.rpartition("::")[2], "other operators")
        shares[part] += event.self_cpu_time_total / 1000 / calls / float(np.mean(times))
    shares["Python"] = max(0.0, 1 - sum(shares.values()))
    return shares


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
