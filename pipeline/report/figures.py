"""Figures of the report, as PDF and PNG with reproducible bytes."""

import io
import itertools
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.image
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from beso import envs
from beso.data.store import read_npy
from beso.envs.figures import COLOURS as METHOD_COLOURS
from beso.envs.figures import PANELS_A_LINE, panels
from beso.envs.protocol import Drawing, Episodes
from beso.files import replacing, write_json
from pipeline import paths
from pipeline.params import Params
from pipeline.report import studies
from pipeline.report.comparison import of_cells, rows_of
from pipeline.report.names import words

BLUE, ORANGE, GREEN, _, _, LIGHT_BLUE = METHOD_COLOURS[:6]
COLOURS = {"ours": BLUE, "held_out": LIGHT_BLUE, "paper": ORANGE}
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "*", "h")  # of methods, so that colour is not all
STYLE = {"font.size": 8, "axes.spines.top": False, "axes.spines.right": False, "pdf.fonttype": 42, "savefig.dpi": 200}


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write one figure as PDF and PNG without dates or version strings."""
    without = {"pdf": ("CreationDate", "Producer", "Creator"), "png": ("Software",)}
    for kind, keys in without.items():
        drawn = io.BytesIO()  # matplotlib hides a full disk behind errors of its own
        figure.savefig(drawn, format=kind, metadata=dict.fromkeys(keys))
        figure.set_layout_engine(None)  # the layout stays; finding it is a good part of the time
        (folder / f"{name}.{kind}").write_bytes(drawn.getvalue())


CAPTIONS = "captions.json"  # beside the figures: a sentence each, in the report's order


def draw_all(params: Params, values: dict[str, Any], folder: Path) -> dict[str, str]:
    """Draw every figure into `folder`, replacing it whole; their captions by name.

    Args:
        values: from pipeline.report.gather.gather.
    """
    with replacing(folder) as temporary, matplotlib.rc_context(STYLE):
        temporary.mkdir()
        captions = {}
        for drawing in drawings(params, values):
            save(drawing.figure, temporary, drawing.name)
            captions[drawing.name] = drawing.caption
        listed = [{"name": name, "caption": caption} for name, caption in captions.items()]
        write_json(temporary / CAPTIONS, {"figures": listed})
    return captions


def drawings(params: Params, values: dict[str, Any]) -> Iterator[Drawing]:
    """Every figure, one after another."""
    comparison, root = values["comparison"], values["root"]
    caption = (
        "Every number that this run and the paper both have, as a share of the largest possible one; small and hollow:"
        " of studies. On the line, both agree; bars are 95 % intervals of ours, the paper's are standard deviations."
    )
    yield Drawing("overview", caption, overview(params, comparison))
    for name in params.envs:
        title, played = envs.report(name).LABEL, values["played"][name]
        part = comparison[comparison["environment"] == name]
        beside = " beside the paper's" if of_cells(part)["paper"].notna().any() else ""
        caption = f"{title}: scores{beside}; lines are one standard deviation over seeds."
        yield Drawing(f"scores_{name}", caption, scores(params, part, name))
        yield from envs.report(name).drawings(values["play"][name], played)
        caption = f"{title}: held-out loss over its first measurement, a line a seed."
        yield Drawing(f"training_{name}", caption, training_curves(params, name, root))
        if name in params.images:
            if drawn := goals(params, name, played, root):
                yield drawn
            data, size = values["sources"][name], params.images[name].preprocess.size
            caption = (
                f"{title}: frames of the play data ({data}), from the first to the last, as the encoder gets them after"
                f" preprocessing: {size} by {size} pixels."
            )
            yield Drawing(f"samples_{name}", caption, samples(root / paths.samples(name)))
            caption = (
                f"{title}: what a linear regression tells of the scene from the encoder's features of one frame, on"
                f" held-out episodes of the play data ({data}). Left: how often it is right about what has two states;"
                " right: its error about places and sizes, lower is better. Beside it, the same from an encoder with"
                " random weights and from the simulator's state itself; black lines: the best constant answer."
            )
            yield Drawing(f"probe_{name}", caption, probe(pd.read_csv(root / paths.probe(name))))
    for table in values["studies"].values():
        caption = f"{table.title}; bars are 95 % intervals, diamonds the paper's numbers where it has them."
        yield Drawing(f"study_{table.name}", caption, study(params.studies[table.name].changes, table, comparison))
    if params.fork:
        caption = "The fork, a toy: one state with two right actions, and the actions each method draws from it."
        yield Drawing("fork", caption, fork_samples(params, pd.read_csv(root / paths.FORK)))


def overview(params: Params, comparison: pd.DataFrame) -> Figure:
    """Ours over the paper's, as shares of the largest possible value: a panel an environment and metric."""
    both = comparison[comparison["paper"].notna() & comparison["ours"].notna()]
    shown = [
        (environment, metric, part)
        for environment in params.envs
        for metric in envs.report(environment).METRICS
        if len(part := both[(both["environment"] == environment) & (both["metric"] == metric.name)])
    ]
    known = set(comparison.loc[comparison["paper"].notna(), "method"])
    looks = itertools.cycle(zip(MARKERS, (*reversed(METHOD_COLOURS), "0.4"), strict=True))
    styles = {method: next(looks) for method in params.labels if method in known}
    drawn = [method for method in styles if method in set(both["method"])]
    across, margin = (8, 0.7) if len(drawn) <= 8 else (5, 0.9)  # the legend's columns, and room for its lines
    count = max(1, len(shown))
    figure, grid = panels(count, margin, min(4, 8 / min(count, PANELS_A_LINE)))  # squares: fewer are larger
    top = 1.08 + max([0.0, *(part["ours_high"].max() / metric.maximum - 1 for _, metric, part in shown)])
    for axis, (environment, metric, part) in zip(grid, shown, strict=False):
        axis.plot([0, 1], [0, 1], color="0.7", linewidth=1, zorder=0)
        for method, (marker, colour) in styles.items():
            for of_study in (True, False):  # cells above studies
                rows = part[(part["method"] == method) & (part["study"].notna() == of_study)]
                columns = ("paper", "ours", "ours_low", "ours_high", "paper_std")
                x, y, low, high, spread = (rows[column] / metric.maximum for column in columns)
                style: dict[str, Any] = {"markersize": 3, "fillstyle": "none"} if of_study else {"markersize": 5}
                style |= {"linestyle": "none", "elinewidth": 0.4 if of_study else 0.9, "markeredgewidth": 0.4}
                bars = {"yerr": (y - low, high - y), "xerr": spread.fillna(0)}
                axis.errorbar(x, y, **bars, marker=marker, color=colour, markeredgecolor="black", **style)
        axis.set(xlim=(-0.08, top), ylim=(-0.08, top), aspect="equal", xticks=[0, 0.5, 1], yticks=[0, 0.5, 1])
        axis.set_title(f"{envs.report(environment).LABEL},\n{metric.label}")
    look: dict[str, Any] = {"linestyle": "none", "markersize": 5, "markeredgewidth": 0.4, "markeredgecolor": "black"}
    keys = [Line2D([], [], marker=styles[method][0], color=styles[method][1], **look) for method in drawn]
    names = [params.labels[method] for method in drawn]
    figure.legend(keys, names, loc="outside lower center", ncols=across, frameon=False)
    for axis in grid:
        axis.set_xlabel("paper")
    grid[0].set_ylabel("ours")
    return figure


def study(changes: Sequence[dict[str, Any]], table: studies.Table, comparison: pd.DataFrame) -> Figure:
    """A study's scores, a panel a column: over what varies in numbers, if any, with a line for the rest.

    Args:
        changes: what each of its samplings changes.
    """
    keys = list(changes[0])
    numeric = [i for i, key in enumerate(keys) if all(pd.api.types.is_number(change[key]) for change in changes)]
    along = numeric[-1] if numeric else len(keys) - 1
    ticks = list(dict.fromkeys(row.labels[along] for row in table.rows))
    lines: dict[str, list[tuple[studies.Row, str]]] = {}
    for row, change in zip(table.rows, changes, strict=True):
        sampling = " ".join(f"{key}={value}" for key, value in change.items())
        lines.setdefault(", ".join(row.labels[:along] + row.labels[along + 1 :]), []).append((row, sampling))
    sets = len({column.goals for column in table.columns})
    figure = Figure(figsize=(7, 2.7 * sets), layout="constrained")
    axes = figure.subplots(sets, len(table.columns) // sets, sharex=True, squeeze=False).flat
    style = {"marker": "o", "markersize": 3, "linewidth": 1, "elinewidth": 0.8, "capsize": 2}
    style["linestyle"] = "-" if numeric else "none"
    for axis, (i, column) in zip(axes, enumerate(table.columns), strict=True):
        wanted = {"study": table.name, "metric": column.metric.name, "goals": column.goals}
        theirs = rows_of(comparison, wanted).drop_duplicates("values").set_index("values")["paper"]
        for n, ((label, rows), colour) in enumerate(zip(lines.items(), itertools.cycle(METHOD_COLOURS))):
            x = [ticks.index(row.labels[along]) + 0.5 * (n + 0.5 - len(lines) / 2) / len(lines) for row, _ in rows]
            means, _, low, high = np.array([row.scores[i].estimate for row, _ in rows]).T
            axis.errorbar(x, means, (means - low, high - means), color=colour, label=label, **style)
            papers = theirs.reindex([sampling for _, sampling in rows])
            colour = colour if len(lines) > 1 else COLOURS["paper"]
            axis.plot(x, papers, "D", color=colour, fillstyle="none", markersize=4)
        axis.set_xticks(range(len(ticks)), ticks, rotation=0 if numeric else 30, ha="center" if numeric else "right")
        axis.set(title=column.label, xlabel=table.varied[along] if numeric else "", xlim=(-0.5, len(ticks) - 0.5))
    if len(lines) > 1:
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", frameon=False)
    return figure


def scores(params: Params, comparison: pd.DataFrame, environment: str) -> Figure:
    """Bars of every metric by method, ours beside the paper's; lines are standard deviations over seeds."""
    metrics, methods = envs.report(environment).METRICS, [cell.method for cell in params.cells_in(environment)]
    comparison = of_cells(comparison)
    goal_sets = params.environments[environment].evaluation.goals
    figure = Figure(figsize=(7, 2.7), layout="constrained")
    axes = figure.subplots(1, len(metrics), sharey=True, squeeze=False)[0]
    colours = dict(zip(goal_sets, (COLOURS["ours"], COLOURS["held_out"]), strict=False))
    bars = [
        (goals, "ours", "ours_std", f"ours, {envs.report(environment).GOAL_LABELS[goals]}", colours[goals])
        for goals in colours
    ]
    if comparison["paper"].notna().any():
        bars.append((goal_sets[0], "paper", "paper_std", "paper", COLOURS["paper"]))
    places, width = np.arange(len(methods)), 0.8 / len(bars)
    for axis, metric in zip(axes, metrics, strict=True):
        for i, (goals, value, std, label, colour) in enumerate(bars):
            part = comparison[(comparison["metric"] == metric.name) & (comparison["goals"] == goals)]
            part = part.set_index("method").reindex(methods)
            offset = (i - (len(bars) - 1) / 2) * width
            axis.bar(places + offset, part[value], width, yerr=part[std], label=label, color=colour, capsize=2)
        axis.set_xticks(places, [params.labels[m] for m in methods], rotation=30, ha="right")
        axis.set_title(metric.label)
    axes[0].set_ylabel(envs.report(environment).LABEL)
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(bars), frameon=False)
    return figure


def samples(path: Path) -> Figure:
    """A picture of beso.images.frames.write_samples."""
    picture = matplotlib.image.imread(path)
    figure = Figure(figsize=(7, 7 * picture.shape[0] / picture.shape[1]))
    axis = figure.add_axes((0, 0, 1, 1))
    axis.imshow(picture)
    axis.set_axis_off()
    return figure


def goals(params: Params, environment: str, episodes: Episodes, root: Path) -> Drawing | None:
    """Where an episode of each single task starts, its goal image, and what the filmed methods left, a row an episode.

    None where there is no list of single tasks or no method is filmed.

    Args:
        episodes: rows of evaluation by the methods' labels.
    """
    settings = params.environments[environment]
    filmed = [cell for cell in params.cells_in(environment) if cell.evaluate.film]
    if not filmed or not settings.evaluation.tasks:
        return None
    seed, goal_set, metric = settings.seeds[0], settings.evaluation.goals[0], envs.report(environment).METRICS[0]
    labels = [params.labels[cell.method] for cell in filmed]
    wanted = {"seed": seed, "goals": goal_set}
    played = {label: rows_of(episodes[label], wanted).set_index("episode") for label in labels}
    scenes = [read_npy(root / cell.scenes) for cell in filmed]  # each (episodes, 3, H, W, 3)
    count = len(scenes[0])
    figure = Figure(figsize=(7, 0.3 + (6.1 / (2 + len(filmed)) + 0.17) * count))
    figure.set_layout_engine("constrained", w_pad=0.02, h_pad=0.01, wspace=0, hspace=0)
    grid = figure.subplots(count, 2 + len(filmed), squeeze=False)
    for axis, title in zip(grid[0], ("start", "goal", *labels), strict=True):
        axis.set_title(title)
    for axis in grid.flat:
        axis.set(xticks=[], yticks=[])
        axis.spines[:].set_visible(False)
    for i, line in enumerate(grid):
        for axis, picture in zip(line, (*scenes[0][i, :2], *(ends[i, 2] for ends in scenes)), strict=True):
            axis.imshow(picture)
        for axis, label in zip(line[2:], labels, strict=True):
            row = played[label].loc[i]
            axis.set_xlabel(f"{metric.label.lower()} {row[metric.name]:g}, {row['length']} actions", fontsize=6)
            if row[metric.name] == metric.maximum:
                axis.spines[:].set(visible=True, color=GREEN, linewidth=2)
        task = settings.evaluation.tasks[i].replace("_", " ")
        line[0].set_ylabel(textwrap.fill(task, 11), rotation=0, ha="right", va="center")
    caption = (
        f"{envs.report(environment).LABEL}, an episode of each single task: its start, its goal image, and the last"
        f" picture of the rollouts of {', '.join(labels)} (model seed {seed}); green frames: {metric.label.lower()}."
    )
    return Drawing(f"goals_{environment}", caption, figure)


def probe(table: pd.DataFrame) -> Figure:
    """What features tell linearly: accuracies, and errors over those of a constant answer, by representation.

    Args:
        table: of beso.images.probe.probe.
    """
    figure = Figure(figsize=(7, 2.7), layout="constrained")
    parts = [table[table["measure"] == measure] for measure in ("accuracy", "error")]
    axes = figure.subplots(1, 2, gridspec_kw={"width_ratios": [part["target"].nunique() for part in parts]})
    names = list(dict.fromkeys(table["representation"]))
    width = 0.8 / len(names)
    for axis, part, label in zip(axes, parts, ("accuracy", "error over that of a constant"), strict=True):
        targets = list(dict.fromkeys(part["target"]))
        places = np.arange(len(targets))
        for i, (name, colour) in enumerate(zip(names, METHOD_COLOURS, strict=False)):
            rows = part[part["representation"] == name].set_index("target").loc[targets]
            heights = rows["value"] / (1 if label == "accuracy" else rows["constant"])
            axis.bar(places + (i - (len(names) - 1) / 2) * width, heights, width, label=name, color=colour)
        axis.set_xticks(places, [target.replace("_", " ") for target in targets], rotation=30, ha="right")
        axis.set_ylabel(label)
    constants = parts[0].drop_duplicates("target")["constant"]
    axes[0].hlines(constants, np.arange(len(constants)) - 0.45, np.arange(len(constants)) + 0.45, color="black")
    axes[0].set_ylim(0, 1)
    axes[1].axhline(1, color="black")
    handles, labels = axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(names), frameon=False)
    return figure


def fork_samples(params: Params, table: pd.DataFrame) -> Figure:
    """Actions of the demonstrations and of every method on the fork, a panel each."""
    shown = table["method"].unique()
    figure, grid = panels(len(shown), 0.4, 1.1)
    for axis, method in zip(grid, shown, strict=False):
        part = table[table["method"] == method]
        colour = COLOURS["paper"] if method == "data" else COLOURS["ours"]
        axis.scatter(part["x"], part["y"], s=2, color=colour, linewidths=0)
        axis.set_title("demonstrations" if method == "data" else params.labels.get(method, words(method)))
        axis.set(xlim=(-1.2, 1.2), ylim=(-0.3, 0.9))
    figure.supxlabel("action, first entry")
    figure.supylabel("second entry")
    return figure


def training_curves(params: Params, environment: str, root: Path) -> Figure:
    """Held-out loss over its first measurement against the share of the training, a line a seed."""
    figure = Figure(figsize=(4.7, 2.4), layout="constrained")
    axis = figure.subplots()
    for cell, colour in zip(params.cells_in(environment), itertools.cycle(METHOD_COLOURS)):
        curves = pd.read_csv(root / cell.curve)
        for i, seed in enumerate(cell.train.seeds):
            label, losses = params.labels[cell.method] if i == 0 else None, curves[f"validation_loss_seed{seed}"]
            share = curves["step"] / curves["step"].iloc[-1]
            axis.plot(share, losses / losses.iloc[0], color=colour, linewidth=1, label=label)
    axis.set(xlabel="share of the training", ylabel="held-out loss,\nover the first measured")
    figure.legend(loc="outside right upper", frameon=False)
    return figure
