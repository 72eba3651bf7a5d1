"""The episodes of an environment's evaluation on disk, made once and read by all that play them.

    trials.json   for each trial its goal set, model seed, number, seed, tasks, limit and labels; SHA-256 of the arrays
    <option>.npy  (trials, ...) an array for each option of the environment's reset

Row i of the arrays belongs to entry i of the list. Trials of one goal set and model seed are numbered from 0.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beso.data import store
from beso.envs.protocol import Trial
from beso.errors import UserError
from beso.files import replacing, write_text

Trials = Mapping[tuple[str, int], Sequence[Trial]]  # by goal set and model seed, in the order of their numbers
DESCRIPTION = "trials.json"
FIELDS = {"goals": str, "model_seed": int, "number": int, "seed": int, "tasks": list, "limit": int, "labels": dict}


def save(trials: Trials, folder: Path) -> None:
    """Write trials as a folder, atomically.

    Raises:
        ValueError: the trials do not all have the same options, of the same shapes.
    """
    entries, options = [], []
    for (goals, model_seed), of_model in trials.items():
        for number, trial in enumerate(of_model):
            entry = {"seed": trial.seed, "tasks": list(trial.tasks), "limit": trial.limit, "labels": trial.labels}
            entries.append({"goals": goals, "model_seed": model_seed, "number": number, **entry})
            options.append(trial.options)
    if any(option.keys() != options[0].keys() for option in options):
        raise ValueError("trials with different options")
    with replacing(folder) as temporary:
        temporary.mkdir()
        for name in options[0]:
            store.write_npy(temporary / f"{name}.npy", np.stack([option[name] for option in options]))
        digests = store.digests(temporary, options[0])
        # Not sorted: the order of labels is that of the rows' columns.
        write_text(temporary / DESCRIPTION, json.dumps({"sha256": digests, "trials": entries}, indent=1) + "\n")


def load(folder: Path) -> Trials:
    """Read and check the trials of one environment.

    Raises:
        UserError: the folder or a file is missing, truncated or altered.
    """
    path = folder / DESCRIPTION
    missing = "has no trials.json: run `dvc repro trials`"
    options, description = store.read(folder, None, missing, description=DESCRIPTION)
    entries = description.get("trials")
    if not (isinstance(entries, list) and entries and all(map(_is_entry, entries))):
        raise UserError(f"{path} is damaged: it must hold trials, each with {', '.join(FIELDS)}, limit above 0")
    for name, array in options.items():
        if array.shape[:1] != (len(entries),):
            shape, count = array.shape, len(entries)
            raise UserError(f"{folder / name}.npy has shape {shape}, expected a row for each of {count} trials")
    trials: dict[tuple[str, int], list[Trial]] = {}
    for i, entry in enumerate(entries):
        of_model = trials.setdefault((entry["goals"], entry["model_seed"]), [])
        if entry["number"] != len(of_model):
            raise UserError(f"{path} is damaged: trial {len(of_model)} is missing before trial {entry['number']}")
        own = {name: np.array(array[i]) for name, array in options.items()}
        of_model.append(Trial(entry["seed"], own, tuple(entry["tasks"]), entry["limit"], entry["labels"]))
    return trials


def _is_entry(entry: Any) -> bool:
    if not (isinstance(entry, dict) and all(type(entry.get(name)) is kind for name, kind in FIELDS.items())):
        return False
    whole = all(type(task) is int and task >= 0 for task in entry["tasks"])
    return whole and entry["limit"] >= 1 and min(entry["seed"], entry["number"]) >= 0


def pick(trials: Trials, goals: str, model_seed: int, numbers: Iterable[int]) -> list[Trial]:
    """Some trials of one goal set and model seed.

    Raises:
        UserError: they were not made.
    """
    of_model = trials.get((goals, model_seed), [])
    for number in numbers:
        if number >= len(of_model):
            raise UserError(
                f"episode {number} with goal set {goals} and seed {model_seed} was not made: there are {len(of_model)};"
                " `rollouts`, `goals` and `seeds` of the environment say how many, `dvc repro trials` makes them"
            )
    return [of_model[number] for number in numbers]
