"""Packed frames of one environment, from its raw play."""

from beso import envs
from beso.core.seeding import generator
from beso.errors import UserError
from beso.images import frames
from pipeline import paths, recipes
from pipeline.recipes import EnvironmentRecipe
from pipeline.settings import Preprocess


def main(env: str) -> None:
    preprocess(recipes.read_environment(Preprocess, "preprocess", env))


def preprocess(recipe: EnvironmentRecipe) -> None:
    """Resize frames, hold episodes out, measure the channels of the others."""
    env, settings = recipe.env, recipe.settings
    folder = paths.raw(env)
    play = envs.raw(env).load(folder)
    held_out = play.meta.get("held_out_episodes")  # where the published data say so
    if not held_out:
        if len(play) < 2:
            raise UserError(f"{folder} has one episode; of two or more, some are held out")
        count = min(max(round(settings.held_out * len(play)), 1), len(play) - 1)
        held_out = sorted(generator(recipe.seed, "held-out frames").permutation(len(play))[:count].tolist())
    described = frames.pack(
        frames.FrameFile(folder / "frames.npy"),
        play.columns,
        play.episode_ends,
        held_out,
        settings.size,
        paths.frames(env),
        {"raw": play.meta},
    )
    packed = frames.FrameFile(paths.frames(env) / "frames.npy")
    frames.write_samples(packed, paths.samples(env))
    print(f"{described['counts']['steps']} frames, {len(held_out)} of {len(play)} episodes held out")
