"""Archived runs: what can be archived by itself, the records beside it, and what an archive's folder has."""

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from beso.errors import UserError
from beso.files import read_json
from pipeline import paths
from pipeline.params import PATH, Params
from pipeline.profile import leaves


@dataclass(frozen=True)
class Part:
    """What can be archived by itself: a cell, a study, or the fork.

    Attributes:
        stage: its address in dvc.yaml.
        rows: the file of its rows.
        keys: of the parameters that its rows depend on, dotted.
        cell: name of the cell, which for a study is the one that is sampled; None for the fork.
        env, method: of the cell.
    """

    stage: str
    rows: Path
    keys: tuple[str, ...]
    cell: str | None = None
    env: str = ""
    method: str = ""

    @property
    def is_cell(self) -> bool:
        """Whether it is a cell, not a study of one."""
        return self.stage == f"evaluate@{self.cell}"

    @property
    def record(self) -> Path:
        """The file beside its rows."""
        return self.rows.with_suffix(".json")


def parts(params: Params) -> dict[str, Part]:
    """All that a run of these parameters can archive, by stage, in the order of the parameters."""
    found: dict[str, Part] = {}
    keys_of: dict[str, tuple[str, ...]] = {}
    for name, cell in params.cells.items():
        methods = dict.fromkeys((cell.of, cell.method))
        own = [f"methods.{m}.{use}.{cell.env}" for m in methods for use in ("train", "sample")]
        if teacher := params.teacher(cell.env, cell.method):
            of_teacher = dict.fromkeys((params.cell(cell.env, teacher).of, teacher))
            own += [f"cells.{name}.source", *(f"methods.{m}.train.{cell.env}" for m in of_teacher)]
        keys_of[name] = ("seed", f"environments.{cell.env}", f"images.{cell.env}", *own)
        rows = paths.episodes(cell.env, cell.method)
        found[f"evaluate@{name}"] = Part(f"evaluate@{name}", rows, keys_of[name], name, cell.env, cell.method)
    for name, study in params.studies.items():
        cell_name = f"{study.env}-{study.method}"
        keys = (*keys_of[cell_name], f"studies.{name}")
        found[f"study@{name}"] = Part(f"study@{name}", paths.study(name), keys, cell_name, study.env, study.method)
    found["fork"] = Part("fork", paths.FORK, ("seed", "fork"))
    return found


def parameters(values: Any, keys: Iterable[str]) -> dict[str, Any]:
    """The leaves below some keys of params.yaml; keys that are not there have none."""
    found: dict[str, Any] = {}
    for key in keys:
        inner = values
        for name in key.split("."):
            inner = inner.get(name) if isinstance(inner, dict) else None
        if inner is not None:
            found |= dict(leaves(inner, key))
    return json.loads(json.dumps(found))  # as a record has them


def held(folder: Path, available: dict[str, Part]) -> list[Part]:
    """The parts that an archive has.

    Raises:
        UserError: it has rows without a record, or of what params.yaml does not have.
    """
    rows = {path.relative_to(folder): path for path in folder.glob("results/*/*.csv") if path.parent.name != "probe"}
    of_rows = {part.rows: part for part in available.values()}
    for name, path in rows.items():
        if not path.with_suffix(".json").is_file():
            raise UserError(f"{folder} was archived by an older version: remove it (`git rm -r {folder}`) first")
        if name not in of_rows:
            raise UserError(f"{folder / name} is of no cell or study in {PATH}: remove it and its .json first")
    return [part for part in available.values() if (folder / part.record).is_file()]


def check(part: Part, folder: Path, wanted: dict[str, Any]) -> None:
    """Compare the record of an archived part with what it is to stand beside.

    Raises:
        UserError: naming the first difference.
    """
    record = read_json(folder / part.record)
    for kind, expected in wanted.items():
        found = record.get(kind)
        if found == expected:
            continue
        difference = f"{kind} {found!r} there and {expected!r} here"
        if isinstance(found, dict):
            missing = "nothing"
            key = next(k for k in sorted({*found, *expected}) if found.get(k, missing) != expected.get(k, missing))
            difference = f"{key} is {found.get(key, missing)!r} there and {expected.get(key, missing)!r} here"
        raise UserError(
            f"{folder} has {part.stage} of other {kind}: {difference}; archive it anew, or drop it:"
            f" `beso publish --drop {part.stage}`"
        )


def restricted(params: Params, there: list[Part]) -> Params:
    """The parameters of a run that has these parts alone."""
    cells = {name: cell for name, cell in params.cells.items() if any(p.is_cell and p.cell == name for p in there)}
    stages = {part.stage for part in there}
    for part in there:
        if part.cell and part.cell not in cells:
            raise UserError(f"{part.stage} is of cell {part.cell}, which is not archived: add evaluate@{part.cell}")
    return replace(
        params,
        cells=cells,
        studies={name: study for name, study in params.studies.items() if f"study@{name}" in stages},
        films={name: cell for name, cell in params.films.items() if name in cells},
        fork=params.fork if "fork" in stages else replace(params.fork, methods={}),
    )
