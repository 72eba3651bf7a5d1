"""What the report must know of the relay kitchen: names, metrics, statistics of the play data."""

import numpy as np

from beso.data.play import PlayDataset
from beso.envs.protocol import Metric
from beso.envs.statistics import sizes

LABEL = "Relay Kitchen"
GOAL_LABELS = {"training": "training goals", "held_out": "held-out goals"}
METRICS = (Metric("reward", "Reward", 4.0), Metric("result", "Result", 4.0))
PUBLISHED = {"demonstrations": 566}  # the paper; the files themselves were not to be had
WANTED = 4  # tasks of a demonstration


def statistics(dataset: PlayDataset) -> dict[str, float]:
    """Size, lengths, actions, and how many different things the demonstrations do."""
    done = [dataset.completed(i) for i in range(len(dataset))]
    return {
        **sizes(dataset),
        "mean action of an entry": float(np.abs(dataset.actions).mean()),
        "share with four tasks": float(np.mean([len(tasks) >= WANTED for tasks in done])),
        "different sets of tasks": len({frozenset(tasks) for tasks in done}),
        "different orders of tasks": len(set(done)),
        "failed takes": float(dataset.meta.get("failed_takes", 0)),
    }
