"""`beso bench policy CELL` measures speed and memory of a policy of the paper's size, with random weights.

It takes some minutes and needs the play data of the cell's environment; close other programs first. Times are medians
with quartiles in brackets. A call's parts are shares of its time, from torch's profiler, which itself takes time.

`--published FOLDER` times the paper's published network beside ours, of the same size: its calls alone, without what
its sampler does between them. FOLDER is a checkout of github.com/intuitive-robots/beso; it needs the package einops.
"""

import os
import platform
import resource
import runpy
import time
from collections import defaultdict
from pathlib import Path
from typing import Any, get_args

import numpy as np
import torch
from torch import Tensor

from beso import envs
from beso.core.checkpoint import LoadedModel
from beso.core.memory import Memory
from beso.core.noise import BatchNoise, Noise
from beso.data import play
from beso.data.scaling import Scaling
from beso.data.spec import Sizes
from beso.errors import UserError
from beso.methods.c_beso import Config
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
PUBLISHED = Path("beso/agents/diffusion_agents/k_diffusion/score_gpts.py")
PROFILED = 20  # calls
ROUNDS = 4  # policies take turns, so that a slow moment is no one's
PARTS = {
    **dict.fromkeys(("addmm", "mm"), "linear layers"),
    **dict.fromkeys(("bmm", "baddbmm", "_softmax"), "attention"),
    **dict.fromkeys(("native_layer_norm", "gelu"), "norms and GELU"),
    **dict.fromkeys(("cat", "stack", "copy_", "clone", "contiguous"), "copies"),
}


def bench(name: str, published: Path | None) -> None:
    """Print what is measured.

    Args:
        name: a cell.
        published: a checkout of the published code to measure beside it.

    Raises:
        UserError: the paper's profile lacks the cell, there are no play data, or the published code cannot be measured.
    """
    paper = profile.load(profile.COMPLETE)
    cell = paper.cell_named(name)
    spec, chunk = envs.spec(cell.env), paper.environments[cell.env].evaluation.chunk
    play.load(paths.play(cell.env), spec)  # missing data is better told now
    policies: dict[str, Any] = {}
    if published:
        policies["published code"] = Published(published, cell, spec.sizes)
    for weights in get_args(Weights):
        policies[weights], context = build(cell)
        choose(policies[weights], weights)
    cores, policy = available_workers(), policies["fp32"]
    count = sum(p.numel() for p in policy.parameters())
    print(f"{platform.machine()}, {cores} cores, torch {torch.__version__}; {name}, {count:,} parameters")
    torch.set_num_threads(1)
    for batch in (1, chunk):
        shares = _parts(policy, context, spec.sizes, batch)
        told = ", ".join(f"{part} {shares[part]:.0%}" for part in sorted(shares))
        print(f"an action of each of {batch}, 1 threads, fp32: {told}")
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
    start, end, _ = _play(cell, 1, 5 * STEPS)
    single = 5 * STEPS / (end - start)
    print(f"rollouts, one environment: {single:.1f} steps/s")
    jobs = [(cell, min(chunk, EPISODES - first), STEPS) for first in range(0, EPISODES, chunk)]
    starts, ends, memory = zip(*map_jobs(_play, jobs, Machine()), strict=True)
    rate = EPISODES * STEPS / (max(ends) - min(starts))
    print(f"rollouts, {EPISODES} in chunks of {chunk}, {cores} workers: {rate:.1f} steps/s, {rate / single:.1f} times")
    print(f"peak memory of such a worker: {max(memory) / 2**20:.2f} GiB")


class Published:
    """The published network, with random weights and the sizes of a cell, called as often as its policy calls it.

    Raises:
        UserError: the cell is no C-BESO with a goal token, the folder has no such code, or a package is missing.
    """

    def __init__(self, folder: Path, cell: Cell, sizes: Sizes) -> None:
        model, path = cell.train.first.config.model, folder / PUBLISHED
        if not isinstance(model, Config) or model.transformer.conditioning != "sequential":
            raise UserError(f"{cell.name}: the published network is a C-BESO with a goal token")
        if not path.is_file():
            raise UserError(f"{path} is missing: --published is a checkout of github.com/intuitive-robots/beso")
        try:
            network = runpy.run_path(str(path))["DiffusionGPT"]
        except ModuleNotFoundError as error:
            raise UserError(f"{path} needs the package {error.name}: pip install {error.name}") from None
        self._steps, of = cell.evaluate.sampling.steps, model.transformer
        self._network = network(
            state_dim=sizes.observation,
            device="cpu",
            goal_conditioned=True,
            action_dim=sizes.action,
            embed_dim=of.width,
            embed_pdrob=0.0,
            attn_pdrop=0.0,
            resid_pdrop=0.0,
            n_layers=of.layers,
            n_heads=of.heads,
            goal_seq_len=sizes.goal_window,
            obs_seq_len=of.window,
            sigma_vocab_size=0,
            time_embedding_fn=None,
            linear_output=True,
        ).eval()

    def act(self, observations: Tensor, actions: Tensor, goal: Tensor, noise: Noise, memory: Memory) -> Tensor:
        """As ScorePolicy.act."""
        generated = torch.cat([actions, noise.normal(1, self._network.action_dim)], dim=1)
        for _ in range(self._steps):
            generated = self._network(observations, generated, goal, generated.new_ones(len(generated)))
        return generated[:, -1]


def _parts(policy: Any, context: int, sizes: Sizes, batch: int) -> dict[str, float]:
    """Shares of a call's time by kind of operation."""
    os.environ.setdefault("KINETO_LOG_LEVEL", "6")  # else the profiler writes that it begins and ends
    with torch.autograd.profiler.profile(use_kineto=False) as profiler:
        times = time_calls(policy, context, sizes, batch, PROFILED)
    calls = len(times) + WARM_UP
    shares: dict[str, float] = defaultdict(float)
    for event in profiler.key_averages():
        part = PARTS.get(event.key.rpartition("::")[2], "other operators")
        shares[part] += event.self_cpu_time_total / 1000 / calls / float(np.mean(times))
    shares["Python"] = max(0.0, 1 - sum(shares.values()))
    return shares


def _play(cell: Cell, count: int, steps: int) -> tuple[float, float, int]:
    """Start and end (seconds) of `steps` steps of `count` environments, and the process's peak memory, KiB."""
    spec, (policy, context) = envs.spec(cell.env), build(cell)
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
