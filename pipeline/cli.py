"""The command `beso`: what a person asks of this project. dvc.yaml calls the scripts in stages/ instead.

A command's code is imported when it is called, so that `beso --help` answers at once. Every command works in the
repository's root, from wherever in it was called; paths mean what they mean there, and `~` the home.
"""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

try:
    import click
except ImportError:
    raise SystemExit("error: the command needs the pipeline's packages: pip install '.[pipeline]'") from None

from beso.errors import UserError
from beso.files import from_home
from pipeline.guard import guard

MARK = "dvc.yaml"  # of the repository's root


def find_root() -> Path | None:
    """The folder with dvc.yaml: the current one, or the nearest above it."""
    here = Path.cwd()
    return next((folder for folder in (here, *here.parents) if (folder / MARK).is_file()), None)


class Command(click.Command):
    """Runs in the repository's root; a user's mistake is one line and exit code 1."""

    def invoke(self, ctx: click.Context) -> None:
        """Called by click once the arguments are read."""
        guard(self._in_root, ctx)

    def _in_root(self, ctx: click.Context) -> None:
        root = find_root()
        if root is None:
            raise UserError(f"neither {Path.cwd()} nor a folder above it has {MARK}: go to the repository (`cd`)")
        os.chdir(root)
        super().invoke(ctx)


class Group(click.Group):
    """Commands in the order in which they are defined."""

    command_class = Command
    group_class = type

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Called by click for the help."""
        return list(self.commands)


class At(click.Path):
    """A path, seen from the root, as defaults are."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Called by click for what was given, and for the default."""
        path = from_home(value)
        if isinstance(value, Path) or path.is_absolute():
            return path
        return Path(os.path.relpath(path, find_root() or "."))


class Run(At):
    """A folder, or something else that stays as it is: a git revision."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Called by click for what was given."""
        return str(super().convert(value, param, ctx)) if from_home(value).exists() else value


def path(name: str, default: str | None, text: str) -> Callable[[Any], Any]:
    """An option that is a path."""
    return click.option(
        name, type=At(), default=default and Path(default), show_default=default not in (None, "."), help=text
    )


def seeds(text: str) -> Callable[[Any], Any]:
    """An option that is several seeds."""
    text += "; repeat it for several. Default: all."
    return click.option("--seed", "seeds", type=int, multiple=True, help=text)


CELL = click.argument("cell")
COUNT = click.IntRange(min=1)


@click.group(cls=Group, context_settings={"max_content_width": 100, "help_option_names": ["-h", "--help"]})
def cli() -> None:
    """Goal-conditioned imitation learning with score-based diffusion policies (BESO), reproduced.

    A CELL is a method in an environment, named as in params.yaml: block_push-c_beso. A STAGE is one of dvc.yaml, all
    its cells (train) or one (train@block_push-c_beso).

    \b
    Watch it first:        beso demo
    All of it:             beso run -j 2
    One policy by hand:    beso run trials@block_push
                           beso train block_push-c_beso --seed 1
                           beso evaluate block_push-c_beso --seed 1 --models trained
                           beso watch block_push-c_beso --models trained
    """


@cli.command()
@click.argument("cells", nargs=-1, metavar="[CELL]...")
@path("--run", "reports/published/cpu", "An archived run.")
@click.option("--episodes", type=COUNT, default=5, show_default=True, help="Episodes of each policy.")
@path("--out", "demo", "Folder for the films.")
@path("--picture", None, "File for all films side by side, an animated WebP.")
def demo(cells: Sequence[str], run: Path, episodes: int, out: Path, picture: Path | None) -> None:
    """Watch archived policies, without training.

    Each policy whose weights the run keeps plays some episodes. The first that reaches its goal is filmed. Default:
    the cells with `film: true`.
    """
    from pipeline.tools.demo import demo

    demo(cells, run, episodes, out, picture)


@cli.command()
@click.option("-j", "--jobs", type=COUNT, default=2, show_default=True, help="Stages at a time.")
@click.argument("stages", nargs=-1, metavar="[STAGE]...")
def run(stages: Sequence[str], jobs: int) -> None:
    """Bring stages up to date, several at a time.

    It runs these stages and what they need, as `dvc repro` does one at a time. Default: all.
    """
    from pipeline.run import run

    run(stages, jobs)


@cli.command()
@click.argument("name")
def profile(name: str) -> None:
    """Write params.yaml anew from profiles/NAME."""
    from pipeline.profile import write

    print("\n".join(write(name)))


@cli.command()
def check() -> None:
    """Check params.yaml."""
    from pipeline.params import PATH, load

    params = load()
    print(f"{PATH}: profile {params.profile}, {len(params.cells)} cells, {len(params.studies)} studies, valid")


@cli.command()
@click.argument("cells", nargs=-1, metavar="[CELL]...")
@seeds("A seed of params.yaml")
@click.option("--hours", type=float, default=float("inf"), help="Stop after so many hours. The same command continues.")
@path("--out", "trained", "Folder of models, states and curves.")
def train(cells: Sequence[str], seeds: Sequence[int], hours: float, out: Path) -> None:
    """Train cells into a folder, without DVC or a simulator.

    Default: all cells of params.yaml. The play data come from `beso run collect` (where policies see images,
    `beso run features`).
    """
    from pipeline.tools.train import train_cells

    train_cells(cells, seeds, hours, out)


@cli.command()
@CELL
@path("--models", "models", "Folder of a run's models, or of `beso train`'s.")
@seeds("Seed of a trained model")
@path("--rows", None, "CSV file to write, a row for each episode.")
def evaluate(cell: str, models: Path, seeds: Sequence[int], rows: Path | None) -> None:
    """Play the evaluation's episodes and print mean scores.

    The episodes come from `beso run trials`.
    """
    from pipeline.tools.evaluate import evaluate

    evaluate(cell, seeds, models, rows)


@cli.command()
@CELL
@path("--models", None, "Folder of models, as `beso evaluate` takes it. Default: the run's.")
@click.option("--seed", type=int, default=1, show_default=True, help="The trained model.")
@click.option("--episode", type=click.IntRange(min=0), default=0, show_default=True, help="Number of the episode.")
@path("--run", ".", "A run's folder, like reports/published/cpu. Default: this one.")
@path("--film", "watch.webm", "File to write.")
def watch(cell: str, models: Path | None, seed: int, episode: int, run: Path, film: Path) -> None:
    """Film an episode of the evaluation: same start, goal and noise."""
    from pipeline.tools.evaluate import watch

    watch(cell, seed, episode, models, run, film)


@cli.command()
@click.argument("folder", type=At())
@click.option("--seed", type=int, default=1, show_default=True, help="The trained model.")
def spec(folder: Path, seed: int) -> None:
    """Print what a trained policy takes and gives.

    Sizes, order and units of observations, goals and actions, and how actions are sampled. FOLDER is a trained cell's,
    like models/block_push/c_beso.
    """
    from beso.policy import Policy

    print(Policy.load(folder, seed, device="cpu").spec)


@cli.command()
@click.argument("a", type=Run())
@click.argument("b", type=Run())
@click.option("--markdown", is_flag=True, help="Print a Markdown table.")
def compare(a: str, b: str, markdown: bool) -> None:
    """Test whether run B's results differ from run A's.

    A run is a folder (`.`, reports/published/cpu), a git revision (HEAD), or a folder in a revision (HEAD:FOLDER).
    """
    from pipeline.compare import load, report

    print(report((a, b), (load(a), load(b)), markdown))


@cli.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--weights", metavar="METHOD", multiple=True, help="Keep this method's weights too. Can be repeated.")
@click.option("--drop", metavar="NAME", multiple=True, help="Take this out, and add nothing. Can be repeated.")
def publish(names: Sequence[str], weights: Sequence[str], drop: Sequence[str]) -> None:
    """Archive what is finished in reports/published/PROFILE.

    A NAME is a stage (evaluate@block_push-c_beso) or an environment, which stands for its cells and studies. Default:
    all that is finished.
    """
    from pipeline.tools.publish import publish

    publish(names, weights, drop)


@cli.command("import")
@click.argument("folder", type=At())
def import_(folder: Path) -> None:
    """Take trained models instead of training them here.

    FOLDER is the output of `beso train`, another run, or an archive.
    """
    from pipeline.tools.import_cells import import_cells

    import_cells(folder)


@cli.command()
@click.argument("env")
@click.option(
    "--format",
    "form",
    type=click.Choice(["minari", "lerobot", "official"]),
    default="minari",
    show_default=True,
    help="official is CALVIN's own layout.",
)
@path("--out", "exported", "Folder for the dataset.")
def export(env: str, form: str, out: Path) -> None:
    """Write an environment's play as a dataset for other tools.

    The play comes from `beso run collect` (where policies see images, a Minari dataset comes from `beso run features`).
    The formats lerobot and official hold pictures, so they need an environment whose policies see images.
    `environments.ENV.collect.folder` takes what is written.
    """
    from pipeline.tools.export import export

    export(env, form, out)


@cli.command()
def lock() -> None:
    """Write the versions of installed packages to constraints/.

    `make setup` installs these versions.
    """
    from pipeline.tools.lock import main

    main()


@cli.command()
def readme() -> None:
    """Renew the table of results in README.md.

    The numbers come from reports/ and the archives in reports/published.
    """
    from pipeline.tools.readme import renew

    renew()


@cli.command("goal-use")
@CELL
def goal_use(cell: str) -> None:
    """Measure whether a trained policy looks at its goal."""
    from pipeline.tools.goal_use import goal_use

    goal_use(cell)


@cli.command()
@CELL
@click.option("--steps", type=COUNT, default=200_000, show_default=True, help="Steps of play to record.")
@click.option("--updates", type=COUNT, help="Training updates. Default: the cell's.")
@click.option("--trials", type=COUNT, default=104, show_default=True, help="Episodes of each goal set.")
@click.option("--seed", default=77, show_default=True, help="Of the episodes; reported results have another.")
@path("--folder", "states", "Folder for play and models.")
def states(cell: str, steps: int, updates: int | None, trials: int, seed: int, folder: Path) -> None:
    """Train and evaluate a cell on the simulator's states.

    It tells what an environment's play and a cell's parameters can teach without pictures and an encoder. For
    environments whose policies see images.
    """
    from pipeline.tools.states import judge

    judge(cell, steps, updates, trials, seed, folder)


@cli.group()
def bench() -> None:
    """Measure speed and memory on this machine. Close other programs first."""


@bench.command("policy")
@CELL
@path("--published", None, "A checkout of the published code, measured as well.")
def bench_policy(cell: str, published: Path | None) -> None:
    """Measure calls, rollouts and memory at the paper's size.

    It needs the play data: `beso run collect`.
    """
    from pipeline.tools.bench_policy import bench

    bench(cell, published)


@bench.command("training")
@click.argument("cells", nargs=-1, required=True, metavar="CELL...")
@click.option("--seeds-together", type=COUNT, multiple=True, default=[1], show_default=True, help="Can be repeated.")
@click.option(
    "--precision", type=click.Choice(["fp32", "bf16"]), multiple=True, default=["fp32", "bf16"], help="Default: both."
)
@click.option("--seconds", type=float, default=2.0, show_default=True, help="Length of a measurement, about.")
def bench_training(
    cells: Sequence[str], seeds_together: Sequence[int], precision: Sequence[Any], seconds: float
) -> None:
    """Measure updates a second of cells, as params.yaml has them."""
    from pipeline.tools.bench_training import bench

    bench(cells, seeds_together, precision, seconds)


if __name__ == "__main__":
    cli(prog_name="beso")
