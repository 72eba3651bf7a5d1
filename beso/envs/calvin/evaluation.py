"""How CALVIN's episodes are played and scored (Rosete-Beas et al. 2022, whose evaluation the paper follows)."""

from pathlib import Path
from typing import Any

import torch

from beso.encoders.encoder import DESCRIPTION, load
from beso.envs.calvin.simulator import CalvinEnv
from beso.envs.protocol import Encoder, Outcome, Trial, identity
from beso.files import read_json


def make(render_mode: str | None = None) -> CalvinEnv:
    """An environment as policies are evaluated in it; its observations are as large as the episode's goal."""
    return CalvinEnv(render_mode=render_mode)


def encoder(data: Path, device: torch.device) -> Encoder:
    """The frozen network that made the play data's features of pictures; nothing where every policy has its own."""
    return identity if "finetune" in read_json(data / DESCRIPTION) else load(data, device)


def score(trial: Trial, outcome: Outcome) -> dict[str, Any]:
    """Columns of an episode's row.

    Success is 1 if all wanted tasks were reported at the same time, relative to the start. Completed is the number of
    wanted tasks that were reported at any time.
    """
    done = outcome.info["tasks"]
    return {
        "tasks": " ".join(map(str, done)),
        "success": int(outcome.reward > 0),
        "completed": len(done),
        "length": outcome.length,
    }
