"""How policies are evaluated in block push: goals are last states of demonstrations (paper, "Block-Push")."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from beso.envs.block_push.simulator import BlockPushEnv
from beso.envs.protocol import Encoder, Outcome, Trial, identity


def make(render_mode: str | None = None) -> BlockPushEnv:
    """An environment as policies are evaluated in it."""
    return BlockPushEnv(render_mode=render_mode)


def encoder(data: Path, device: torch.device) -> Encoder:
    """Observations are states."""
    return identity


def score(trial: Trial, outcome: Outcome) -> dict[str, Any]:
    """Columns of an episode's row.

    The result is how many of the goal's pairs were entered at any time, in any order, as a share of two (paper,
    "result"). The pairs are all that the demonstration entered: very few entered a third one, and their goals can give
    1.5. The distance is the mean of the two blocks' from their places in the goal, metres.
    """
    distance = float(
        np.mean([np.linalg.norm(outcome.observation[i : i + 2] - outcome.goal[-1, i : i + 2]) for i in (0, 3)])
    )
    tasks = outcome.info["tasks"]
    return {
        "tasks": " ".join(map(str, tasks)),
        "reward": round(outcome.reward, 6),
        "result": len(set(tasks) & set(trial.tasks)) / 2,
        "length": outcome.length,
        "goal_distance": round(distance, 6),
    }
