"""Archived runs: what can be archived by itself, the records beside it, and what an archive's folder has."""

import json
from dataclasses import asdict, dataclass, is_dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import safetensors.numpy
from safetensors import safe_open

from beso.data import play
from beso.data.play import PlayDataset
from beso.errors import UserError
from beso.files import read_json, write_json
from beso.policy import EVALUATION
from pipeline import paths
from pipeline.params import PATH, Cell, Params
from pipeline.profile import leaves

SAMPLE: Final = "observations.safetensors"  # some of the observations, with the digest of their play data
SAMPLED: Final = 64  # of them, spread evenly
# Of features, as a share of their spread. Another processor changes 5e-7 of it, half-precision weights of the encoder
# 0.1 % (0.9 % where it computes in bf16), an encoder trained anew about all of it: measured with 100 frames of CALVIN
# and the archived encoder of width 16. An encoder that is hardly trained, as in profile smoke, changes more: 5 %.
TOLERANCE: Final = 0.1


@dataclass(frozen=True)
class Part:
    """What can be archived by itself: a cell, a study, or the fork.

    Attributes:
        stage: its address in dvc.yaml.
        rows: the file of its rows.
        parameters: all that its rows depend on, with dotted keys, as they stand in the record beside them.
        cell: the cell, which for a study is the one that is sampled; None for the fork.
    """

    stage: str
    rows: Path
    parameters: dict[str, Any]
    cell: Cell | None = None

    @property
    def env(self) -> str:
        """Its environment; none for the fork."""
        return self.cell.env if self.cell else ""

    @property
    def evaluated(self) -> Cell | None:
        """The cell whose evaluation it is; None for a study and the fork."""
        return self.cell if self.cell and self.stage == f"evaluate@{self.cell.name}" else None

    @property
    def record(self) -> Path:
        """The file beside its rows."""
        return self.rows.with_suffix(".json")


def parts(params: Params) -> dict[str, Part]:
    """All that a run of these parameters can archive, by stage, in the order of the parameters."""
    found: dict[str, Part] = {}
    for name, cell in params.cells.items():
        told: dict[str, Any] = {"collect": params.environments[cell.env].collect, "images": params.images.get(cell.env)}
        told |= {"train": cell.train, "evaluate": replace(cell.evaluate, film=False)}
        if cell.train.teacher:
            told["teacher"] = params.cell(cell.env, cell.train.teacher).train
        found[f"evaluate@{name}"] = Part(f"evaluate@{name}", cell.episodes, _leaves(told), cell)
    for name, study in params.studies.items():
        of_cell = found[f"evaluate@{study.name}"].parameters
        told = {key: value for key, value in of_cell.items() if not key.startswith("evaluate.")}
        told |= _leaves({"study": study})
        found[f"study@{name}"] = Part(f"study@{name}", study.rows, told, params.cells[study.name])
    if params.fork:
        found["fork"] = Part("fork", paths.FORK, _leaves({"seed": params.seed, "fork": params.fork}))
    return found


def _leaves(told: dict[str, Any]) -> dict[str, Any]:
    """The leaves of what stages are told, as JSON has them."""
    plain = {key: asdict(value) if is_dataclass(value) else value for key, value in told.items()}  # type: ignore[arg-type]
    return dict(leaves(json.loads(json.dumps(plain))))


def write_evaluation(cell: Cell, folder: Path) -> None:
    """Write into a model's folder how its policy is sampled in the evaluation, for `Policy.load`."""
    write_json(folder / EVALUATION, {"env": cell.env, "sampling": asdict(cell.evaluate.sampling)})


def write_sample(dataset: PlayDataset, path: Path) -> None:
    """Write some observations, for `same_features`."""
    rows = np.ascontiguousarray(dataset.observations[_sampled(len(dataset.observations))])
    path.write_bytes(safetensors.numpy.save({"observations": rows}, {"data": play.data_digest(dataset)}))


def same_features(dataset: PlayDataset, path: Path) -> str | None:
    """The digest of the play data of a sample, if these differ from it in features alone, by at most `TOLERANCE`."""
    if not path.is_file():
        return None
    with safe_open(path, "numpy") as file:
        theirs, digest = file.get_tensor("observations"), str((file.metadata() or {}).get("data"))
    ours = dataset.observations[_sampled(len(dataset.observations))]
    _, *others = play.data_digest(dataset).split("-")  # the first is of the observations
    if others != digest.split("-")[1:] or ours.shape != theirs.shape:
        return None
    spread = np.sqrt(np.mean(np.var(theirs, axis=0)))
    return digest if np.sqrt(np.mean((ours - theirs) ** 2)) <= TOLERANCE * spread else None


def _sampled(steps: int) -> list[int]:
    return np.linspace(0, steps - 1, SAMPLED).astype(int).tolist()


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
    cells = {cell.name: cell for part in there if (cell := part.evaluated)}
    stages = {part.stage for part in there}
    for part in there:
        if part.cell and part.cell.name not in cells:
            raise UserError(
                f"{part.stage} is of cell {part.cell.name}, which is not archived: add evaluate@{part.cell.name}"
            )
    return replace(
        params,
        cells={name: cell for name, cell in params.cells.items() if name in cells},
        studies={name: study for name, study in params.studies.items() if f"study@{name}" in stages},
        fork=params.fork if "fork" in stages else None,
    )
