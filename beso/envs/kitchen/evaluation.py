"""How policies are evaluated in the relay kitchen: goals are last states of demonstrations (paper, "Relay Kitchen")."""

from pathlib import Path
from typing import Any

import torch

from beso.envs.kitchen.simulator import KitchenEnv
from beso.envs.protocol import Encoder, Outcome, Trial, identity


def make(render_mode: str | None = None) -> KitchenEnv:
    """An environment as policies are evaluated in it."""
    return KitchenEnv(render_mode=render_mode)


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
