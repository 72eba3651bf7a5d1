"""The rules of the folders: who may import whom, and that dvc.yaml names what its stages really import."""

import ast
import functools
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from beso import envs, methods

ROOT = Path(__file__).parents[1]
PROJECT = ("beso", "pipeline", "stages")
STAGES = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"]
ENVIRONMENTS, METHODS = envs.names(), methods.names()
IMAGES = sorted(path.parts[-3] for path in (ROOT / "beso/envs").glob("*/demonstrations/raw.py"))
OF_IMAGES = {"preprocess", "features"}  # stages of these alone

# Not among the deps: what checks parameters (their values are tracked themselves), moves files, writes messages, starts
# workers or imports by name. Imports are not followed through these files either.
MACHINERY = {p.relative_to(ROOT) for p in (ROOT / "pipeline").glob("*.py") if p.name not in ("film.py", "play.py")}
MACHINERY |= {Path("beso") / name for name in ("checks.py", "config.py", "errors.py", "files.py", "interface.py")}
MACHINERY |= {Path("beso") / name / "__init__.py" for name in ("envs", "methods")}


@functools.cache
def imports(path):
    """Project modules that a file imports when it runs, as paths; imports for type checkers alone do not count."""
    tree = ast.parse((ROOT / path).read_text())
    left_out = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        names = []
        if id(node) in left_out:
            continue
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        for name in names:
            parts = name.split(".")
            if parts[0] in PROJECT:
                for i in range(1, len(parts) + 1):
                    module = Path(*parts[:i])
                    candidates = [module.with_suffix(".py"), module / "__init__.py"]
                    found |= {c for c in candidates if (ROOT / c).is_file() and (ROOT / c).read_text().strip()}
    return found


def closure(paths):
    seen, waiting = set(), [Path(p) for p in paths]
    while waiting:
        path = waiting.pop()
        if path not in seen and path not in MACHINERY:
            seen.add(path)
            waiting += imports(path)
    return {p for p in seen if not is_docstring_only(p)}


@functools.cache
def is_docstring_only(path):
    return all(isinstance(node, ast.Expr) for node in ast.parse((ROOT / path).read_text()).body)


def expand(text, env, method):
    for name, value in {"item.env": env, "item.method": method, "item.of": method, "key": env}.items():
        text = text.replace("${" + name + "}", value)
    return text


def definition(stage):
    return STAGES[stage].get("do", STAGES[stage])


def declared(stage, env, method):
    """The project's Python files among a cell's deps; a folder stands for all files in it."""
    files = set()
    for dep in definition(stage)["deps"]:
        path = Path(expand(dep, env, method))
        if path.parts[0] in PROJECT:
            assert (ROOT / path).exists(), path
            files |= {p.relative_to(ROOT) for p in (ROOT / path).rglob("*.py")} if (ROOT / path).is_dir() else {path}
    return {f for f in files if f.suffix == ".py" and not is_docstring_only(f)} - MACHINERY


def room(env, *parts):
    return [p.relative_to(ROOT).as_posix() for part in parts for p in (ROOT / "beso/envs" / env).glob(part)]


def by_name(stage, env, method):
    """What a stage imports by the names in its cell."""
    all_methods = [f"beso/methods/{name}.py" for name in METHODS]
    samplings = {name: Path(*methods.sampling(name).__module__.split(".")).with_suffix(".py") for name in METHODS}
    played = [f"beso/methods/{method}.py", samplings[method], *room(env, "evaluation.py")]
    return {
        "resolve": [],
        "collect": room(env, "spec.py", "demonstrations/*.py"),
        "trials": room(env, "trials.py"),
        "preprocess": room(env, "demonstrations/raw.py"),
        "features": room(env, "probe.py"),
        "train": [f"beso/methods/{method}.py", *room(env, "spec.py")],
        "evaluate": played,
        "study": played,
        "latency": [*all_methods, *samplings.values()],
        "fork": [*all_methods, *samplings.values()],
        "tables": [path for name in ENVIRONMENTS for path in room(name, "spec.py", "report.py")],
        "page": [path for name in ENVIRONMENTS for path in room(name, "report.py")],
    }[stage]


def in_any_room(files):
    """A dep in a room stands for that file of all rooms: one that needs it is enough."""
    return {Path(*f.parts[:2], "any", *f.parts[3:]) if f.parts[:2] == ("beso", "envs") else f for f in files}


# Folders as they are, though not all of them is imported
WHOLE = {"trials", "features", "tables", "page", "latency", "fork"}


@pytest.mark.parametrize("stage", STAGES)
def test_deps_are_what_the_stage_imports(stage):
    """No cell lacks a dep; no dep is unused by all cells of the stage."""
    used_by_any, environments = set(), IMAGES if stage in OF_IMAGES else ENVIRONMENTS
    for env in environments:
        for method in METHODS:
            entry = [f"stages/{stage}.py", *by_name(stage, env, method)]
            used = closure(entry)
            names = declared(stage, env, method)
            assert used - names == set(), "imported, but not among the deps"
            used_by_any |= used
    declared_by_any = set().union(*(declared(stage, e, m) for e in environments for m in METHODS))
    extra = in_any_room(declared_by_any) - in_any_room(used_by_any)
    assert stage in WHOLE or extra == set(), "among the deps, but never imported"


def stale(path):
    """Stages (of block push with C-BESO and GCBC) that an edit of a file reruns, those that follow not counted."""
    return {
        f"{stage} {method}"
        for stage in STAGES
        if stage not in OF_IMAGES
        for method in ("c_beso", "gcbc")
        if Path(path) in declared(stage, "block_push", method)
    }


def test_what_an_edit_reruns():
    cells = {f"{stage} {method}" for stage in ("evaluate", "study") for method in ("c_beso", "gcbc")}
    others = {f"{stage} {method}" for stage in ("latency", "fork") for method in ("c_beso", "gcbc")}
    assert stale("beso/sampling/samplers.py") == cells | others, "training does not depend on samplers"
    report = {f"{stage} {method}" for stage in ("tables", "page") for method in ("c_beso", "gcbc")}
    assert stale("beso/envs/block_push/report.py") == report, "a label reruns the report alone"
    assert stale("pipeline/report/statistics.py") == report
    films = {f"{stage} {method}" for stage in ("collect", "evaluate") for method in ("c_beso", "gcbc")}
    assert stale("pipeline/film.py") == films
    assert not any(name.startswith("collect") for name in stale("beso/envs/block_push/evaluation.py"))
    of_gcbc = {f"{stage} gcbc" for stage in ("train", "evaluate", "study")}
    assert stale("beso/methods/gcbc.py") == of_gcbc | others


def test_imports_point_downward():
    """beso, then pipeline, then stages; on top of all three, the commands for people."""
    allowed = {"beso": {"beso"}, "pipeline": {"pipeline", "beso"}, "stages": set(PROJECT), "commands": set(PROJECT)}
    for top in PROJECT:
        for path in (ROOT / top).rglob("*.py"):
            of, used = path.relative_to(ROOT), imports(path.relative_to(ROOT))
            commands = of.parts[:2] == ("pipeline", "tools") or of == Path("pipeline/cli.py")
            assert {p.parts[0] for p in used} <= allowed["commands" if commands else top], path
            assert commands or not any(p.parts[:2] == ("pipeline", "tools") for p in used), path


def test_only_the_last_stages_use_the_report():
    users = {path.name for path in (ROOT / "stages").glob("*.py") if "pipeline.report" in path.read_text()}
    assert users == {"tables.py", "page.py"}


def test_only_a_few_use_methods_inside_the_library():
    users = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "beso").rglob("*.py")
        if path.parent.name != "methods" and Path("beso/methods/__init__.py") in imports(path.relative_to(ROOT))
    }
    assert users == {
        "beso/training/loop.py",
        "beso/core/checkpoint.py",
        "beso/policy.py",
    }


@pytest.mark.parametrize("kind", ["envs", "methods"])
def test_nothing_outside_its_room_names_an_environment_or_a_method(kind):
    """Neither in code nor in dvc.yaml: names stand in params.yaml, the profiles and the paper's numbers."""
    folder, names = ROOT / "beso" / kind, ENVIRONMENTS if kind == "envs" else METHODS
    files = [p for top in PROJECT for p in (ROOT / top).rglob("*.py") if not p.is_relative_to(folder)]
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                assert node.value not in names, (path, node.value)
    text = (ROOT / "dvc.yaml").read_text()
    assert not [name for name in names if name in text]
    assert len(text.splitlines()) <= 112


def test_parameters_reach_stages_through_their_recipes_alone():
    assert [stage for stage in STAGES if "params" in definition(stage)] == ["resolve"]
    for stage in STAGES.keys() - {"resolve", "page"}:  # the page prints params.yaml
        told = [dep for dep in definition(stage)["deps"] if dep.startswith("recipes/")]
        assert len(told) == 1, stage
        assert "params.yaml" not in definition(stage)["deps"]


def test_text_has_the_same_bytes_in_every_clone():
    """Git's core.autocrlf would change what dvc.lock has the hashes of."""
    assert "* text=auto eol=lf" in (ROOT / ".gitattributes").read_text().splitlines()
