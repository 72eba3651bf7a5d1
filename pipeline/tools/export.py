"""`beso export ENV` writes play in the forms that others use; docs/published-data.md tells how to read them."""

from pathlib import Path

from beso import envs
from beso.data import play
from beso.envs import minari_data
from beso.errors import UserError
from pipeline import paths


def export(env: str, form: str, out: Path) -> None:
    """Write the play of one environment into `out`/`form`, and print where it is.

    Args:
        form: "minari" is its play dataset; others, which environments with images know, are its raw play.

    Raises:
        UserError: there is no such environment or play, it has no pictures, or a package is not installed.
    """
    folder = out / form
    if form == "minari":
        spec = envs.spec(env)
        name = minari_data.write(play.load(paths.play(env), spec), spec, envs.gymnasium_name(env), folder)
        print(f"{folder / name}: with MINARI_DATASETS_PATH={folder.resolve()}, minari.load_dataset({name!r})")
        return
    envs.spec(env)
    if not envs.sees_images(env):
        raise UserError(f"policies of {env} see no pictures: its play has the form minari alone")
    envs.recording(env).export(envs.raw(env).load(paths.raw(env)), folder / env, form)
    print(folder / env)
