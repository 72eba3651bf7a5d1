"""`python -m pipeline.tools.bench ENV` measures speed and memory at the paper's sizes, beside what the machine can do.

It takes about three minutes and needs `dvc repro collect`; close other programs first. Times are medians with
quartiles in brackets.
"""

import multiprocessing
import platform
import resource
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from beso import envs, optimizers
from beso.checkpoint import LoadedModel
from beso.data import play
from beso.data.scaling import Scaling
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.methods import c_beso
from beso.noise import BatchNoise
from beso.policy import BatchPolicy
from beso.training import train
from beso.training_config import TrainingJob
from pipeline import paths, profile
from pipeline.cells.latency import build, time_calls
from pipeline.pool import available_workers, map_jobs
from pipeline.stage import run

METHOD = "c_beso"
TRAINING_BATCH = 256
ROLLOUTS = 100
ROLLOUT_STEPS = 20


def main(environment: str) -> None:
    spec, paper = envs.spec(environment), profile.load(profile.COMPLETE)
    play.load(paths.play(environment), spec)  # missing data is better told now than after minutes
    model, sampling = paper.job(environment, METHOD, 1).config.model, paper.sampling(environment, METHOD)
    chunk = paper.environments[environment].evaluation.chunk
    cores = available_workers()
    print(f"{platform.machine()}, {cores} cores, torch {torch.__version__}, {torch.get_num_threads()} threads")
    peak = _machine(cores)
    _policy(environment, model, spec.sizes, sampling)
    _training(environment, model, spec.sizes, peak)
    _rollouts(environment, model, sampling, chunk, cores)
    _memory(environment, paper.job(environment, METHOD, 1), sampling, chunk)


def _quartiles(values: list[float], unit: str) -> str:
    q1, median, q3 = np.percentile(values, [25, 50, 75])
    return f"{median:.4g} {unit} [{q1:.4g}, {q3:.4g}]"


def _times(function: Callable[[], object], repeats: int) -> list[float]:
    function()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        function()
        times.append(time.perf_counter() - start)
    return times


def _machine(cores: int) -> float:
    """Print matrix-product rates and memory bandwidth; return the fp32 rate with all threads, in FLOP/s."""
    rate = 0.0
    # Processors without bf16 instructions are hundreds of times slower with it: a small product shows that too.
    for dtype, name, n in ((torch.float32, "fp32", 2048), (torch.bfloat16, "bf16", 512)):
        for threads in sorted({1, cores}):
            torch.set_num_threads(threads)
            a = torch.randn(n, n).to(dtype)
            rates = [2 * n**3 / t for t in _times(lambda a=a: a @ a, 5)]  # type: ignore[misc]
            print(f"matrix product {name}, {threads} threads: {_quartiles([r / 1e9 for r in rates], 'GFLOP/s')}")
            if dtype == torch.float32:
                rate = float(np.median(rates))
    block = torch.empty(1 << 26)
    bandwidth = [2 * block.nbytes / t / 1e9 for t in _times(block.clone, 5)]
    print(f"memory, copy with {cores} threads: {_quartiles(bandwidth, 'GB/s')}")
    return rate


def _policy(name: str, model: c_beso.Config, sizes: Sizes, sampling: Any) -> None:
    policy = build("c_beso", model, sampling, sizes)
    count = sum(p.numel() for p in policy.parameters())
    print(f"{name}, {count:,} parameters:")
    call = time_calls(policy, model.window, sizes, 1, 100)
    print(f"  policy call, batch 1, {sampling.steps} network calls: {_quartiles(call, 'ms')}")
    draws = torch.Generator().manual_seed(0)
    window, batch = model.window, 100
    actions = torch.randn(batch, window, sizes.action, generator=draws)
    states = torch.randn(batch, window, sizes.observation, generator=draws)
    goal = torch.randn(batch, sizes.goal_window, sizes.observation, generator=draws)
    level = torch.randn(batch, generator=draws)
    with torch.inference_mode():
        for last_only, what in ((True, "last action"), (False, "all actions")):
            times = _times(lambda o=last_only: policy.network(actions, level, states, goal, last_only=o), 20)  # type: ignore[misc]
            print(f"  network, batch 100, {what}: {_quartiles([1000 * t for t in times], 'ms')}")


def _updates(method: Any, draws: torch.Generator, precision: str = "fp32") -> Callable[[Batch], None]:
    """One training update, as a function of a batch."""
    optimizer = optimizers.make("adam", method.parameters(), 1e-4, 0.0)[0]

    def update(batch: Batch) -> None:
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bf16"):
            loss = method.loss(batch, draws)
        loss.backward()
        optimizer.step()
        optimizer.zero_grad()

    return update


def _training(name: str, model: c_beso.Config, sizes: Sizes, peak: float) -> None:
    draws = torch.Generator().manual_seed(0)
    batch = Batch(
        torch.randn(TRAINING_BATCH, model.window, sizes.observation, generator=draws),
        torch.randn(TRAINING_BATCH, model.window, sizes.action, generator=draws),
        torch.randn(TRAINING_BATCH, sizes.goal_window, sizes.observation, generator=draws),
    )
    method = build("c_beso", model, None, sizes).train()
    tokens = 1 + sizes.goal_window + 2 * model.window
    flop = 6 * sum(p.numel() for p in method.network.blocks.parameters()) * tokens * TRAINING_BATCH
    for precision, repeats in (("fp32", 6), ("bf16", 1)):
        update = _updates(method, draws, precision)
        times = _times(lambda update=update: update(batch), repeats)  # type: ignore[misc]
        share = flop / float(np.median(times)) / peak
        rates = [1 / t for t in times]
        print(
            f"{name}, training step of {TRAINING_BATCH}, {precision}: {_quartiles(rates, 'steps/s')},"
            f" {share:.0%} of the fp32 matrix peak"
        )


def _rollouts(environment: str, model: c_beso.Config, sampling: Any, chunk: int, cores: int) -> None:
    """Steps a second of one environment with one call a step, and of chunks over all workers, with random weights."""
    start, end = _play(environment, model, sampling, 1, 5 * ROLLOUT_STEPS, torch.get_num_threads())
    single = 5 * ROLLOUT_STEPS / (end - start)
    print(f"rollouts, one environment, one call a step: {single:.1f} steps/s")
    jobs = [
        (environment, model, sampling, min(chunk, ROLLOUTS - i), ROLLOUT_STEPS, 1) for i in range(0, ROLLOUTS, chunk)
    ]
    starts, ends = zip(*map_jobs(_play, jobs, cores), strict=True)
    rate = ROLLOUTS * ROLLOUT_STEPS / (max(ends) - min(starts))
    print(
        f"rollouts, {ROLLOUTS} in chunks of {chunk} over {cores} workers: {rate:.1f} steps/s, {rate / single:.1f} times"
        " (without starting workers and loading scenes)"
    )


def _play(
    environment: str, model: c_beso.Config, sampling: Any, count: int, steps: int, threads: int
) -> tuple[float, float]:
    """Start and end (seconds) of `steps` steps of `count` environments under a policy with random weights."""
    torch.set_num_threads(threads)
    environment_spec, module = envs.spec(environment), envs.evaluation(environment)
    policy = build("c_beso", model, sampling, environment_spec.sizes)
    environments = [module.make() for _ in range(count)]
    observations = np.stack([env.reset(seed=i)[0] for i, env in enumerate(environments)])
    dataset = play.load(paths.play(environment), environment_spec)
    scaling = Scaling.fit(dataset, np.arange(len(dataset)), environment_spec)
    goals = np.repeat(observations[:, None], environment_spec.goal_window, axis=1)
    agent = BatchPolicy(LoadedModel(policy, scaling, model.window), goals, torch.device("cpu"))
    noise = BatchNoise(count, torch.Generator().manual_seed(0))
    start = time.time()
    for _ in range(steps):
        actions = agent.act(observations, noise)
        observations = np.stack([env.step(a)[0] for env, a in zip(environments, actions, strict=True)])
    end = time.time()
    for env in environments:
        env.close()
    return start, end


def _memory(environment: str, job: TrainingJob, sampling: Any, chunk: int) -> None:
    """Peak resident size of a worker of a short training at the paper's size and batch, and of an evaluation worker."""
    context = multiprocessing.get_context("spawn")
    for name, function, arguments in (
        ("training worker", _train_briefly, (environment, job)),
        (f"evaluation worker, {chunk} environments", _play_briefly, (environment, job.config.model, sampling, chunk)),
    ):
        with context.Pool(1) as pool:
            print(f"peak memory, {name}: {pool.apply(function, arguments) / 2**20:.2f} GiB")


def _train_briefly(environment: str, job: TrainingJob) -> int:
    torch.set_num_threads(1)
    few = replace(job.config, optimization=replace(job.config.optimization, steps=5))
    environment_spec = envs.spec(environment)
    dataset = play.load(paths.play(environment), environment_spec)
    with tempfile.TemporaryDirectory() as folder:
        arguments = (dataset, environment_spec, torch.device("cpu"), Path(folder) / "state", 0.0)
        train(replace(job, config=few), *arguments, paths.play(environment))
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _play_briefly(environment: str, model: c_beso.Config, sampling: Any, chunk: int) -> int:
    _play(environment, model, sampling, chunk, 3, 1)
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    run(main, "environment")
