"""What the report must know of CALVIN: names, metrics, statistics of the play data."""

from beso.data.play import PlayDataset
from beso.envs.calvin.drawings import task_shares
from beso.envs.protocol import Metric
from beso.envs.statistics import sizes

LABEL = "CALVIN"
GOAL_LABELS = {"single_tasks": "13 single tasks", "two_tasks": "two tasks"}
METRICS = (
    Metric("success", "Success", 1.0),  # all that the goal asks for, at the same time
    Metric("completed", "Tasks done", 2.0),
)
PUBLISHED = {"hours of play": 6.0}  # the paper; of its other statistics none is known
STEPS_AN_HOUR = 30 * 3600


def statistics(dataset: PlayDataset) -> dict[str, float]:
    """Size, lengths, how much is done, and the share of each task."""
    done, hours = int(dataset.tasks.sum(dtype=int)), len(dataset.tasks) / STEPS_AN_HOUR
    return {
        **sizes(dataset),
        "hours of play": hours,
        "tasks done a minute": done / (60 * hours),
        **{f"share of tasks: {task}": share for task, share in task_shares(dataset).items()},
    }
