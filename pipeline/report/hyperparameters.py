"""The appendix's hyper-parameter tables, made from parameters: this run's values beside the paper profile's."""

import dataclasses
from typing import Any

from pipeline import profile
from pipeline.params import Params
from pipeline.report.names import Names


def tables(params: Params) -> list[dict[str, Any]]:
    """One table for each cell: its title, and rows of name, ours and the paper's (a dash where it has no such cell)."""
    paper, names = profile.load(profile.COMPLETE), Names(params)
    found = []
    for key, cell in params.cells.items():
        ours = _values(params, cell.env, cell.method)
        theirs = _values(paper, cell.env, cell.method) if key in paper.cells else dict.fromkeys(ours, "--")
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
            names.methods[method]: _samples(params, environment, method) / _samples(paper, environment, method)
            for method in params.methods_in(environment)
            if f"{environment}-{method}" in paper.cells
        }
        found.append({"environment": names.environments[environment], "shares": shares})
    return found


def trains_less(params: Params) -> bool:
    """Whether some cell trains with fewer samples than the paper profile's."""
    return any(
        share < 1 for of_environment in shares_of_training(params) for share in of_environment["shares"].values()
    )


def _samples(params: Params, environment: str, method: str) -> int:
    optimization = params.methods[method].train[environment].optimization
    return optimization.steps * optimization.batch_size


def _values(params: Params, environment: str, method: str) -> dict[str, str]:
    training = dataclasses.asdict(params.methods[method].train[environment])
    sampling = dataclasses.asdict(params.sampling(environment, method))
    return {**_flat(training["model"]), **_flat(training["optimization"]), **_flat(sampling, "sampling: ")}


def _flat(values: dict[str, Any], prefix: str = "") -> dict[str, str]:
    """Nested mappings as one, named by their innermost keys in words."""
    flat: dict[str, str] = {}
    for name, value in values.items():
        if isinstance(value, dict):
            flat |= _flat(value, prefix)
        else:
            flat[prefix + name.replace("_", " ")] = _text(value)
    return flat


def _text(value: Any) -> str:
    if value is None:
        return "all"
    return f"{value:g}" if isinstance(value, float) else str(value).replace("_", " ")
