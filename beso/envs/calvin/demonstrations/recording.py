"""How raw play comes to be: recorded here, episode by episode, or brought over from CALVIN's published data."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np

from beso.envs.calvin.demonstrations import lerobot, official, raw, scripted
from beso.envs.calvin.simulator import tasks
from beso.errors import UserError

TRAINING, VALIDATION = "training", "validation"  # folders of the published data
FILM_LENGTH, FILM_SIZE = 200, (240, 240)  # frames, pixels


def record(seed: int, index: int, length: int, size: int, folder: Path) -> int:
    """Record episode `index` into a folder of its own, unless it is there already; its number of steps."""
    if not folder.is_dir():
        raw.write([scripted.record(seed, index, length, size)], folder, {})
    return int(raw.load(folder, verify=False).episode_ends[-1])


def join(parts: list[Path], folder: Path, seed: int) -> None:
    """Write the raw play made of recorded episodes."""
    raw.join(parts, folder, {"source": "scripted", "seed": seed, "labelled": True})


def film(folder: Path) -> tuple[list[np.ndarray], dict[str, Any]]:
    """Frames of the first episode of raw play, enlarged, and what they show."""
    play = raw.load(folder, verify=False)
    rows = slice(0, min(FILM_LENGTH, int(play.episode_ends[0])))
    done = ", ".join(tasks.NAMES[i].replace("_", " ") for i in np.nonzero(play.tasks[rows])[1])
    pictures = [cv2.resize(frame, FILM_SIZE, interpolation=cv2.INTER_CUBIC) for frame in play.frames[rows]]
    return pictures, {"demonstration": 0, "shows": f"the frames that policies learn from. Tasks done: {done or 'none'}"}


def convert(published: Path, folder: Path, size: int, workers: int) -> None:
    """Write the raw play of a published data set: the folder that holds `training` and, usually, `validation`.

    Or of a LeRobot dataset that `export` wrote. The episodes of `validation` come last and are held out; meta.json says
    which those are.
    """
    if lerobot.is_dataset(published):
        lerobot.convert(published, folder, size)
        return
    if not (published / TRAINING).is_dir():
        raise UserError(f"{published} has no folder `{TRAINING}`: `folder` must be the one that holds CALVIN's")
    splits = [published / TRAINING]
    if (published / VALIDATION).is_dir():
        splits.append(published / VALIDATION)
    layouts = [official.layout(split) for split in splits]
    training, *validation = [official.starts(found) for found in layouts]
    for content in set(training).intersection(*validation) if validation else ():
        raise UserError(f"{validation[0][content]} starts an episode of {TRAINING} too: it cannot be held out")
    counts = [len(found.episodes) for found in layouts]
    held_out = list(range(counts[0], sum(counts)))
    meta = {"source": "published CALVIN", "held_out_episodes": held_out}
    official.convert(layouts, folder, size, workers, meta)


def export(play: raw.RawPlay, folder: Path, form: str) -> None:
    """Write raw play in another form: "lerobot", or "official", CALVIN's own with all episodes in `training`.

    Raises:
        UserError: there is no such form.
    """
    if form == "lerobot":
        lerobot.export(play, folder)
    elif form == "official":
        official.export(play, folder / TRAINING)
    else:
        raise UserError(f"form {form!r} is not one of lerobot, official")
