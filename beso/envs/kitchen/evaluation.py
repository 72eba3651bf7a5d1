"""How policies are evaluated in the relay kitchen: goals are last states of demonstrations (paper, "Relay Kitchen")."""

from pathlib import Path
from typing import Any

import torch

from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.kitchen.spec import SPEC
from beso.envs.protocol import Encoder, Outcome, Trial, TrialRequest, demonstration_trials, identity

MAX_ACTIONS = 279  # the published loop of 280 records its result before the last action


def make(render_mode: str | None = None) -> KitchenEnv:
    """An environment as policies are evaluated in it."""
    return KitchenEnv(render_mode=render_mode)


def trials(request: TrialRequest) -> list[Trial]:
    """Goals from demonstrations: their last two states. Every episode starts alike but for the noise."""
    return demonstration_trials(request, SPEC.goal_window, MAX_ACTIONS)


def encoder(data: Path, device: torch.device) -> Encoder:
    """Observations are states."""
    return identity


def score(trial: Trial, outcome: Outcome) -> dict[str, Any]:
    """Columns of an episode's row.

    The reward is the number of tasks done, any of the seven (paper, "reward"); the result the number of those that the
    goal's demonstration did (paper, "result", at most 4).
    """
    done = outcome.info["tasks"]
    return {
        "tasks": " ".join(map(str, done)),
        "reward": outcome.reward,
        "result": len(set(done) & set(trial.tasks)),
        "length": outcome.length,
    }
