"""What the report must know of CALVIN: names, metrics, statistics of the play data."""

from beso.data.play import PlayDataset
from beso.envs.calvin import drawings as figures
from beso.envs.protocol import Drawing, Episodes, Metric, Table
from beso.envs.reporting import Summary
from beso.envs.statistics import sizes

LABEL = "CALVIN"
GOAL_LABELS = {"single_tasks": "single tasks", "two_tasks": "two tasks"}
METRICS = (
    Metric("success", "Success", 1.0),  # all that the goal asks for, at the same time
    Metric("completed", "Tasks done", 2.0),
)
PUBLISHED = {"hours of play": 6.0}  # the paper; of its other statistics none is known
STEPS_AN_HOUR = 30 * 3600


def statistics(dataset: PlayDataset) -> dict[str, float]:
    """Size, lengths, how much is done, and the share of each task; the last two of labelled play alone."""
    done, hours = int(dataset.tasks.sum(dtype=int)), len(dataset.tasks) / STEPS_AN_HOUR
    size = {**sizes(dataset), "hours of play": hours}
    if not dataset.labelled:
        return size
    return {
        **size,
        "tasks done a minute": done / (60 * hours),
        **{f"share of tasks: {task}": share for task, share in figures.task_shares(dataset).items()},
    }


def summary(dataset: PlayDataset) -> Summary:
    """See beso.envs.reporting.Report. Shares: of all tasks done in the play, by task; none of unlabelled play."""
    return {"statistics": statistics(dataset), "shares": figures.task_shares(dataset) if dataset.labelled else {}}


def drawings(play: Summary, episodes: Episodes) -> list[Drawing]:
    """The paper's two figures of CALVIN, from our numbers; and what the play has."""
    by_task = {name: figures.by_task(rows) for name, rows in episodes.items()}
    shares, caption = play["shares"], f"{LABEL}: how often each task is done in the play."
    count = next(iter(by_task.values())).columns.drop(figures.MEAN).size
    return [
        Drawing(
            "calvin_summary",
            f"{LABEL}: success in {count} single tasks, and in pairs of tasks from one goal image; lines are one"
            " standard deviation over seeds.",
            figures.bars({name: figures.in_short(rows) for name, rows in episodes.items()}, "share of episodes"),
        ),
        Drawing(
            "calvin_tasks",
            f"{LABEL}: success in each of {count} single tasks, and their mean.",
            figures.bars(by_task, "success"),
        ),
        *([Drawing("calvin_play", caption, figures.play(shares))] if shares else []),
    ]


def tables(episodes: Episodes) -> list[Table]:
    """The first two figures' numbers, means over seeds."""
    summaries = {name: figures.in_short(rows).mean() for name, rows in episodes.items()}
    tasks = {name: figures.by_task(rows).mean() for name, rows in episodes.items()}
    names = next(iter(tasks.values())).index
    return [
        Table(
            "calvin_summary",
            f"{LABEL}: success in single tasks and in pairs of tasks.",
            ("Method", *figures.COLUMNS),
            [(name, *map(float, summary)) for name, summary in summaries.items()],
        ),
        Table(
            "calvin_tasks",
            f"{LABEL}: success in each single task.",
            ("Task", *tasks),
            [(task, *(float(success[task]) for success in tasks.values())) for task in names],
        ),
    ]
