"""The rules of the folders: who may import whom, and that dvc.yaml names what its stages really import."""

import ast
from pathlib import Path

import pytest
from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
PROJECT = ("beso", "pipeline", "stages")
STAGES = YAML(typ="safe").load((ROOT / "dvc.yaml").read_text())["stages"]
GRID = YAML(typ="safe").load((ROOT / "params.yaml").read_text())["grid"]


def imports(path):
    """Project modules that a file imports when it runs, as paths; imports for type checkers alone do not count."""
    tree = ast.parse((ROOT / path).read_text())
    for_types = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    found = set()
    for node in ast.walk(tree):
        names = []
        if id(node) in for_types:
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
        if path not in seen:
            seen.add(path)
            waiting += imports(path)
    return seen


def expand(text, env, method):
    return text.replace("${item.env}", env).replace("${item.method}", method)


def declared(stage, env, method):
    """The project's Python files among a cell's deps; a folder stands for all files in it."""
    files = set()
    for dep in STAGES[stage]["deps"]:
        path = Path(expand(dep, env, method))
        if path.parts[0] in PROJECT:
            files |= {p.relative_to(ROOT) for p in (ROOT / path).rglob("*.py")} if (ROOT / path).is_dir() else {path}
    return {f for f in files if f.suffix == ".py" and (ROOT / f).read_text().strip()}


BY_NAME = {  # what a stage imports by the names in its cell
    "collect": ["beso/demonstrators/{env}.py"],
    "train": ["beso/methods/{method}.py"],
    "evaluate": ["beso/methods/{method}.py", "beso/envs/{env}.py"],
    "latency": [f"beso/methods/{method}.py" for method in GRID["methods"]],
    "fork": [f"beso/methods/{method}.py" for method in GRID["methods"]],
    "tables": [],
    "page": [],
}


@pytest.mark.parametrize("stage", STAGES)
def test_deps_are_what_the_stage_imports(stage):
    """No cell lacks a dep; no dep is unused by all cells of the stage."""
    used_by_any = set()
    for env in GRID["envs"]:
        for method in GRID["methods"]:
            entry = [f"stages/{stage}.py", *(name.format(env=env, method=method) for name in BY_NAME[stage])]
            used = closure(entry)
            names = declared(stage, env, method)
            assert used - names == set(), "imported, but not among the deps"
            used_by_any |= used | {Path(f"beso/methods/{method}.py")}
    extra = set().union(*(declared(stage, e, m) for e in GRID["envs"] for m in GRID["methods"])) - used_by_any
    assert extra == set(), "among the deps, but never imported"


def test_a_methods_file_is_a_dep_of_its_own_cells_only():
    for stage in ("train", "evaluate"):
        for method in GRID["methods"]:
            methods = {p for p in declared(stage, "block_push", method) if p.parent == Path("beso/methods")}
            assert methods == {Path("beso/methods/__init__.py"), Path(f"beso/methods/{method}.py")}


def test_imports_point_downward():
    allowed = {"stages": {"stages", "pipeline", "beso"}, "pipeline": {"pipeline", "beso"}, "beso": {"beso"}}
    for top in PROJECT:
        for path in (ROOT / top).rglob("*.py"):
            tops = {p.parts[0] for p in imports(path.relative_to(ROOT))}
            assert tops <= allowed[top], path


def test_only_training_rollouts_and_checkpoints_use_methods_inside_the_library():
    users = {
        path.relative_to(ROOT).as_posix()
        for path in (ROOT / "beso").rglob("*.py")
        if path.parent.name != "methods" and Path("beso/methods/__init__.py") in imports(path.relative_to(ROOT))
    }
    assert users == {"beso/training.py", "beso/checkpoint.py", "beso/rollout.py"}


def test_stage_scripts_are_short():
    for path in (ROOT / "stages").glob("*.py"):
        assert len(path.read_text().splitlines()) < 60, path


def test_parameters_of_sampling_do_not_reach_training():
    assert not any(".sample." in p for p in STAGES["train"]["params"])
    for stage in STAGES.values():
        assert not any(p.startswith("machine") for p in stage.get("params", []))
