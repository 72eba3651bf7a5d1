"""Packed frames of one environment, from its raw play."""

from beso import envs
from beso.errors import UserError
from beso.images import frames
from beso.seeding import generator
from pipeline import paths
from pipeline.params import Params


def preprocess(params: Params, environment: str) -> None:
    """Resize frames, hold episodes out, measure the channels of the others."""
    settings = params.image(environment).preprocess
    folder = paths.raw(environment)
    play = envs.raw(environment).load(folder)
    held_out = play.meta.get("held_out_episodes")  # where the published data say so
    if not held_out:
        if len(play) < 2:
            raise UserError(f"{folder} has one episode; of two or more, some are held out")
        count = min(max(round(settings.held_out * len(play)), 1), len(play) - 1)
        held_out = sorted(generator(params.seed, "held-out frames").permutation(len(play))[:count].tolist())
    described = frames.pack(
        frames.FrameFile(folder / "frames.npy"),
        play.columns,
        play.episode_ends,
        held_out,
        settings.size,
        paths.frames(environment),
        {"raw": play.meta},
    )
    packed = frames.FrameFile(paths.frames(environment) / "frames.npy")
    frames.write_samples(packed, paths.samples(environment))
    print(f"{described['counts']['steps']} frames, {len(held_out)} of {len(play)} episodes held out")
