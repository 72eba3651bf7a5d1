"""`beso import FOLDER` takes trained models instead of training them here.

FOLDER is what `beso train` wrote elsewhere, or another run or archive, which `beso publish` makes: of an archive, the
models whose weights it keeps, in half precision. Seeds of the parameters and play data that are here go to the scratch
folder, where a killed stage would have left them. `dvc repro train` then finds nothing left to train, writes models and
curves, and records them as ever.
"""

import shutil
from pathlib import Path
from typing import Any

from beso import envs
from beso.core import checkpoint
from beso.core.device import pick_device
from beso.data import play
from beso.errors import UserError
from beso.files import replacing
from pipeline import scratch
from pipeline.machine import Machine
from pipeline.params import load
from pipeline.tools.train import cell_folder, find_finished
from stages.train import identity

DEVICES = ("cpu", "cuda")  # of trainings elsewhere


def import_cells(folder: Path) -> None:
    """Take what the folder has of params.yaml's cells, and say which seeds. Raises UserError if it has nothing."""
    params = load()
    device = pick_device(Machine.load().device).type
    if not folder.is_dir():
        raise UserError(f"{folder} is missing: expected the folder that `beso train` wrote, a run or an archive")
    there = {name: cell_folder(folder, cell) for name, cell in params.cells.items()}
    there = {name: trained for name, trained in there.items() if any(trained.rglob("*.safetensors"))}
    if not there:
        raise UserError(f"{folder} has no model of a cell of params.yaml")
    for name, trained in there.items():  # an archive keeps the weights of few
        cell = params.cells[name]
        jobs = cell.train.jobs
        try:
            digest = play.data_digest(play.load(cell.play, envs.spec(cell.env)))
            targets = [scratch.folder(*identity(cell.train, job, digest, device)) for job in jobs]
        except UserError as error:  # of play data, or a student's teacher
            print(f"{name}: {error}; then import again")
            continue
        found = {job.seed: find_finished(trained, job, digest) for job in jobs}
        for job, target in zip(jobs, targets, strict=True):
            if source := found[job.seed]:
                _compare_code(source, [identity(cell.train, job, digest, d) for d in DEVICES])
                with replacing(target) as temporary:
                    temporary.mkdir()
                    for path in checkpoint.paths(source, job.seed):
                        shutil.copyfile(path, temporary / path.name)
        missing = [str(seed) for seed, source in found.items() if source is None]
        print(f"{name}: " + (f"dvc repro would train seeds {', '.join(missing)} here" if missing else "all seeds"))


def _compare_code(folder: Path, identities: list[list[Any]]) -> None:
    """Say so if other files in beso/ trained a model: its folder's name covers them and its identity."""
    seed, _, name = folder.name.partition("-")
    if not name:
        print(f"{folder}: taken; it does not tell which state of beso/ trained it")
        return
    version = checkpoint.load_description(folder, int(seed.removeprefix("seed")))["torch"]
    if name not in {scratch.fingerprint(*identity, torch_version=version) for identity in identities}:
        print(f"{folder}: taken, but beso/ has changed since; see that its training has not")
