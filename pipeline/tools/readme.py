"""`beso readme` renews the table of results in the project's README: from the committed run and the archives."""

from collections.abc import Mapping
from pathlib import Path

import pandas as pd

from beso import envs
from beso.files import write_text
from pipeline import paths
from pipeline.params import Params, load
from pipeline.report import tables
from pipeline.report.comparison import paper_numbers

README = Path("README.md")
BEGIN, END = "<!-- results -->\n", "<!-- end of results -->\n"


def results(params: Params, runs: Mapping[str, pd.DataFrame]) -> str:
    """A Markdown table of the main scores: the paper's row, then one for each run that has any.

    The scores are each environment's last metric of which the paper has numbers, with every set of goals that it has;
    an environment that the paper lacks is left out.

    Args:
        params: for the methods and their labels.
        runs: the runs' comparisons, by the name that the table gives them.
    """
    methods, paper = tables.main_methods(params), paper_numbers().rename(columns={"mean": "paper"})
    lines = ["| | run | " + " | ".join(params.labels[method] for method in methods) + " |"]
    lines.append("|---|---|" + "---|" * len(methods))
    for env in params.envs:
        room, of_env = envs.report(env), paper[paper["environment"] == env]
        known = [metric for metric in room.METRICS if metric.name in {*of_env["metric"]}]
        if not known:
            continue
        metric = known[-1]
        measured = of_env[of_env["metric"] == metric.name]
        for goals in measured["goals"].unique():
            which = f", {room.GOAL_LABELS[goals]}" if measured["goals"].nunique() > 1 else ""
            label = f"{room.LABEL}{which}, {metric.label.lower()} (at most {metric.maximum:g})"
            numbers = {"paper": measured[measured["goals"] == goals].assign(shown=measured["paper"])}
            for name, run in runs.items():
                at = (run["environment"] == env) & (run["metric"] == metric.name) & (run["goals"] == goals)
                numbers[name] = run[at & run["study"].isna()].assign(shown=run["ours"])
            for name, rows in numbers.items():
                scores = rows.drop_duplicates("method").set_index("method")["shown"].reindex(methods)
                if scores.notna().any():
                    told = " | ".join(tables.number(score).replace("--", "-") for score in scores)
                    lines.append(f"| {label if name == 'paper' else ''} | {name} | {told} |")
    return "\n".join(lines) + "\n"


def renew() -> None:
    """Put the table into the project's README."""
    params = load()
    folders = {path.parent.name: path.parent for path in sorted((paths.REPORTS / "published").glob("*/comparison.csv"))}
    folders = {**dict(reversed(folders.items())), params.profile: paths.REPORTS}
    runs = {name: pd.read_csv(folder / "comparison.csv") for name, folder in folders.items()}
    before, _, rest = README.read_text(encoding="utf-8").partition(BEGIN)
    write_text(README, before + BEGIN + results(params, runs) + END + rest.partition(END)[2])
