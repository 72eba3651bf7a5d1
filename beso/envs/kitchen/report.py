"""What the report must know of the relay kitchen: names, metrics, statistics of the play data."""

import numpy as np

from beso.data.play import PlayDataset
from beso.envs.kitchen import drawings as figures
from beso.envs.kitchen.spec import TASKS
from beso.envs.protocol import Drawing, Episodes, Metric, Table
from beso.envs.reporting import Summary
from beso.envs.statistics import sizes

LABEL = "Relay Kitchen"
GOAL_LABELS = {"training": "training goals", "held_out": "held-out goals"}
METRICS = (Metric("reward", "Reward", 4.0), Metric("result", "Result", 4.0))
PUBLISHED = {
    "demonstrations": 566,  # the paper; the files themselves were not to be had
    # Below: four people's demonstrations of the same four tasks (D4RL's kitchen-complete)
    "mean length (steps)": 189,
    "std of length (steps)": 4,
    "mean action of an arm joint": 0.32,
    "share of steps with a joint at full speed": 0.29,
    "change of actions (rms)": 0.104,
    "change of that change (rms)": 0.112,
}
WANTED = 4  # tasks of a demonstration
ARM = slice(0, 7)  # of an action
FULL_SPEED = 0.99


def statistics(dataset: PlayDataset) -> dict[str, float]:
    """Size, lengths, actions, and how many different things the demonstrations do."""
    done = [dataset.completed(i) for i in range(len(dataset))]
    arm = [part[:, ARM] for part in np.split(dataset.actions, dataset.episode_ends[:-1])]
    sizes_of_actions = np.abs(np.concatenate(arm))
    return {
        **sizes(dataset),
        "mean action of an arm joint": float(sizes_of_actions.mean()),
        "share of steps with a joint at full speed": float((sizes_of_actions > FULL_SPEED).any(axis=1).mean()),
        "change of actions (rms)": _rms_difference(arm, 1),
        "change of that change (rms)": _rms_difference(arm, 2),
        "share with four tasks": float(np.mean([len(tasks) >= WANTED for tasks in done])),
        "different sets of tasks": len({frozenset(tasks) for tasks in done}),
        "different orders of tasks": len(set(done)),
        "failed takes": float(dataset.meta.get("failed_takes", 0)),
    }


def _rms_difference(parts: list[np.ndarray], order: int) -> float:
    """Root of the mean square of the entries' differences from step to step, within demonstrations."""
    differences = np.concatenate([np.diff(part, n=order, axis=0) for part in parts])
    return float(np.sqrt(np.mean(np.square(differences, dtype=np.float64))))


def summary(dataset: PlayDataset) -> Summary:
    """See beso.envs.reporting.Report.

    Orders: of each demonstration, its tasks as they were done. Approaches: for each task, see figures.approaches.
    """
    return {
        "statistics": statistics(dataset),
        "orders": [list(dataset.completed(i)) for i in range(len(dataset))],
        "approaches": [figures.approaches(dataset, task) for task in range(len(TASKS))],
    }


def drawings(play: Summary, episodes: Episodes) -> list[Drawing]:
    """How varied the demonstrations are; which task follows which; how many of a goal's tasks are done."""
    return [
        Drawing(
            "kitchen_variety",
            f"{LABEL}: the hand in the two seconds before a task is done, seen from the front, in up to {figures.DRAWN}"
            " demonstrations (blue: open, orange: closed when the task is done), and how often each set of four"
            " tasks was demonstrated.",
            figures.variety(play["orders"], play["approaches"]),
        ),
        Drawing(
            "kitchen_order",
            f"{LABEL}: which task follows which, in the demonstrations and in the methods' episodes; letters as in the"
            " figure before.",
            figures.order_matrices(play["orders"], episodes),
        ),
        Drawing(
            "kitchen_completed",
            f"{LABEL}: share of episodes that do at least one to {WANTED} of their goal's tasks, training goals.",
            figures.completion(_training(episodes), WANTED),
        ),
    ]


def tables(episodes: Episodes) -> list[Table]:
    """The last figure's numbers."""
    rows = [(name, *figures.completed_shares(part, WANTED)) for name, part in _training(episodes).items()]
    columns = ("Method", *(f"at least {n}" for n in range(1, WANTED + 1)))
    return [Table("kitchen_completed", f"{LABEL}: share of episodes by the goal's tasks done.", columns, rows)]


def _training(episodes: Episodes) -> Episodes:
    """The episodes with the paper's kind of goal."""
    return {method: rows[rows["goals"] == "training"] for method, rows in episodes.items()}
