"""Figures of the report, as PDF and PNG with reproducible bytes."""

import io
import itertools
import math
from pathlib import Path

import matplotlib
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from beso.files import replacing
from pipeline import names, paths
from pipeline.params import Params

# Wong's colours, told apart with any colour vision.
COLOURS = {"ours": "#0072B2", "held_out": "#56B4E9", "paper": "#E69F00"}
METHOD_COLOURS = ["#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442", "#000000"]
STYLE = {"font.size": 8, "axes.spines.top": False, "axes.spines.right": False, "pdf.fonttype": 42, "savefig.dpi": 200}


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write one figure as PDF and PNG without dates or version strings."""
    without = {"pdf": ("CreationDate", "Producer", "Creator"), "png": ("Software",)}
    for kind, keys in without.items():
        drawn = io.BytesIO()  # matplotlib hides a full disk behind errors of its own
        figure.savefig(drawn, format=kind, metadata=dict.fromkeys(keys))
        (folder / f"{name}.{kind}").write_bytes(drawn.getvalue())


def draw_all(params: Params, comparison: pd.DataFrame, folder: Path) -> None:
    """Draw every figure into `folder`, replacing it whole."""
    with replacing(folder) as temporary, matplotlib.rc_context(STYLE):
        temporary.mkdir()
        for environment in params.grid.envs:
            part = comparison[comparison["environment"] == environment]
            save(scores(params, part), temporary, f"scores_{environment}")
            save(training_curves(params, environment), temporary, f"training_{environment}")
        save(fork_samples(params), temporary, "fork")


def scores(params: Params, comparison: pd.DataFrame) -> Figure:
    """Bars of reward and result by method, ours beside the paper's; lines are standard deviations over seeds."""
    figure = Figure(figsize=(7, 2.7), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    bars = [("training", "ours", "ours_std", "ours, training goals", COLOURS["ours"])]
    if "held_out" in params.evaluation.goals:
        bars.append(("held_out", "ours", "ours_std", "ours, held-out goals", COLOURS["held_out"]))
    bars.append(("training", "paper", "paper_std", "paper", COLOURS["paper"]))
    places, width = np.arange(len(params.grid.methods)), 0.8 / len(bars)
    for axis, metric in zip(axes, names.METRICS, strict=True):
        for i, (goals, value, std, label, colour) in enumerate(bars):
            part = comparison[(comparison["metric"] == metric) & (comparison["goals"] == goals)].set_index("method")
            part = part.reindex(params.grid.methods)
            offset = (i - (len(bars) - 1) / 2) * width
            axis.bar(places + offset, part[value], width, yerr=part[std], label=label, color=colour, capsize=2)
        axis.set_xticks(places, [names.METHODS[m] for m in params.grid.methods], rotation=30, ha="right")
        axis.set_title(names.METRICS[metric])
    axes[0].set_ylabel(names.ENVIRONMENTS[comparison["environment"].iloc[0]])
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=len(bars), frameon=False)
    return figure


def fork_samples(params: Params) -> Figure:
    """Actions of the demonstrations and of every method on the fork, a panel each."""
    table = pd.read_csv(paths.FORK)
    panels = ["data", *params.grid.methods]
    columns = min(5, len(panels))
    rows = math.ceil(len(panels) / columns)
    figure = Figure(figsize=(7, 0.4 + 1.1 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).flatten()
    for axis, method in zip(grid, panels, strict=False):
        part = table[table["method"] == method]
        colour = COLOURS["paper"] if method == "data" else COLOURS["ours"]
        axis.scatter(part["x"], part["y"], s=2, color=colour, linewidths=0)
        axis.set_title("demonstrations" if method == "data" else names.METHODS[method])
        axis.set(xlim=(-1.2, 1.2), ylim=(-0.3, 0.9))
    for axis in grid[len(panels) :]:
        axis.set_axis_off()
    figure.supxlabel("action, first entry")
    figure.supylabel("second entry")
    return figure


def training_curves(params: Params, environment: str) -> Figure:
    """Held-out error of generated actions against training steps, a line a seed."""
    figure = Figure(figsize=(4.7, 2.4), layout="constrained")
    axis = figure.subplots()
    for method, colour in zip(params.grid.methods, itertools.cycle(METHOD_COLOURS)):
        curves = pd.read_csv(paths.curve(environment, method))
        for i, seed in enumerate(params.seeds):
            label = names.METHODS[method] if i == 0 else None
            axis.plot(curves["step"], curves[f"validation_error_seed{seed}"], color=colour, linewidth=1, label=label)
    axis.set(xlabel="training step", ylabel="held-out action error\n(squared, scaled units)", yscale="log")
    figure.legend(loc="outside right upper", frameon=False)
    return figure
