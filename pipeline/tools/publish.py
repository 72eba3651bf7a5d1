"""`beso publish [NAME ...]` archives what is finished in reports/published/<profile>/.

A NAME is a stage (`evaluate@block_push-c_beso`, `study@noise_block_push`, `fork`) or an environment, which stands for
its finished cells and studies; without any, everything finished is meant: what DVC would not run again. What the
archive has of other cells stays, if it was made with the same parameters and data, so that a long run can be archived
in several sittings. Then tables, comparison, metrics and figures are made from all that the archive has, as the stage
`tables` makes them.

The folder is laid out as the repository, the report's files at its top. Beside the rows of each cell and study lies a
record, `<name>.json`: its parameters, the digest of the play data, versions. Of play data there is a summary, of trials
the first ones, and of weights those of the first seed where `--weights METHOD` asks for them, in half precision:

    beso publish --weights c_beso

`beso watch CELL --run FOLDER` films these. `--drop NAME` takes out a stage or an environment.
"""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import safetensors.torch
import torch

from beso import envs
from beso.core import checkpoint
from beso.data import play
from beso.encoders import encoder
from beso.errors import UserError
from beso.evaluation import trials
from beso.files import read_json, replacing, sha256, write_json, write_text
from pipeline import paths
from pipeline.params import PATH, Params, load
from pipeline.report.gather import SUMMARY, summary, write_tables
from pipeline.report.page import versions
from pipeline.run import plan
from pipeline.tools.archive import Part, check, held, parts, restricted

FOLDER = paths.REPORTS / "published"
LARGEST = 2_000_000  # bytes of a file of weights: git keeps every version for ever


def choose(available: dict[str, Part], names: Sequence[str]) -> list[Part]:
    """The finished parts among those named, or all finished ones.

    Raises:
        UserError: an unknown name, or nothing finished of it.
    """
    named = {name: [p for p in available.values() if name in (p.stage, p.env)] for name in names}
    for name, of_name in named.items():
        if not of_name:
            raise UserError(f"{name!r} is neither an environment nor one of {', '.join(available)}")
    wanted = {p.stage: p for of_name in named.values() for p in of_name} if names else available
    stale = plan([p.stage for p in wanted.values()])
    for name, of_name in named.items():
        if all(p.stage in stale for p in of_name):
            raise UserError(f"{name} is not finished: run `beso run {' '.join(p.stage for p in of_name)}`")
    return [p for p in wanted.values() if p.stage not in stale]


def drop(part: Part, folder: Path) -> None:
    """Take a part out of an archive's folder."""
    (folder / part.rows).unlink(missing_ok=True)
    (folder / part.record).unlink(missing_ok=True)
    if part.cell and part.is_cell:
        shutil.rmtree(folder / part.cell.models, ignore_errors=True)
        (folder / part.cell.curve).unlink(missing_ok=True)
        (folder / part.cell.scenes).unlink(missing_ok=True)


def add(part: Part, folder: Path, record: dict[str, Any], with_weights: bool) -> None:
    """Copy a finished part into an archive's folder, in place of what it has of it."""
    drop(part, folder)
    _copy(part.rows, folder)
    if part.cell and part.is_cell:
        cell, seeds = part.cell, part.cell.train.seeds
        _copy(cell.curve, folder)
        if cell.evaluate.film and cell.evaluate.evaluation.tasks:
            _copy(cell.scenes, folder)
        for seed in seeds:
            _copy(checkpoint.paths(cell.models, seed)[1], folder)
        if with_weights:
            weights = checkpoint.paths(cell.models, seeds[0])[0]
            halve(weights, folder / weights)
    write_json(folder / part.record, record)


def drop_environment(environment: str, folder: Path) -> None:
    """Take what the cells of an environment share out of an archive's folder."""
    for path in (paths.play(environment), paths.trials(environment)):
        shutil.rmtree(folder / path, ignore_errors=True)
    for path in (paths.samples(environment), paths.probe(environment)):
        (folder / path).unlink(missing_ok=True)


def add_environment(params: Params, environment: str, folder: Path) -> None:
    """Write into an archive's folder what its cells of an environment share."""
    drop_environment(environment, folder)
    target = folder / paths.play(environment)
    write_text(target / SUMMARY, json.dumps(summary(Path(), environment)) + "\n")
    settings = params.environments[environment]
    first = (settings.evaluation.goals[0], settings.seeds[0])
    made = trials.load(paths.trials(environment))
    trials.save({first: made[first][: settings.evaluation.chunk]}, folder / paths.trials(environment))
    if environment in params.images:
        _copy(paths.samples(environment), folder)
        _copy(paths.probe(environment), folder)
        halve(paths.play(environment) / encoder.WEIGHTS, target / encoder.WEIGHTS)
        description = read_json(paths.play(environment) / encoder.DESCRIPTION)
        write_json(target / encoder.DESCRIPTION, description | {"sha256": sha256(target / encoder.WEIGHTS)})


def halve(weights: Path, target: Path) -> None:
    """Write weights in half precision, which loading turns back; what half precision cannot hold stays as it is."""
    tensors = safetensors.torch.load_file(weights)
    halves = {name: value.half() if value.dtype == torch.float32 else value for name, value in tensors.items()}
    kept = {name: half if half.isfinite().all() else tensors[name] for name, half in halves.items()}
    target.parent.mkdir(parents=True, exist_ok=True)
    with replacing(target) as temporary:
        temporary.write_bytes(safetensors.torch.save(kept))


def limit_weights(folder: Path) -> None:
    """Remove weights that are too large for git, or whose encoder is, and say so; and encoders of no policy."""
    for weights in sorted(folder.glob("models/*/*/*.safetensors")):
        environment, method = weights.parts[-3:-1]
        files = (weights, folder / paths.play(environment) / encoder.WEIGHTS)
        if too_large := [path for path in files if path.is_file() and path.stat().st_size > LARGEST]:
            name, size = too_large[0].relative_to(folder), too_large[0].stat().st_size
            print(f"weights of {environment} {method} are left out: {name} has {size:,} bytes, more than {LARGEST:,}")
            weights.unlink()
    for weights in folder.glob(f"data/play/*/{encoder.WEIGHTS}"):
        if not any((folder / "models" / weights.parent.name).glob("*/*.safetensors")):
            weights.unlink()


def _copy(path: Path, folder: Path) -> None:
    target = folder / path
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(path, target)


def write(folder: Path, params: Params, there: list[Part], new: list[Part], weights_of: Sequence[str]) -> None:
    """Write an archive that has some parts, the new ones from the run and the others as it had them.

    Args:
        weights_of: methods whose weights are to be kept.
    """
    shown = restricted(params, there)
    environments = dict.fromkeys(part.env for part in new if part.env)
    digests = {env: play.data_digest(play.load(paths.play(env), envs.spec(env))) for env in environments}
    for part in there:
        if part not in new:
            data = {"data": digests[part.env]} if part.env in digests else {}
            check(part, folder, {"parameters": part.parameters, **data})
    with replacing(folder) as temporary:
        if folder.is_dir():
            shutil.copytree(folder, temporary)
        for part in parts(params).values():
            if part not in there:
                drop(part, temporary)
        for environment in set(params.envs) - set(shown.envs):
            drop_environment(environment, temporary)
        for part in new:
            record = {"parameters": part.parameters, "data": digests.get(part.env), "versions": versions()}
            kept = part.cell and (
                part.cell.method in weights_of or any((folder / part.cell.models).glob("*.safetensors"))
            )
            add(part, temporary, record, bool(kept))
        for environment in environments:
            add_environment(params, environment, temporary)
        limit_weights(temporary)
        _copy(PATH, temporary)
        write_tables(shown, temporary, temporary)


def recover(folder: Path) -> None:
    """Put back an archive that a killed process left under its temporary name, and remove what such ones left."""
    for path in folder.parent.glob(f".{folder.name}.*"):
        *_, number, kind = path.name.split(".")
        if kind in ("old", "partial") and number.isdecimal() and not Path("/proc", number).exists():
            if kind == "old" and not folder.exists():
                path.rename(folder)
                print(f"{folder}: put back after a killed `beso publish`")
            else:
                shutil.rmtree(path)


def publish(names: Sequence[str], weights: Sequence[str], dropped: Sequence[str]) -> None:
    """Archive what is finished of this run, and say how much.

    Args:
        names: stages and environments; none means all that is finished.
        weights: methods whose weights are to be kept.
        dropped: stages and environments to take out; then nothing is added.

    Raises:
        UserError: an unknown name, nothing finished of it, or parameters or data other than those of the archive.
    """
    params = load()
    available, folder = parts(params), FOLDER / params.profile
    for method in weights:
        if method not in params.labels:
            raise UserError(f"--weights {method}: {PATH} has the methods {', '.join(params.labels)}")
    recover(folder)
    before = held(folder, available)
    for name in dropped:
        if not any(name in (part.stage, part.env) for part in before):
            raise UserError(f"--drop {name}: {folder} has {', '.join(part.stage for part in before) or 'nothing'}")
    stay = [part for part in before if not {part.stage, part.env} & {*dropped}]
    new = [] if dropped else choose(available, names)
    there = [part for part in available.values() if part in new or part in stay]
    if not any(part.is_cell for part in there):
        raise UserError(f"no cell of profile {params.profile} is finished or archived: run `beso run`")
    write(folder, params, there, new, weights)
    print(f"{folder}: {len(new)} cells and studies archived, {len(there) - len(new)} stay as they were")
