"""Compare samplers on an archived policy: the same weights, starts, goals and initial noise, without training.

python examples/compare_samplers.py             # in the repository's root
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from beso.core import checkpoint
from beso.evaluation.config import Chunk, EvaluationConfig
from beso.evaluation.rollout import EvaluationJob, evaluate
from beso.sampling.diffusion import DiffusionSampling

ARCHIVE, ENVIRONMENT = Path("reports/published/cpu"), "block_push"
SAMPLERS = {"DDIM, 3 steps": ("ddim", 3), "Heun, 3 steps": ("heun", 3), "Euler, 10 steps": ("euler", 10)}

parser = argparse.ArgumentParser()
parser.add_argument("--episodes", type=int, default=10)
episodes = parser.parse_args().episodes

models = ARCHIVE / "models" / ENVIRONMENT / "c_beso"
default = DiffusionSampling.default(checkpoint.config(models, seed=1))
for name, (sampler, steps) in SAMPLERS.items():
    job = EvaluationJob(
        environment=ENVIRONMENT,
        data=ARCHIVE / "data/play" / ENVIRONMENT,
        trials=ARCHIVE / "data/trials" / ENVIRONMENT,
        models=models,
        seed=1,
        sampling=replace(default, sampler=sampler, steps=steps),
        config=EvaluationConfig(seed=1000, rollouts=episodes, goals=("training",), chunk=episodes, max_actions=None),
        device="cpu",
    )
    start = time.perf_counter()
    (rows,) = evaluate(job, [Chunk("training", 0, episodes)])
    result, actions = np.mean([row["result"] for row in rows]), sum(row["length"] for row in rows)
    print(f"{name}: result {result:.2f} of {episodes} episodes, {actions} actions, {time.perf_counter() - start:.1f} s")
