"""The fork: two right actions in one state, to see who keeps both.

State and goal never change; half of the demonstrated actions go left, half right. A policy that can represent several
modes draws from both, one that cannot averages them into an action that nobody demonstrated. The networks are
small (profiles/fork.yaml), and the training short.
"""

import pandas as pd
import torch
from torch import Tensor

from beso import methods
from beso.core.noise import BatchNoise
from beso.core.seeding import integer_seed, torch_generator
from beso.data.spec import Sizes
from beso.data.windows import Batch
from beso.files import write_text
from beso.training import optimizers
from pipeline import paths, recipes
from pipeline.machine import Machine
from pipeline.pool import map_jobs
from pipeline.recipes import ForkMethod, ForkRecipe

SIZES = Sizes(observation=2, action=2, goal_window=1)
# Were their spread sigma_data, BESO's preconditioning alone would be the best linear answer, and a short training would
# not leave it.
MODES = torch.tensor([[-0.8, 0.3], [0.8, 0.3]])
SPREAD = 0.03  # standard deviation of a demonstrated action around its mode
BATCH = 64
LEARNING_RATE = 1e-2  # of Muon, which needs the fewest updates; falls to 0 as a cosine


def demonstrations(count: int, generator: torch.Generator) -> Batch:
    """`count` samples of the fork."""
    side = torch.randint(2, (count, 1), generator=generator)
    actions = MODES[side] + SPREAD * torch.randn(count, 1, 2, generator=generator)
    still = torch.zeros(count, 1, 2)
    return Batch(still, actions, still + 1, still, torch.ones(count, dtype=torch.long))


def samples(method: str, settings: ForkMethod, root_seed: int, updates: int, count: int) -> Tensor:
    """(count, 2) actions of one method after `updates` updates on the fork."""
    draws = torch_generator(root_seed, "fork", 0)
    policy = methods.load(method).Method(settings.model, settings.sample, SIZES, draws)
    known = demonstrations(1000, torch_generator(root_seed, "fork", 3)).actions[:, 0]
    policy.prepare(known, integer_seed(root_seed, "fork", 1))
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


def measure(recipe: ForkRecipe, machine: Machine) -> pd.DataFrame:
    """Columns method, x, y: actions of the demonstrations (method "data") and of every method of the recipe."""
    jobs = [(name, settings, recipe.seed, recipe.updates, recipe.samples) for name, settings in recipe.methods.items()]
    found = map_jobs(samples, jobs, machine, "fork")
    data = demonstrations(recipe.samples, torch_generator(recipe.seed, "fork", 2)).actions[:, 0]
    parts = {"data": data, **dict(zip(recipe.methods, found, strict=True))}
    return pd.concat(
        [pd.DataFrame(part.numpy(), columns=["x", "y"]).assign(method=name) for name, part in parts.items()]
    )[["method", "x", "y"]]


def main() -> None:
    table = measure(recipes.read_fork(), Machine.load())
    write_text(paths.FORK, table.to_csv(index=False, float_format="%.6g"))
