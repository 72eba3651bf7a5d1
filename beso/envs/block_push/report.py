"""What the report must know of block push: names, metrics, statistics of the play data."""

import numpy as np

from beso.data.play import PlayDataset
from beso.envs.block_push.spec import LONGEST
from beso.envs.protocol import Drawing, Episodes, Metric, Table
from beso.envs.reporting import Summary
from beso.envs.statistics import sizes

LABEL = "Block-Push"
GOAL_LABELS = {"training": "training goals", "held_out": "held-out goals"}
METRICS = (Metric("reward", "Reward", 1.0), Metric("result", "Result", 1.0))
PUBLISHED = {  # measured on the published actions and masks (Cui et al. 2023)
    "demonstrations": 1000,
    "steps": 116_793,
    "mean length (steps)": 116.8,
    "std of length (steps)": 15.4,
    "longest (steps)": 201,
    "mean action size (m)": 0.01899,
    "share of actions of 0.03 m": 0.305,
    "share ended by success": 0.981,
}
FULL_STEP = 0.03  # m; the speed limit of most of the demonstrator's phases


def statistics(dataset: PlayDataset) -> dict[str, float]:
    """Size, lengths and action statistics."""
    lengths = np.linalg.norm(dataset.actions, axis=1)
    return {
        **sizes(dataset),
        "mean action size (m)": float(lengths.mean()),
        "share of actions of 0.03 m": float(np.mean(np.abs(lengths - FULL_STEP) < 1e-6)),
        # A demonstration that succeeds ends before its limit.
        "share ended by success": float((dataset.lengths < LONGEST).mean()),
    }


def summary(dataset: PlayDataset) -> Summary:
    """See beso.envs.reporting.Report."""
    return {"statistics": statistics(dataset)}


def drawings(play: Summary, episodes: Episodes) -> list[Drawing]:
    """None beyond those of every environment."""
    return []


def tables(episodes: Episodes) -> list[Table]:
    """None beyond those of every environment."""
    return []
