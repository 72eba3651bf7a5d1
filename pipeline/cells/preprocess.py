"""Packed frames of one environment, from its raw play."""

from beso import envs
from beso.data.play import split_episodes
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
        rng = generator(params.seed, "held-out frames")
        held_out = sorted(split_episodes(len(play), 1 - settings.held_out, rng)[1].tolist())
    described = frames.pack(
        frames.FrameFile(folder / "frames.npy"),
        play.columns,
        play.episode_ends,
        held_out,
        settings.size,
        paths.frames(environment),
        {"raw": play.meta},
    )
    print(f"{described['counts']['steps']} frames, {len(held_out)} of {len(play)} episodes held out")
