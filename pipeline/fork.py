"""The fork: two right actions in one state, to see who keeps both.

State and goal never change; half of the demonstrated actions go left, half right. A policy that can represent several
modes draws from both, one that cannot averages them into an action that nobody demonstrated. The networks are small
in every profile, and the training short.
"""

from typing import Any

import pandas as pd
import torch
from torch import Tensor

from beso import methods, optimizers
from beso.config import build
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.noise import BatchNoise
from beso.seeding import integer_seed, torch_generator
from pipeline.params import Params
from pipeline.pool import map_jobs

SIZES = Sizes(observation=2, action=2, goal_window=1)
# Were their spread sigma_data, BESO's preconditioning alone would be the best linear answer, and a short training would
# not leave it.
MODES = torch.tensor([[-0.8, 0.3], [0.8, 0.3]])
SPREAD = 0.03  # standard deviation of a demonstrated action around its mode
BATCH = 64
LEARNING_RATE = 1e-2  # of Muon, which needs the fewest updates; falls to 0 as a cosine

_TRANSFORMER: dict[str, Any] = {
    "width": 32,
    "layers": 2,
    "heads": 2,
    "window": 1,
    "attention_dropout": 0.0,
    "residual_dropout": 0.0,
    "conditioning": "sequential",
}
_DIFFUSION: dict[str, Any] = {"sigma_data": 0.5, "sigma_min": 0.05, "sigma_max": 1.0, "density": "log_logistic"}
_DIFFUSION |= {"location": -0.6931471805599453, "scale": 0.5}
_SAMPLING: dict[str, Any] = {
    "sampler": "ddim",
    "schedule": "exponential",
    "steps": 10,
    "sigma_min": 0.05,
    "sigma_max": 1.0,
}
_SAMPLING |= {"context": "clean", "context_length": None}
_LMP: dict[str, Any] = {
    "window": 1,
    "plan": 4,
    "recognition_width": 16,
    "recognition_layers": 1,
    "recognition_heads": 2,
}
_LMP |= {"recognition_dropout": 0.0, "prior_width": 32, "prior_layers": 2, "decoder_width": 32, "decoder_layers": 2}
_LMP |= {"decoder_dropout": 0.0, "mixtures": 3, "classes": 64, "kl_beta": 0.01}

# Model and sampling of each method, as they would stand in params.yaml.
MODELS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "gcbc": ({"width": 32, "layers": 2, "dropout": 0.0}, {}),
    "c_ibc": (
        {"width": 64, "layers": 2, "counter_examples": 32, "energy_penalty": 0.005, "gradient_penalty": 1.0},
        {"candidates": 256, "iterations": 2, "noise_scale": 0.3, "noise_shrink": 0.5},
    ),
    "lmp": (_LMP, {"replan": 1}),
    "ril": ({"width": 32, "layers": 2, "horizon": 1}, {"replan": 1}),
    "c_bet": (
        {"width": 32, "layers": 2, "heads": 2, "window": 1, "dropout": 0.0, "bins": 4, "offset_weight": 10.0},
        {},
    ),
    "cx_diff": (
        {"transformer": _TRANSFORMER, "diffusion_steps": 20, "beta_min": 1e-4, "beta_max": 0.4},
        {"steps": None, "extra_steps": 8, "context_length": None},
    ),
    "c_beso": ({"transformer": _TRANSFORMER, "diffusion": _DIFFUSION}, _SAMPLING),
    "cfg_beso": (
        {"transformer": _TRANSFORMER, "diffusion": _DIFFUSION, "goal_dropout": 0.1},
        {**_SAMPLING, "guidance_scale": 2.0},
    ),
}


def demonstrations(count: int, generator: torch.Generator) -> Batch:
    """`count` samples of the fork."""
    side = torch.randint(2, (count, 1), generator=generator)
    actions = MODES[side] + SPREAD * torch.randn(count, 1, 2, generator=generator)
    still = torch.zeros(count, 1, 2)
    return Batch(still, actions, still + 1, still, torch.ones(count, dtype=torch.long))


def samples(method: str, root_seed: int, updates: int, count: int) -> Tensor:
    """(count, 2) actions of one method after `updates` updates on the fork."""
    module, (model, sampling) = methods.load(method), MODELS[method]
    draws = torch_generator(root_seed, "fork", 0)
    config, chosen = build(module.Config, model, method), build(module.Sampling, sampling, method)
    policy = module.Method(config, chosen, SIZES, draws)
    if hasattr(policy, "prepare"):
        policy.prepare(demonstrations(1000, draws).actions[:, 0], integer_seed(root_seed, "fork", 1))
    updating = optimizers.make("muon", policy.parameters(), LEARNING_RATE, 0.0)
    decays = [torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates) for optimizer in updating]
    policy.train()
    for _ in range(updates):
        policy.loss(demonstrations(BATCH, draws), draws).backward()
        for optimizer, decay in zip(updating, decays, strict=True):
            optimizer.step()
            decay.step()
        policy.zero_grad()
    still = torch.zeros(count, 1, 2)
    with torch.inference_mode():
        return policy.eval().act(still, still[:, :0], still + 1, BatchNoise(count, draws), {})


def shares(actions: Tensor) -> tuple[float, float]:
    """How many of (N, 2) actions lie within five spreads of a mode, and how many are nearer to the first, as shares."""
    distances = torch.cdist(actions, MODES)
    near, first = distances.amin(dim=1) < 5 * SPREAD, distances.argmin(dim=1) == 0
    return near.float().mean().item(), first.float().mean().item()


def measure(params: Params) -> pd.DataFrame:
    """Columns method, x, y: actions of the demonstrations (method "data") and of every method of the grid."""
    settings = (params.seed, params.fork.updates, params.fork.samples)
    found = map_jobs(samples, [(m, *settings) for m in params.grid.methods], params.machine.workers, "fork")
    data = demonstrations(params.fork.samples, torch_generator(params.seed, "fork", 2)).actions[:, 0]
    parts = {"data": data, **dict(zip(params.grid.methods, found, strict=True))}
    return pd.concat(
        [pd.DataFrame(part.numpy(), columns=["x", "y"]).assign(method=name) for name, part in parts.items()]
    )[["method", "x", "y"]]
