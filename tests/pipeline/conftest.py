"""Workspaces: copies of the repository in which the smoke profile runs for real."""

import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[2]
GIT = ["git", "-c", "user.name=test", "-c", "user.email=test@example.org"]


class Workspace:
    """A copy of the repository's files in a git repository of its own."""

    def __init__(self, folder):
        self.folder = folder

    @classmethod
    def fresh(cls, folder):
        """What a stranger has after cloning, set to the smoke profile; what is of other profiles' runs is gone."""
        listed = subprocess.run(
            ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", ":!reports/published"],
            cwd=ROOT,
            check=True,
            capture_output=True,
        ).stdout.decode()
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, folder / name)
        workspace = cls(folder)
        (folder / "dvc.lock").unlink(missing_ok=True)
        workspace.beso("profile", "smoke")
        subprocess.run(["git", "init", "-q"], cwd=folder, check=True)
        workspace.commit()
        return workspace

    def copy(self, folder):
        """The same workspace, with all results and DVC's cache, elsewhere."""
        shutil.copytree(self.folder, folder, dirs_exist_ok=True, symlinks=True)
        return Workspace(folder)

    def commit(self):
        subprocess.run([*GIT, "add", "-A"], cwd=self.folder, check=True)
        subprocess.run([*GIT, "commit", "-q", "--allow-empty", "-m", "state"], cwd=self.folder, check=True)

    @property
    def environment(self):
        # The commands must be this environment's, and the project this workspace's.
        path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
        environment = {**os.environ, "PATH": path, "PYTHONPATH": str(self.folder)}
        environment.pop("PYTHONDONTWRITEBYTECODE", None)  # compiled files must not count as changes
        return environment

    @property
    def settings(self):
        """Where and how every command runs; its output comes as one text."""
        streams = {"text": True, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        return {"cwd": self.folder, "env": self.environment, **streams}

    def run(self, *command, check=True, **keywords):
        done = subprocess.run(
            command,
            **self.settings,
            **keywords,
        )
        if check:
            assert done.returncode == 0, done.stdout
        return done

    def start(self, *command):
        """A command in a process group of its own, as a terminal starts it."""
        return subprocess.Popen(
            command,
            **self.settings,
            start_new_session=True,
            # Where the tests themselves run in the background, Ctrl-C is ignored and children inherit that.
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )

    def python(self, *arguments, **keywords):
        return self.run(sys.executable, *arguments, **keywords)

    def beso(self, *arguments, **keywords):
        return self.python("-m", "pipeline.cli", *arguments, **keywords)

    def dvc(self, *arguments, **keywords):
        return self.run("dvc", *arguments, **keywords)

    def repro(self, *arguments):
        """Names of the stages that really ran, but for `resolve`, which every change of params.yaml runs."""
        output = self.dvc("repro", *arguments).stdout
        ran = [line.split("'")[1] for line in output.splitlines() if line.startswith("Running stage")]
        return [name for name in ran if name != "resolve"]

    def stage(self, name, *arguments, **keywords):
        """Run a stage outside DVC, with the parameters that params.yaml has now."""
        self.python("-m", "stages", "resolve")
        return self.python("-m", "stages", name, *arguments, **keywords)

    def stages(self):
        """Names of all stages."""
        return set(self.dvc("stage", "list", "--name-only").stdout.split())

    def stale(self, *targets):
        """Names of the stages of which an input differs from what dvc.lock says, the parameters resolved."""
        self.dvc("repro", "resolve")
        return set(json.loads(self.dvc("status", "--json", *targets).stdout))

    def set(self, key, value):
        """Change one parameter as an editor would, or add it."""
        yaml = YAML()
        path = self.folder / "params.yaml"
        values = yaml.load(path.read_text())
        inner = values
        *parents, last = key.split(".")
        for name in parents:
            inner = inner.setdefault(name, {})
        inner[last] = value
        with path.open("w") as file:
            yaml.dump(values, file)

    def machine(self, **values):
        """Write machine.yaml."""
        with (self.folder / "machine.yaml").open("w") as file:
            YAML().dump(values, file)

    def lock(self):
        """Hashes of all outputs by path, from dvc.lock."""
        stages = YAML(typ="safe").load((self.folder / "dvc.lock").read_text())["stages"]
        return {out["path"]: out["md5"] for stage in stages.values() for out in stage.get("outs", [])}

    def files(self, *folders):
        """Bytes of all files below some folders."""
        return {
            path.relative_to(self.folder): path.read_bytes()
            for folder in folders
            for path in (self.folder / folder).rglob("*")
            if path.is_file()
        }


def made_once(factory, name, make):
    """A copy of a workspace that the first of pytest-xdist's processes to need it makes, with `make(folder)`."""
    base = factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        base = base.parent  # of all processes
    folder, done = base / name, base / f"{name}.done"
    with (base / f"{name}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir()
            make(folder)
            done.touch()
    return Workspace(folder).copy(factory.mktemp(name))


def run_all(folder):
    workspace = Workspace.fresh(folder)
    workspace.beso("run", "-j", "2")
    workspace.commit()


SMALL = ("gcbc", "c_beso", "c_beso_film", "c_beso_one_step")


def leave_out(workspace):
    """Make of a finished workspace one of block push alone, with few cells and one study."""
    yaml, path, lock = YAML(), workspace.folder / "params.yaml", workspace.folder / "dvc.lock"
    values = yaml.load(path.read_text())
    kept = {
        "environments": ["block_push"],
        "images": [],
        "cells": [f"block_push-{method}" for method in SMALL],
        "studies": ["samplers_block_push"],
        "methods": [*SMALL, "distilled"],
    }
    for part, names in kept.items():
        for name in values[part].keys() - set(names):
            del values[part][name]
    workspace.machine(workers=1)  # workers take longer to start than such stages to run
    with path.open("w") as file:
        yaml.dump(values, file)
    names = workspace.stages()
    noted = yaml.load(lock.read_text())
    for name in noted["stages"].keys() - names:
        for out in noted["stages"].pop(name)["outs"]:
            found = workspace.folder / out["path"]
            shutil.rmtree(found) if found.is_dir() else found.unlink()
    with lock.open("w") as file:
        yaml.dump(noted, file)
    assert workspace.repro() == ["latency", "tables", "page"]
    workspace.commit()


@pytest.fixture(scope="session")
def finished(tmp_path_factory):
    """The smoke profile after one run. Tests that change something take a copy."""
    return made_once(tmp_path_factory, "finished", run_all)


@pytest.fixture
def workspace(finished, tmp_path):
    """A copy of the finished workspace to change."""
    return finished.copy(tmp_path / "workspace")


@pytest.fixture(scope="session")
def finished_small(finished, tmp_path_factory):
    """Block push alone with the methods of SMALL: what DVC and the report do there takes seconds."""
    return made_once(tmp_path_factory, "small", lambda folder: leave_out(finished.copy(folder)))


@pytest.fixture
def small(finished_small, tmp_path):
    """A copy of the small finished workspace to change."""
    return finished_small.copy(tmp_path / "workspace")
