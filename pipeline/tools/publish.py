"""`beso publish [NAME ...]` archives what is finished in reports/published/<profile>/.

A NAME is a stage (`evaluate@block_push-c_beso`, `study@noise_block_push`, `fork`) or an environment, which stands for
its finished cells and studies; without any, everything finished is meant: what DVC would not run again. What the
archive has of other cells stays, if it was made with the same parameters and data, so that a long run can be archived
in several sittings. Features that another processor made are the same data (`TOLERANCE` of pipeline.tools.archive); the
archive keeps its own sample, encoder and digest of them. Then tables, comparison, metrics and figures are made from all
that the archive has, as the stage `tables` makes them.

The folder is laid out as the repository, the report's files at its top. Beside the rows of each cell and study lies a
record, `<name>.json`: its parameters, the digest of the play data, versions. Of play data there is a summary, of trials
the first ones, and weights in half precision of methods that `--weights METHOD` names:

    beso publish --weights c_beso

`beso watch CELL --run FOLDER` films these, `Policy.load` acts with them as the evaluation sampled them, which
`evaluation.json` beside them tells. `--drop NAME` takes out a stage or an environment.
"""

import json
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path

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
from pipeline.tools.archive import (
    SAMPLE,
    Part,
    check,
    held,
    parts,
    restricted,
    same_features,
    write_evaluation,
    write_sample,
)

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


def files(part: Part) -> list[Path]:
    """What an archive takes of a part of a run, beside a record and weights."""
    cell = part.evaluated
    if cell is None:
        return [part.rows]
    scenes = [cell.scenes] if cell.evaluate.film and cell.evaluate.evaluation.tasks else []
    return [part.rows, cell.curve, *scenes, *(checkpoint.paths(cell.models, seed)[1] for seed in cell.train.seeds)]


def weights(part: Part) -> list[Path]:
    """What an archive can keep of a part's weights: those of a cell's seeds."""
    cell = part.evaluated
    return [checkpoint.paths(cell.models, seed)[0] for seed in cell.train.seeds] if cell else []


def shared(environment: str) -> list[Path]:
    """Files and folders that the cells of an environment share."""
    return [part(environment) for part in (paths.play, paths.trials, paths.samples, paths.probe)]


def add_environment(params: Params, environment: str, folder: Path) -> None:
    """Write into an archive's folder what the cells of an environment share."""
    target = folder / paths.play(environment)
    write_text(target / SUMMARY, json.dumps(summary(Path(), environment)) + "\n")
    settings = params.environments[environment]
    first = (settings.evaluation.goals[0], settings.seeds[0])
    made = trials.load(paths.trials(environment))
    trials.save({first: made[first][: settings.evaluation.chunk]}, folder / paths.trials(environment))
    if environment in params.images:
        write_sample(play.load(paths.play(environment), envs.spec(environment), verify=False), target / SAMPLE)
        _copy([paths.samples(environment), paths.probe(environment)], Path(), folder)
        add_encoder(paths.play(environment), folder)


def add_encoder(place: Path, folder: Path) -> None:
    """Write the encoder of a folder of play data into an archive's folder, its weights in half precision."""
    halve(place / encoder.WEIGHTS, folder / place / encoder.WEIGHTS)
    description = read_json(place / encoder.DESCRIPTION) | {"sha256": sha256(folder / place / encoder.WEIGHTS)}
    write_json(folder / place / encoder.DESCRIPTION, description)


def halve(path: Path, target: Path) -> None:
    """Write weights in half precision, which loading turns back; what half precision cannot hold stays as it is."""
    tensors = safetensors.torch.load_file(path)
    halves = {name: value.half() if value.dtype == torch.float32 else value for name, value in tensors.items()}
    kept = {name: half if half.isfinite().all() else tensors[name] for name, half in halves.items()}
    target.parent.mkdir(parents=True, exist_ok=True)
    with replacing(target) as temporary:
        temporary.write_bytes(safetensors.torch.save(kept))


def limit_weights(folder: Path) -> None:
    """Remove weights that are too large for git, or whose encoder is, and say so; and encoders of no policy."""
    for path in sorted(folder.glob("models/*/*/*.safetensors")):
        environment, method = path.parts[-3:-1]
        large = [
            file
            for file in (path, folder / paths.play(environment) / encoder.WEIGHTS)
            if file.is_file() and file.stat().st_size > LARGEST
        ]
        if large:
            name, size = large[0].relative_to(folder), large[0].stat().st_size
            print(f"weights of {environment} {method} are left out: {name} has {size:,} bytes, more than {LARGEST:,}")
            path.unlink()
    for path in folder.glob(f"data/play/*/{encoder.WEIGHTS}"):
        if not any((folder / "models" / path.parent.name).glob("*/*.safetensors")):
            path.unlink()


def _copy(wanted: Iterable[Path], source: Path, folder: Path) -> None:
    """Copy files and folders from where they are in one folder to the same place in another."""
    for path in wanted:
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        copy = shutil.copytree if (source / path).is_dir() else shutil.copyfile
        copy(source / path, folder / path)


def write(folder: Path, params: Params, there: list[Part], new: list[Part], weights_of: Sequence[str]) -> None:
    """Write an archive that has some parts, the new ones from the run and the others as it had them.

    Args:
        weights_of: methods whose weights are to be kept.

    Raises:
        UserError: what the archive has is of other parameters or data, or not whole.
    """
    shown = restricted(params, there)
    datasets = {env: play.load(paths.play(env), envs.spec(env)) for env in dict.fromkeys(p.env for p in new) if env}
    own = {env: play.data_digest(dataset) for env, dataset in datasets.items()}
    stay = own.keys() & {part.env for part in there if part not in new}
    theirs = {env: same_features(datasets[env], folder / paths.play(env) / SAMPLE) for env in stay}
    digests = {env: theirs.get(env) or digest for env, digest in own.items()}
    foreign = {env for env in own if digests[env] != own[env]}  # whose features the archive has of another processor
    for part in there:
        if part not in new:
            data = {"data": digests[part.env]} if part.env in digests else {}
            check(part, folder, {"parameters": part.parameters, **data})
            for path in files(part):
                if not (folder / path).is_file():  # it is filmed now, and was not then
                    raise UserError(f"{folder / path} is missing: archive it anew, `beso publish {part.stage}`")
    with replacing(folder) as temporary:
        for part in there:
            kept = [path for path in weights(part) if (folder / path).is_file()]
            if cell := part.evaluated:
                write_evaluation(cell, temporary / cell.models)
            if part not in new:
                _copy([*files(part), part.record, *kept], folder, temporary)
                continue
            _copy(files(part), Path(), temporary)
            if cell and cell.env in foreign:
                for seed in cell.train.seeds:
                    description = temporary / checkpoint.paths(cell.models, seed)[1]
                    write_json(description, read_json(description) | {"data": digests[cell.env]})
            record = {"parameters": part.parameters, "data": digests.get(part.env), "versions": versions()}
            write_json(temporary / part.record, record)
            for path in weights(part) if part.cell and part.cell.method in weights_of else kept:
                halve(path, temporary / path)
        for environment in shown.envs:
            if environment in own.keys() - foreign:
                add_environment(params, environment, temporary)
                continue
            _copy([path for path in shared(environment) if (folder / path).exists()], folder, temporary)
            if environment in foreign and not (temporary / paths.play(environment) / encoder.WEIGHTS).is_file():
                add_encoder(paths.play(environment), temporary)  # no policy of the archive needed it yet
        limit_weights(temporary)
        _copy([PATH], Path(), temporary)
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


def publish(names: Sequence[str], weights_of: Sequence[str], dropped: Sequence[str]) -> None:
    """Archive what is finished of this run, and say how much.

    Args:
        names: stages and environments; none means all that is finished.
        weights_of: methods whose weights are to be kept.
        dropped: stages and environments to take out; then nothing is added.

    Raises:
        UserError: an unknown name, nothing finished of it, names or weights beside dropped ones, or parameters or data
            other than those of the archive.
    """
    if dropped and (names or weights_of):
        raise UserError("--drop takes out and adds nothing: give it without a NAME and without --weights")
    params = load()
    available, folder = parts(params), FOLDER / params.profile
    for method in weights_of:
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
    if not any(part.evaluated for part in there):
        raise UserError(f"no cell of profile {params.profile} is finished or archived: run `beso run`")
    write(folder, params, there, new, weights_of)
    print(f"{folder}: {len(new)} cells and studies archived, {len(there) - len(new)} stay as they were")
