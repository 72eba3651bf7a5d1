"""What figures of the report share, those of the rooms and those of all environments."""

import math

from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Wong's colours, told apart with any colour vision (Nature Methods 8, 441, 2011).
COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9", "#F0E442", "#000000")


PANELS_A_LINE = 5


def panels(count: int, margin: float, height: float) -> tuple[Figure, list[Axes]]:
    """A page-wide figure of `count` panels alike, five a line.

    Args:
        margin, height: inches, of what is not panels and of a line of them.

    Returns:
        The figure and all places of its grid; those beyond `count` are empty.
    """
    columns = min(PANELS_A_LINE, count)
    lines = math.ceil(count / columns)
    figure = Figure(figsize=(7, margin + height * lines), layout="constrained")
    grid = figure.subplots(lines, columns, sharex=True, sharey=True, squeeze=False).flatten()
    for axes in grid[count:]:
        axes.set_axis_off()
    return figure, list(grid)
