"""Train C-BESO on play of your own, without DVC and without a simulator.

    python examples/train_on_own_data.py play.npz       # without a file: a toy, a point that goes to places

play.npz holds `observations` (steps, O), `actions` (steps, A) and `episode_ends` (episodes,), the index one past each
episode's last step. Neither rewards nor labels are needed: goals are later states of the same episode.
"""

import argparse
import math
from pathlib import Path

import numpy as np
import torch

from beso.core import checkpoint
from beso.core.training_config import OptimizationConfig, TrainingConfig, TrainingJob, ValidationConfig
from beso.data import play
from beso.data.spec import PlaySpec
from beso.diffusion.score_policy import DiffusionConfig
from beso.methods.c_beso import Config
from beso.networks.transformer import TransformerConfig
from beso.policy import Policy
from beso.training.loop import train

parser = argparse.ArgumentParser()
parser.add_argument("data", type=Path, nargs="?")
parser.add_argument("--steps", type=int, default=500)
options, out = parser.parse_args(), Path("own")

if options.data:
    data = np.load(options.data)
else:  # 100 episodes of 20 steps: from a random start straight to a random place
    start, end = np.random.default_rng(0).uniform(-1, 1, (2, 100, 1, 2))
    paths = start + np.linspace(0, 1, 21)[:, None] * (end - start)
    flat = {"observations": paths[:, :-1].reshape(-1, 2), "actions": np.diff(paths, axis=1).reshape(-1, 2)}
    data = flat | {"episode_ends": np.arange(20, 2001, 20)}
states, actions, ends = data["observations"], data["actions"], data["episode_ends"][:-1]
size = states.shape[1]
spec = PlaySpec("own", size, actions.shape[1], tuple(range(size)), (), goal_window=1, tasks=(), goal_sets=("training",))
parts = zip(np.split(states, ends), np.split(actions, ends), strict=True)
episodes = [play.Episode(s, a, np.zeros((len(a), 0))) for s, a in parts]
play.save(play.assemble(episodes, spec, {"source": "own"}), out / "play")  # checked here
dataset = play.load(out / "play", spec)

# What each value means: the docstrings of these classes. The paper's values: profiles/paper/common.yaml.
network = TransformerConfig(64, 3, 4, window=1, attention_dropout=0.0, residual_dropout=0.0, conditioning="sequential")
noise = DiffusionConfig(0.5, 0.05, 1.0, "log_logistic", location=math.log(0.5), scale=0.5, action_range=1.0)
optimization = OptimizationConfig(options.steps, 256, "muon", 2e-3, 0.01, "cosine", ema_decay=0.99, precision="fp32")
config = TrainingConfig(Config(network, noise, final_goals=0.0), optimization)
validation = ValidationConfig(every=100, windows=256)
job = TrainingJob("c_beso", config, validation, 0.9, goal_horizon=None, relative_goals=False, root_seed=0, seed=1)
trained = train(job, dataset, spec, torch.device("cpu"), out / "unfinished.safetensors")
checkpoint.save(out / "model", job, spec.sizes, trained, play.data_digest(dataset))

policy = Policy.load(out / "model", seed=1)
policy.reset(states[ends[0] - 1])
print(f"from {states[0]} to {states[ends[0] - 1]}: action {policy.act(states[0])}, demonstrated {actions[0]}")
