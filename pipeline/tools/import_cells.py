"""`beso import FOLDER` takes trained models instead of training them here.

FOLDER is what `beso train` wrote elsewhere, or another run or archive, which `beso publish` makes: of an archive, the
models whose weights it keeps, in half precision. Seeds of the parameters and play data that are here go to the scratch
folder, where a killed stage would have left them. `dvc repro train` then finds nothing left to train, writes models and
curves, and records them as ever.

Where policies see images, play data are features. Another processor makes others in their last bits. So the encoder of
FOLDER is taken first, for the stage `features`. Then its models are taken where the features that are here differ from
those that they were trained on by no more than `TOLERANCE` (pipeline.tools.archive).
"""

import shutil
from dataclasses import asdict
from pathlib import Path
from typing import Any, get_args

import torch

from beso import envs
from beso.core import checkpoint
from beso.core.device import Precision, pick_device
from beso.data import play
from beso.encoders import encoder
from beso.errors import UserError
from beso.files import read_json, replacing, write_json
from beso.images import frames
from pipeline import paths, scratch
from pipeline.machine import Machine
from pipeline.params import Params, load
from pipeline.recipes import EnvironmentRecipe
from pipeline.tools.archive import SAMPLE, same_features
from pipeline.tools.train import cell_folder, find_finished
from stages.features import waiting_place
from stages.train import identity

ELSEWHERE = [(torch.device(name), auto) for name in ("cpu", "cuda") for auto in get_args(Precision)]  # trainings


def import_cells(folder: Path) -> None:
    """Take what the folder has of params.yaml's cells, and say which seeds. Raises UserError if it has nothing."""
    params = load()
    device = pick_device(Machine.load().device)
    if not folder.is_dir():
        raise UserError(f"{folder} is missing: expected the folder that `beso train` wrote, a run or an archive")
    there = {name: cell_folder(folder, cell) for name, cell in params.cells.items()}
    there = {name: trained for name, trained in there.items() if any(trained.rglob("*.safetensors"))}
    if not there:
        raise UserError(f"{folder} has no model of a cell of params.yaml")
    for env in params.images:
        _take_encoder(folder, env, params)
    for name, trained in there.items():  # an archive keeps the weights of few
        cell = params.cells[name]
        jobs = cell.train.jobs
        try:
            dataset = play.load(cell.play, envs.spec(cell.env))
            digest = play.data_digest(dataset)
            targets = [scratch.folder(*identity(cell.train, job, digest, device)) for job in jobs]
        except UserError as error:  # of play data, or a student's teacher
            print(f"{name}: {error}; then import again")
            continue
        theirs = same_features(dataset, folder / cell.play / SAMPLE) or digest
        found = {job.seed: find_finished(trained, job, theirs) for job in jobs}
        for job, target in zip(jobs, targets, strict=True):
            if source := found[job.seed]:
                _compare_code(source, [identity(cell.train, job, theirs, *arithmetic) for arithmetic in ELSEWHERE])
                with replacing(target) as temporary:
                    temporary.mkdir()
                    weights, description = checkpoint.paths(source, job.seed)
                    shutil.copyfile(weights, temporary / weights.name)
                    write_json(temporary / description.name, read_json(description) | {"data": digest})
        missing = [str(seed) for seed, source in found.items() if source is None]
        told = f"dvc repro would train seeds {', '.join(missing)} here" if missing else "all seeds"
        if cell.models.is_dir() and not missing:  # where the stage is up to date, `dvc repro` would do nothing
            told += f"; run `dvc repro --force --single-item train@{name}`"
        print(f"{name}: {told}")


def _take_encoder(folder: Path, env: str, params: Params) -> None:
    """Put an archive's encoder where the stage `features` looks for one, unless the features here are of it."""
    theirs, here = (place / paths.play(env) / encoder.DESCRIPTION for place in (folder, Path()))
    if not (theirs.is_file() and theirs.with_name(encoder.WEIGHTS).is_file()):  # an archive leaves out large weights
        return
    description = read_json(theirs)
    if here.is_file() and read_json(here)["sha256"] == description["sha256"]:
        return
    settings, made = params.images[env].features, encoder.load(theirs.parent, torch.device("cpu"))
    try:
        packed = frames.load(paths.frames(env))
    except UserError as error:
        print(f"{env}, encoder: {error}; then import again")
        return
    provenance = description["provenance"]
    asked = {"pretraining": asdict(settings.pretraining), "frames": packed.meta["sha256"]["frames"]}
    if made.encoding.width != settings.width or any(provenance.get(key) != value for key, value in asked.items()):
        print(f"{env}, encoder: of other frames or parameters")
        return
    target = waiting_place(EnvironmentRecipe(env, params.seed, settings), packed, Machine.load())
    with replacing(target) as temporary:
        temporary.mkdir()
        for name in (encoder.WEIGHTS, encoder.DESCRIPTION):
            shutil.copyfile(theirs.with_name(name), temporary / name)
    print(f"{env}, encoder: taken; run `dvc repro --force --single-item features@{env}`, then import again")


def _compare_code(folder: Path, identities: list[list[Any]]) -> None:
    """Say so if other files in beso/ trained a model: its folder's name covers them and its identity."""
    seed, _, name = folder.name.partition("-")
    if not name:
        print(f"{folder}: taken; it does not tell which state of beso/ trained it")
        return
    version = checkpoint.load_description(folder, int(seed.removeprefix("seed")))["torch"]
    if name not in {scratch.fingerprint(*identity, torch_version=version) for identity in identities}:
        print(f"{folder}: taken, but beso/ has changed since; see that its training has not")
