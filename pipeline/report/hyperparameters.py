"""The appendix's hyper-parameter tables, made from parameters: this run's values beside the paper profile's."""

import dataclasses
from collections import Counter
from typing import Any

from pipeline import profile
from pipeline.params import Cell, Params
from pipeline.report.names import Names


def tables(params: Params) -> list[dict[str, Any]]:
    """One table for each cell: its title, and rows of name, ours and the paper's (a dash where it has no such cell)."""
    paper, names = profile.load(profile.COMPLETE), Names(params)
    found = []
    for key, cell in params.cells.items():
        ours = _values(cell)
        theirs = _values(paper.cells[key]) if key in paper.cells else dict.fromkeys(ours, "--")
        title = f"{names.methods[cell.method]}, {names.environments[cell.env]}"
        found.append({"title": title, "rows": [(name, ours[name], theirs[name]) for name in ours]})
    return found


def by_method(params: Params) -> dict[str, list[dict[str, Any]]]:
    """The same tables, by the method's file: a variant's stand with those of the method that it changes."""
    found: dict[str, list[dict[str, Any]]] = {}
    for cell, table in zip(params.cells.values(), tables(params), strict=True):
        found.setdefault(cell.of, []).append(table)
    return found


def shares_of_training(params: Params) -> list[dict[str, Any]]:
    """For each environment, by method: training samples (steps times batch) here over those of the paper profile."""
    paper, names = profile.load(profile.COMPLETE), Names(params)
    found = []
    for environment in params.envs:
        shares = {
            names.methods[cell.method]: _samples(cell) / _samples(paper.cells[cell.name])
            for cell in params.cells_in(environment)
            if cell.name in paper.cells
        }
        found.append({"environment": names.environments[environment], "shares": shares})
    return found


def trains_less(params: Params) -> bool:
    """Whether some cell trains with fewer samples than the paper profile's."""
    return any(
        share < 1 for of_environment in shares_of_training(params) for share in of_environment["shares"].values()
    )


def _samples(cell: Cell) -> int:
    optimization = cell.train.first.config.optimization
    return optimization.steps * optimization.batch_size


def _values(cell: Cell) -> dict[str, str]:
    """A cell's values by name: the innermost key, with the part before it in sampling and where two parts have it."""
    parts = {
        "model": dataclasses.asdict(cell.train.first.config.model),
        "optimization": dataclasses.asdict(cell.train.first.config.optimization),
        "sampling": dataclasses.asdict(cell.evaluate.sampling),
    }
    found = [
        (part, key.split(".")[-1], value) for part, of in parts.items() for key, value in profile.leaves(of) if key
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
