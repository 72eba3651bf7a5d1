"""The encoder of one environment's frames, and the play dataset on which policies train: its features, or frames."""

import dataclasses
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import torch

from beso import envs
from beso.core.device import pick_device, pick_precision
from beso.core.seeding import torch_generator
from beso.data import play, store
from beso.data.play import PlayDataset
from beso.encoders import encoder
from beso.encoders.encoder import Encoding
from beso.encoders.resnet import FEATURES
from beso.files import from_home, replacing, sha256, write_text
from beso.images import frames, probe
from beso.images.frames import PackedPlay
from beso.images.pretraining import pretrain
from beso.images.weights import read_weights
from pipeline import paths, recipes, scratch
from pipeline.machine import Machine
from pipeline.pool import HERE, map_jobs
from pipeline.recipes import EnvironmentRecipe
from pipeline.settings import Features

SHARE = 2048  # frames that a worker encodes at a time; how many does not change a number


def main(env: str) -> None:
    make_features(recipes.read_environment(Features, "features", env), Machine.load())


def make_features(recipe: EnvironmentRecipe, machine: Machine) -> None:
    """Train or read the encoder, write the features of all frames, and measure what they tell.

    Where policies train the encoder on (`finetune`), they get the frames themselves.

    The encoder, and the state of its unfinished training, wait in the scratch folder until all is done.
    """
    settings, folder = recipe.settings, paths.frames(recipe.env)
    packed = frames.load(folder)
    waiting = waiting_place(recipe, packed, machine)
    waiting.mkdir(parents=True, exist_ok=True)
    # One worker is this process with a single thread: more threads would add up in another order.
    for _ in map_jobs(make_encoder, [(settings, folder, recipe.seed, machine, waiting)], HERE):
        pass
    features = encode_all(waiting, folder, machine, waiting / "features.npy")
    observations, meta = features, _meta(packed)
    if settings.finetune:
        observations = store.read_npy(folder / "frames.npy")
        meta["finetune"] = {"frame_size": packed.meta["size"], "encoder": sha256(waiting / encoder.DESCRIPTION)}
    dataset = PlayDataset(observations, packed.actions, packed.tasks, packed.episode_ends, meta)
    files = [waiting / encoder.WEIGHTS, waiting / encoder.DESCRIPTION]
    play.save(dataset, paths.play(recipe.env), files)
    table = measure(recipe, machine, packed, features, waiting)
    write_text(paths.probe(recipe.env), table.to_csv(index=False, float_format="%.6g"))
    shutil.rmtree(waiting)
    print(table.pivot(index="target", columns="representation", values="value").to_string(float_format="%.3f"))


def waiting_place(recipe: EnvironmentRecipe, packed: PackedPlay, machine: Machine) -> Path:
    """Where the encoder of these frames waits until its features are made."""
    settings, device = dataclasses.asdict(recipe.settings), pick_device(machine.device)
    settings |= {"precision": pick_precision(recipe.settings.precision, device)}
    return scratch.folder("features", settings, recipe.seed, packed.meta["sha256"], device.type)


def _meta(packed: PackedPlay) -> dict[str, Any]:
    kept = {key: value for key, value in packed.meta["raw"].items() if key not in ("sha256", "counts")}
    return {**kept, "held_out_episodes": packed.meta["held_out_episodes"], "frames": packed.meta["sha256"]["frames"]}


def make_encoder(settings: Features, folder: Path, seed: int, machine: Machine, target: Path) -> None:
    """Write the encoder's files into `target`, unless they are there."""
    if (target / encoder.DESCRIPTION).exists():
        return
    packed = frames.load(folder, verify=False)
    size, device = packed.meta["size"], pick_device(machine.device)
    precision = pick_precision(settings.precision, device)
    if settings.weights is not None:
        given = settings.weights
        encoding = Encoding(settings.width, size, given.mean, given.std, precision, settings.head)
        network = encoder.network(encoding, read_weights(from_home(given.path), given.sha256), given.path)
        provenance: dict[str, Any] = {"weights": given.sha256}
    else:
        mean, std = packed.meta["mean"], packed.meta["std"]
        encoding = Encoding(settings.width, size, tuple(mean), tuple(std), precision, settings.head)
        state, config = target / "state.safetensors", settings.pretraining
        network, curve = pretrain(packed, encoding, config, seed, device, state, machine.save_seconds)
        state.unlink(missing_ok=True)
        provenance = {"pretraining": dataclasses.asdict(config), "seed": seed, "curve": curve}
        provenance |= {"frames": packed.meta["sha256"]["frames"], "torch": torch.__version__}
    shift = settings.pretraining.shift if settings.finetune else None
    encoder.save(target, network, encoding, provenance, shift)


def encode_all(encoder_folder: Path, folder: Path, machine: Machine, target: Path) -> np.ndarray:
    """Features of all frames, (steps, 512) float32, written to the .npy file `target` and memory-mapped.

    A frame's features depend on that frame alone, so the number of workers changes nothing.
    """
    steps = len(frames.load(folder, verify=False))
    jobs = [
        (encoder_folder, folder, start, min(start + SHARE, steps), machine.device) for start in range(0, steps, SHARE)
    ]
    on_gpu = pick_device(machine.device).type != "cpu"  # which one process keeps busy; many would fill its memory
    parts = map_jobs(encode_share, jobs, dataclasses.replace(machine, workers=1) if on_gpu else machine, "features")
    with replacing(target) as temporary:
        store.write_npy_parts(temporary, (steps, FEATURES), np.float32, parts)
    return store.read_npy(target)


def encode_share(encoder_folder: Path, folder: Path, start: int, stop: int, device: str) -> np.ndarray:
    """Features of the frames from `start` to before `stop`."""
    encode = encoder.load(encoder_folder, pick_device(device))
    packed = frames.load(folder, verify=False)
    return np.concatenate([encode(block) for block in packed.frames.blocks(start, stop)])


def measure(
    recipe: EnvironmentRecipe, machine: Machine, packed: PackedPlay, features: np.ndarray, waiting: Path
) -> pd.DataFrame:
    """The probe's table: the features, those of an encoder with random weights, and the state itself."""
    untrained = waiting / "random"
    untrained.mkdir(exist_ok=True)
    encoding = encoder.load(waiting, torch.device("cpu")).encoding
    network = encoder.untrained(encoding, torch_generator(recipe.seed, "random encoder"))
    encoder.save(untrained, network, encoding, {"weights": "random"})
    representations = {
        "features": features,
        "random encoder": encode_all(untrained, paths.frames(recipe.env), machine, untrained / "features.npy"),
        "state": packed.states,
    }
    targets = envs.probe_targets(recipe.env)
    return pd.DataFrame(probe.probe(representations, packed.states, packed.held_out, targets))
