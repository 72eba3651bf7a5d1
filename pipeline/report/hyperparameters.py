"""The appendix's hyper-parameter tables, made from parameters: this run's values beside the paper profile's."""

import dataclasses
from collections import Counter
from typing import Any

from beso import envs
from pipeline import profile
from pipeline.params import Cell, Params


def tables(params: Params) -> list[dict[str, Any]]:
    """One table for each cell.

    `environment` and `method` are labels, `of` is the method's file; `rows` are name, ours and the paper's (a dash
    where it has no such cell); `share` is that of training samples (steps times batch), ours over the paper's, or None.
    """
    paper, found = profile.load(profile.COMPLETE).cells, []
    for key, cell in params.cells.items():
        ours = _values(cell)
        theirs = _values(paper[key]) if key in paper else dict.fromkeys(ours, "--")
        found.append(
            {
                "environment": envs.report(cell.env).LABEL,
                "method": params.labels[cell.method],
                "of": cell.of,
                "rows": [(name, ours[name], theirs[name]) for name in ours],
                "share": _samples(cell) / _samples(paper[key]) if key in paper else None,
            }
        )
    return found


def _samples(cell: Cell) -> int:
    optimization = cell.train.first.config.optimization
    return optimization.steps * optimization.batch_size


def _values(cell: Cell) -> dict[str, str]:
    """A cell's values by name.

    A name is the innermost key. The part stands before it in sampling, and where two parts have the same key.
    """
    config = cell.train.first.config
    parts = {"model": config.model, "optimization": config.optimization, "sampling": cell.evaluate.sampling}
    found = [
        (part, key.split(".")[-1], value)
        for part, of in parts.items()
        for key, value in profile.leaves(dataclasses.asdict(of))
        if key
    ]
    count = Counter(name for part, name, _ in found if part != "sampling")
    return {
        (f"{part}: " if part == "sampling" or count[name] > 1 else "") + name.replace("_", " "): _text(value)
        for part, name, value in found
    }


def _text(value: Any) -> str:
    if value is None:
        return "all"
    return f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")
