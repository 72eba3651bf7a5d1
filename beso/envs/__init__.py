"""Environments: a folder each, a room that holds all that is particular to it.

    <name>/spec.py                      SPEC: what training must know (beso.data.spec)
    <name>/simulator/                   the gymnasium environment, registered when this package is imported
    <name>/demonstrations/scripted.py   record(seed, index): one scripted demonstration; film(seed),
                                        if it likes: pictures of one, for the page (protocol.Filmer)
    <name>/demonstrations/published.py  load(folder): published play data
    <name>/trials.py                    make(request): the episodes that policies are evaluated on (beso.envs.protocol)
    <name>/evaluation.py                how these episodes are played and scored
    <name>/report.py                    what only the report must know (beso.envs.reporting)
    <name>/interface.py                 INTERFACE: what the numbers are that policies see and give (beso.interface)

A spec may also have SINGLE_TASKS, those that a trial can ask for by itself; which of them trials ask for is then a
parameter (`evaluation.tasks`). An environment that sees images has, instead of `record` and `published.py`,

    <name>/demonstrations/recording.py  record, join, film, convert, export: raw play, with frames (protocol.Recording)
    <name>/demonstrations/raw.py        load(folder): raw play
    <name>/probe.py                     TARGETS: what the features should tell (beso.images.probe)
    <name>/states.py                    the same with the simulator's states for images, if it likes (`beso states`)

Rooms are imported by name and piece by piece, so that training needs no simulator and a pipeline cell depends on the
parts of its own room alone.

Importing this package registers all environments with gymnasium, if it is installed. A room's simulator is imported
when its environment is made:

    import gymnasium
    import beso.envs

    env = gymnasium.make("beso/BlockPush-v0", render_mode="rgb_array", max_episode_steps=300)
    observation, info = env.reset(seed=0)           # info["goal"] is a goal for a policy

The folder block_push holds `beso/BlockPush-v0`, the class BlockPushEnv. Its docstring tells the keyword arguments. An
episode has no limit of its own.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import pkgutil
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beso.errors import CannotDrawError, UserError

if TYPE_CHECKING:
    from beso.data.spec import PlaySpec
    from beso.envs.protocol import Evaluation, Filmer, Importer, Raw, Recorder, Recording, States, TrialMaker
    from beso.envs.reporting import Report
    from beso.images.probe import Target
    from beso.interface import Interface


def names() -> list[str]:
    """Names of all environments: the rooms that have a spec; one without is not finished."""
    rooms = [m.name for m in pkgutil.iter_modules(__path__) if m.ispkg]
    return sorted(name for name in rooms if (Path(__path__[0]) / name / "spec.py").is_file())


def gymnasium_name(name: str) -> str:
    """The name of one environment in gymnasium's registry."""
    return f"beso/{_camel(name)}-v0"


def spec(name: str) -> PlaySpec:
    """What training must know of one environment. Raises UserError, here and below, if there is none of that name."""
    return _part(name, "spec").SPEC


def single_tasks(name: str) -> tuple[str, ...]:
    """The tasks that a trial of one environment can ask for by itself; none where that is not a matter of choice."""
    return getattr(_part(name, "spec"), "SINGLE_TASKS", ())


def trial_maker(name: str) -> TrialMaker:
    """The function that makes the episodes of one environment's evaluation."""
    return _part(name, "trials").make


def evaluation(name: str) -> Evaluation:
    """How episodes are played and scored in one environment."""
    return _part(name, "evaluation")


def report(name: str) -> Report:
    """What the report must know of one environment."""
    return _part(name, "report")


def interface(name: str) -> Interface:
    """What the numbers are that policies of one environment see and give, in words."""
    return _part(name, "interface").INTERFACE


def recorder(name: str) -> Recorder:
    """The function that records one scripted demonstration."""
    return _part(name, "demonstrations.scripted").record


def filmer(name: str) -> Filmer:
    """The function that films one scripted demonstration. Raises CannotDrawError if the environment has none."""
    film: Filmer | None = getattr(_part(name, "demonstrations.scripted"), "film", None)
    if film is None:
        raise CannotDrawError(f"environment {name!r} films no play")
    return film


def importer(name: str) -> Importer:
    """The function that reads published play data."""
    return _part(name, "demonstrations.published").load


def sees_images(name: str) -> bool:
    """Whether policies of one environment see images, through an encoder: then it has raw play."""
    return name in names() and (Path(__path__[0]) / name / "demonstrations" / "raw.py").is_file()


def recording(name: str) -> Recording:
    """How raw play of an environment that sees images is made."""
    return _part(name, "demonstrations.recording")


def raw(name: str) -> Raw:
    """How its raw play is read."""
    return _part(name, "demonstrations.raw")


def probe_targets(name: str) -> tuple[Target, ...]:
    """What the features of its frames should tell."""
    return _part(name, "probe").TARGETS


def states(name: str) -> States:
    """The same environment with the simulator's states for images. Raises UserError if it does not have that."""
    if not (Path(__path__[0]) / name / "states.py").is_file():
        raise UserError(f"environment {name!r} has no states.py")
    return _part(name, "states")


def _part(name: str, part: str) -> Any:
    if name not in names():
        raise UserError(f"environment {name!r} is not one of {', '.join(names())}")
    try:
        with _no_opengl():
            return importlib.import_module(f"beso.envs.{name}.{part}")
    except (ImportError, RuntimeError) as error:  # a package that is missing, or refuses
        cause = str(error).strip().splitlines() or [type(error).__name__]
        raise UserError(f"environment {name!r} cannot be loaded: {cause[0]}") from error


@contextlib.contextmanager
def _no_opengl() -> Iterator[None]:
    """While MuJoCo is imported, it is told not to load OpenGL, whose settings may be wrong: few stages draw.

    What draws loads it when it does, by the same settings.
    """
    chosen = os.environ.get("MUJOCO_GL")
    os.environ["MUJOCO_GL"] = "off"
    try:
        yield
    finally:
        del os.environ["MUJOCO_GL"]
        if chosen is not None:
            os.environ["MUJOCO_GL"] = chosen


def _camel(name: str) -> str:
    return name.title().replace("_", "")


def _register() -> None:
    try:
        import gymnasium
    except ImportError:  # who trains needs no simulator
        return
    for name in names():
        gymnasium.register(gymnasium_name(name), entry_point=f"beso.envs.{name}.simulator:{_camel(name)}Env")


_register()
