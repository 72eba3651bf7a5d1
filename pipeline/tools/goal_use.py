"""`beso goal-use CELL` measures whether a trained policy looks at its goal.

On the first steps of held-out demonstrations it compares the policy's actions with the demonstrated ones, twice: with
the demonstration's own goal and with that of another one. A policy that ignores its goal errs as much with both.
Validation loss does not tell: most actions follow from the state alone. Goals are a demonstration's last states, as in
rollouts, and states a little ahead, as CALVIN's play goes on after a task: its last states say little about its first.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import torch

from beso import envs
from beso.core import checkpoint
from beso.core.device import pick_device
from beso.core.noise import BatchNoise
from beso.core.seeding import torch_generator
from beso.data import play
from beso.data.play import PlayDataset
from beso.data.scaling import Scaling
from beso.errors import UserError
from pipeline.machine import Machine
from pipeline.params import load

STEPS = 40  # at the start of a demonstration, where it is not plain yet where it leads
AHEAD = 20  # steps from a decision to a goal that is near


def errors(
    policy: Any,
    scaling: Scaling,
    dataset: PlayDataset,
    episodes: np.ndarray,
    goal_window: int,
    context: int,
    draws: torch.Generator,
    ahead: int | None = None,
) -> tuple[float, float]:
    """Mean squared errors of actions, scaled, with an episode's own states and with the next one's as goal.

    Args:
        policy: see beso.core.method.BaseMethod; what it remembers is empty at every step.
        episodes: which episodes, indices into the dataset.
        goal_window: states in a goal.
        context: time steps that the policy sees.
        draws: of the policy's noise, the same for both errors.
        ahead: steps from a decision to its goal; None: the goal is the episode's last states.

    Raises:
        UserError: an episode is so short that its first steps or their goals would run into the next one.
    """
    shortest = dataset.lengths[episodes].min()
    needed = STEPS if ahead is None else STEPS + ahead + goal_window - 1
    if shortest < needed:
        raise UserError(f"the shortest held-out demonstration has {shortest} steps, at least {needed} are needed")
    device, each = draws.device, STEPS - context + 1  # decisions of an episode
    starts, ends = dataset.episode_starts[episodes], dataset.episode_ends[episodes]
    now = (starts[:, None] + np.arange(context - 1, STEPS)).ravel()
    steps = now[:, None] + np.arange(1 - context, 1)
    first_of_goal = np.repeat(ends, each) - goal_window if ahead is None else now + ahead

    def rows(array: np.ndarray, wanted: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.array(array[wanted])).to(device)

    observations = scaling.scale_observations(rows(dataset.observations, steps))
    goals = scaling.scale_goals(rows(dataset.observations, first_of_goal[:, None] + np.arange(goal_window)))
    actions = scaling.scale_actions(rows(dataset.actions, steps))
    start = draws.get_state()

    def error(goal: torch.Tensor) -> float:
        draws.set_state(start)
        with torch.inference_mode():
            seen = scaling.seen_goals(goal, observations)
            acted = policy.act(observations, actions[:, :-1], seen, BatchNoise(len(now), draws), {})
        return (acted - actions[:, -1]).square().mean().item()

    return error(goals), error(goals.roll(each, dims=0))


def goal_use(name: str) -> None:
    """Print the errors of every seed of a cell. Raises UserError if one is not trained, or as `errors`."""
    params = load()
    cell = params.cell_named(name)
    device, spec = pick_device(Machine.load().device), envs.spec(cell.env)
    dataset = play.load(cell.play, spec)
    for job in cell.train.jobs:
        checkpoint.check(cell.models, job)
        policy = checkpoint.load(cell.models, job.seed, cell.evaluate.sampling, device)
        seen = replace(dataset, observations=policy.encode(dataset.observations))
        draws = torch_generator(params.seed, "goal use", job.seed, device=device)
        _, held_out = job.split(len(dataset))
        shape = (spec.goal_window, policy.context, draws)
        for ahead, goals in [(None, "last states"), (AHEAD, f"{AHEAD} steps ahead")]:
            own, other = errors(policy.method, policy.scaling, seen, held_out, *shape, ahead)
            what = f"{own:.4f} with the own goal, {other:.4f} with another's"
            print(f"{name} seed {job.seed}, goals {goals}: action error {what}")
