"""`python -m pipeline.tools.goal_use ENV METHOD` measures whether a trained policy looks at its goal.

On the first steps of held-out demonstrations it compares the policy's actions with the demonstrated ones, twice: with
the demonstration's own last states for a goal, and with those of another one. A policy that ignores its goal errs as
much with both. Validation loss does not tell: most actions follow from the state alone.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from beso import checkpoint, envs
from beso.data import play
from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.device import pick_device
from beso.errors import UserError
from beso.noise import BatchNoise
from beso.seeding import torch_generator
from pipeline import paths
from pipeline.params import load
from pipeline.stage import run

STEPS = 40  # at the start of a demonstration, where it is not plain yet where it leads


def errors(
    policy: Any,
    scaling: Scaling,
    dataset: PlayDataset,
    episodes: np.ndarray,
    goal_window: int,
    context: int,
    draws: torch.Generator,
) -> tuple[float, float]:
    """Mean squared errors of actions, scaled, with an episode's own and with the next one's last states as goal.

    Args:
        policy: see beso.methods.Policy; what it remembers is empty at every step.
        episodes: which episodes, indices into the dataset.
        goal_window: states in a goal.
        context: time steps that the policy sees.
        draws: of the policy's noise, the same for both errors.

    Raises:
        UserError: an episode is shorter than STEPS, so that its first steps would run into the next one.
    """
    shortest = dataset.lengths[episodes].min()
    if shortest < STEPS:
        raise UserError(f"the shortest held-out demonstration has {shortest} steps, at least {STEPS} are needed")
    device, each = draws.device, STEPS - context + 1  # decisions of an episode
    starts, ends = dataset.episode_starts[episodes], dataset.episode_ends[episodes]
    now = (starts[:, None] + np.arange(context - 1, STEPS)).ravel()
    steps = torch.from_numpy(now[:, None] + np.arange(1 - context, 1)).to(device)
    last = torch.from_numpy(np.repeat(ends, each)[:, None] - np.arange(goal_window, 0, -1)).to(device)
    states = torch.from_numpy(np.array(dataset.observations)).to(device)
    observations, goals = scaling.observations(states)[steps], scaling.goals(states)[last]
    actions = scaling.actions(torch.from_numpy(np.array(dataset.actions)).to(device))[steps]
    start = draws.get_state()

    def error(goal: torch.Tensor) -> float:
        draws.set_state(start)
        with torch.inference_mode():
            acted = policy.act(observations, actions[:, :-1], goal, BatchNoise(len(now), draws), {})
        return (acted - actions[:, -1]).square().mean().item()

    return error(goals), error(goals.roll(each, dims=0))


def main(environment: str, method: str) -> None:
    params = load()
    device, sampling = pick_device(params.machine.device), params.sampling(environment, method)
    spec = envs.spec(environment)
    dataset = play.load(paths.play(environment), spec)
    for seed in params.environments[environment].seeds:
        job, folder = params.job(environment, method, seed), paths.models(environment, method)
        checkpoint.check(folder, job)
        policy = checkpoint.load(folder, seed, sampling, device)
        seen = replace(dataset, observations=policy.encode(dataset.observations))
        draws = torch_generator(params.seed, "goal use", seed, device=device)
        _, held_out = job.split(len(dataset))
        shape = (spec.goal_window, policy.context, draws)
        own, other = errors(policy.method, policy.scaling, seen, held_out, *shape)
        print(f"{method} seed {seed}: action error {own:.4f} with the own goal, {other:.4f} with another's")


if __name__ == "__main__":
    run(main, "environment", "method")
