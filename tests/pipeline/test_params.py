import copy
import dataclasses
import json
import math
import shutil
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from ruamel.yaml import YAML

from beso import envs
from beso.config import LARGEST
from beso.errors import UserError
from beso.files import write_json
from pipeline import params, profile, recipes, yaml
from pipeline.settings import Collect, Features
from stages import resolve

PROFILES = profile.names()


@pytest.fixture(scope="module")
def smoke():
    return YAML(typ="safe").load(profile.render("smoke"))


@pytest.fixture
def values(smoke):
    return copy.deepcopy(smoke)


@pytest.mark.parametrize("name", PROFILES)
def test_every_profile_is_valid_and_says_its_name(name):
    assert params.parse(YAML(typ="safe").load(profile.render(name)), name).profile == name


def test_committed_params_are_the_quick_profile():
    assert params.PATH.read_text() == profile.render("quick")


def test_profiles_keep_the_comments_and_name_the_values_that_they_change():
    assert "every: 1000 # 2000 in profile paper; steps" in profile.render("cpu")
    assert "every: 250 # 2000 in profile paper; steps" in profile.render("quick")
    assert "learning_rate: 0.002 # 0.0015 in profile cpu\n" in profile.render("quick")  # paper has none there
    assert "window: 16 # [T]\n" in profile.render("quick")  # as in paper, and not in cpu


def test_paper_profile_has_the_papers_numbers():
    paper = profile.load("paper")
    assert len(paper.environments["block_push"].seeds) == 10
    assert paper.environments["block_push"].evaluation.rollouts == 100
    cell = paper.cell("block_push", "c_beso")
    train = cell.train.first.config
    assert dataclasses.astuple(train.model.transformer) == (240, 4, 12, 5, 0.05, 0.05, "sequential")
    assert (train.model.diffusion.sigma_min, train.model.diffusion.sigma_max, train.model.diffusion.sigma_data) == (
        0.05,
        1,
        0.5,
    )
    assert (train.optimization.steps, train.optimization.batch_size) == (60_000, 1024)
    assert (train.optimization.optimizer, train.optimization.learning_rate) == ("adam", 1e-4)
    assert cell.evaluate.sampling.steps == 3
    guided = paper.cell("block_push", "cfg_beso")
    assert guided.evaluate.sampling.guidance_scale == 2
    assert guided.train.first.config.model.goal_dropout == 0.1


IDDPM = {
    "sampler": "ddim",
    "schedule": "iddpm",
    "steps": 2000,
    "sigma_min": 0.05,
    "sigma_max": 1.0,
    "context": "clean",
    "context_length": None,
}
ALL = ("all_environments",)
BLOCK_PUSH = ("environments", "block_push")
TASKS = ("environments", "calvin", "evaluation", "tasks")
MODEL = ("methods", "c_beso", "train", "all", "model", "transformer")
SAMPLE = ("methods", "c_beso", "sample", "all")
STUDENT = ("cells", "block_push-c_beso_one_step")
DISTILLED = ("methods", "distilled", "train", "block_push", "model")
OPTIMIZATION = ("methods", "gcbc", "train", "all", "optimization")


CAMERA = {"length": 100, "size": 64}
RAW = {"to": "raw", "source": "scripted", "demonstrations": 2, "folder": None, "camera": CAMERA}
IMAGES = {
    "preprocess": {"size": 64, "held_out": 0.1},
    "features": {
        "width": 32,
        "head": "average",
        "precision": "bf16",
        "weights": None,
        "finetune": False,
        "pretraining": {
            "steps": 10,
            "batch_size": 4,
            "learning_rate": 1.0e-3,
            "weight_decay": 0.01,
            "inverse_dynamics": 1.0,
            "reconstruction": 1.0,
            "horizon": 16,
            "shift": 2,
        },
    },
}
WEIGHTS = {"path": "x", "sha256": "0", "mean": [0.5, 0.5, 0.5], "std": [1, 1, 1]}


def cell(env, method, of=None, source=None):
    return {"env": env, "method": method, "of": of or method, "source": source or f"data/play/{env}"}


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ((*MODEL, "depth"), 3, r"methods\.c_beso\..*\.transformer\.depth = 3: unknown key; allowed are width, layers"),
        ((*MODEL, "heads"), 5, r"transformer: heads = 5: must divide width = 16"),
        ((*MODEL, "width"), "wide", r"transformer\.width = 'wide': expected an integer"),
        ((*MODEL, "width"), 16.0, r"transformer\.width = 16\.0: expected an integer"),
        ((*OPTIMIZATION, "learning_rate"), "1e-3", r"learning_rate = '1e-3': expected a finite number"),
        *(
            (("methods", "gcbc", "label"), label, r"methods\.gcbc: label = .*: must have 1 to 40 characters, none of")
            for label in ("50 %", "a_b", "$x$", "A & B", "#1", r"\input{x}", "a\nb", "", "x" * 41, "a~b", "a^b", "{a}")
        ),
        (("methods", "gcbc", "label"), "C-BESO", r"methods\.gcbc: label = 'C-BESO': must be one that no other"),
        ((*OPTIMIZATION, "batch_size"), 10**12, r"optimization\.batch_size = 10+: must be at most 1048576"),
        ((*BLOCK_PUSH, "collect", "demonstrations"), 10**18, r"collect\.demonstrations = 10+: must be at most 1000000"),
        (("environments", "calvin", "collect", "camera", "size"), 10**9, r"size = 10+: must be at most 4096"),
        ((*OPTIMIZATION, "optimizer"), "sgd", r"optimizer = 'sgd': expected one of adam, adamw, muon"),
        ((*OPTIMIZATION, "steps"), True, r"steps = True: expected an integer"),
        ((*ALL, "evaluation", "rollouts"), 0, r"\.all_environments\.evaluation: rollouts = 0: must be at least 1"),
        ((*BLOCK_PUSH, "seeds"), [1, 1], r"seeds = \[1, 1\]: must be different"),
        (("cells", "block_push-sac"), cell("block_push", "sac"), r"methods\.sac is missing: cells\.block_push-sac"),
        (("cells", "moon-gcbc"), cell("moon", "gcbc"), r"environments\.moon is missing: cells\.moon-gcbc"),
        (("cells", "other"), cell("block_push", "gcbc"), r"cells\.other: its name must be env and method .*-gcbc"),
        (
            (*STUDENT, "source"),
            "models/kitchen/c_beso",
            r"source = 'models/kitchen/c_beso': must be one of data/play/bl",
        ),
        (
            (*STUDENT, "source"),
            "models/block_push/c_beso_one_step",
            r"one_step\.source = .*: must be one of data/play/b",
        ),
        ((*STUDENT, "source"), "models/block_push/gcbc", r"distilled: the teacher's transformer is None and the stud"),
        ((*STUDENT, "source"), "models/block_push/c_beso_film", r"distilled: the teacher's transformer is .*'film'"),
        ((*STUDENT, "source"), "data/play/block_push", r"source = 'data/play/block_push': distilled: needs a teach"),
        (("cells", "block_push-gcbc", "source"), "models/block_push/c_beso", r"gcbc: learns from play data, not fr"),
        ((*DISTILLED, "transformer"), {"width": 32}, r"one_step\.source = .*: distilled: the teacher's transformer"),
        ((*DISTILLED, "steps"), 4, r"block_push\.model: teacher_steps = 3: must be at least steps = 4"),
        (("environments", "moon"), {}, r"environments\.moon\.collect\.to is missing"),
        (("cells", "block_push-gcbc", "film"), "yes", r"block_push-gcbc\.film = 'yes': expected true or false"),
        (
            ("cells", "block_push-gcbc", "of"),
            "../../os",
            r"gcbc\.of = '\.\./\.\./os': must be a file in beso/m",
        ),
        (
            ("methods", "x;touch y;#"),
            {"label": "x", "train": {}, "sample": {}},
            r"methods\.x;touch y;#: a name must",
        ),
        (("studies", "<b>x"), {}, r"studies\.<b>x: a name must be made of lower-case letters, digits and _"),
        (("environments", "../../evil"), {}, r"environments\.\.\./\.\./evil: a name must be made of lower-case"),
        (
            ("methods", "cfg_beso", "train", "like"),
            "c_besp",
            r"cfg_beso\.train\.like = 'c_besp': must be one of gc",
        ),
        (("methods", "c_beso", "train", "like"), ["gcbc"], r"c_beso\.train\.like = \['gcbc'\]: must be one of"),
        (("methods", "c_beso", "train", "like"), "", r"c_beso\.train\.like = '': must be one of"),
        (("methods", "c_beso", "train", "like"), "cfg_beso", r"train\.like = '.*beso': leads in a circle"),
        (
            ("methods", "c_beso", "train", "kitchn"),
            {},
            r"methods\.c_beso\.train\.kitchn: must be one of all, like",
        ),
        (("methods", "c_beso", "train", "kitchen"), 7, r"methods\.c_beso\.train\.kitchen = 7: expected a mapping"),
        (("studies", "samplers_block_push", "vary"), {}, r"vary = {}: must name at least one parameter"),
        (("studies", "samplers_block_push", "vary"), {"sampler": "x"}, r"vary\.sampler = 'x': must be a list"),
        (("studies", "samplers_block_push", "vary"), {"steps": [3, 5, 3]}, r"vary\.steps = .*: must be .* different"),
        (("latency", "batches"), [], r"latency: batches = \[\]: must be positive, at least one"),
        (("latency", "batches"), [1, 0], r"latency: batches = \[1, 0\]: must be positive"),
        (("studies", "samplers_block_push", "vary"), {"speed": [1]}, r"samplers_block_push\.speed = 1: unknown"),
        (("studies", "samplers_block_push", "vary"), {"sampler": ["x"]}, r"sampler = 'x': must be one of euler,"),
        (
            ("studies", "samplers_block_push", "goals"),
            ["two_tasks"],
            r"goals = \['two_tasks'\]: must be different ones of the evaluation's, training, held_out",
        ),
        (("studies", "samplers_block_push", "goals"), ["training"] * 2, r"\.goals = .*: must be different"),
        (("studies", "samplers_block_push", "goals"), [], r"samplers_block_push\.goals = \[\]: must be different"),
        (("studies", "samplers_block_push", "seeds"), [9], r"push\.seeds = \[9\]: must be different ones of"),
        (("cells", "block_push-c_beso", "seeds"), [], r"beso\.seeds = \[\]: must be different ones of the"),
        (("cells", "block_push-c_beso", "seeds"), [2], r"one_step\.seeds = \[1, 2\]: must be .* of the teacher's, 2"),
        (("studies", "samplers_block_push", "rollouts"), 3, r"rollouts = 3: must be at most the evaluation's, 2"),
        (("studies", "samplers_block_push", "method"), "gcbd", r"block_push-gcbd of c_beso is not"),
        ((*ALL, "training", "goal_horizon"), 0, r"goal_horizon = 0: must be at least 1"),
        ((*BLOCK_PUSH, "collect", "source"), "published", r"folder = null: source published needs a folder"),
        ((*BLOCK_PUSH, "collect", "to"), "raw", r"collect: camera is missing or out of place: to = raw"),
        ((*BLOCK_PUSH, "collect", "camera"), CAMERA, r"collect: camera is missing or out of place: to = play"),
        ((*BLOCK_PUSH, "collect"), RAW, r"block_push\.collect\.to = 'raw': must be play: its policies see states"),
        (("images", "block_push"), IMAGES, r"images\.block_push: the policies of this environment see states"),
        (("images", "moon"), IMAGES, r"environments\.moon is missing: images\.moon names it"),
        (("colour",), "red", r"colour = 'red': unknown key"),
        (("profile",), "../x", r"profile = '\.\./x': must be made of"),
        ((*ALL, "evaluation", "goals"), ["held_out"], r"goals = \['held_out'\]: must be \['training'\] or"),
        (("cells",), {}, r"cells = {}: at least one is needed"),
        (
            (*BLOCK_PUSH, "evaluation"),
            {"tasks": ["push"]},
            r"block_push\.evaluation\.tasks = .*: must be left out",
        ),
        (TASKS, None, r"calvin\.evaluation\.tasks is missing: expected a list of tasks, of rotate_red_block_right, "),
        (TASKS, [], r"calvin\.evaluation: tasks = \[\]: must be different, at least one"),
        (TASKS, ["open_drawer"] * 2, r"tasks = \['open_drawer', 'open_drawer'\]: must be different, at least one"),
        (TASKS, ["fly"], r"tasks = 'fly': there is no such task; allowed are rotate_red_block_right, "),
        (
            TASKS,
            ["lift_red_block_table"],
            r"'lift_red_block_table': no trial can ask for it alone; allowed are ",
        ),
        (TASKS, "open_drawer", r"tasks = 'open_drawer': expected a list, each item text"),
        ((*OPTIMIZATION, "learning_rate"), math.nan, r"learning_rate = nan: expected a finite number"),
        (
            (*SAMPLE, "context_length"),
            6,
            r"c_beso\.sample\.block_push: context_length = 6: must be at most .* window, 5",
        ),
        (
            ("methods", "cx_diff", "sample", "block_push", "steps"),
            99,
            r"cx_diff\.sample\.block_push: steps = 99: must be at most diffusion_steps, 20",
        ),
        (
            ("methods", "cfg_beso_element", "train", "all", "model", "goal_dropout_from"),
            0.5,
            r"goal_dropout_from = 0\.5: must be 0 where goal_dropout_of is element",
        ),
        ((*SAMPLE, "context_length"), 0, r"context_length = 0: must be at least 1"),
        (SAMPLE, IDDPM, r"steps = 2000: iddpm has 471 levels"),
    ],
)
def test_a_mistake_is_one_line_with_key_value_and_what_is_allowed(values, path, value, message):
    inner = values
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    with pytest.raises(UserError, match=message) as error:
        params.parse(values, "params.yaml")
    assert "\n" not in str(error.value)


def places(values):
    """Every mapping or list with each of its keys, from the outside in."""
    for key in list(values if isinstance(values, dict) else range(len(values))):
        yield values, key
        if isinstance(values[key], dict | list):
            yield from places(values[key])


names = st.one_of(st.text(max_size=5), st.sampled_from(["all", "like", "gcbc", "a\nb", "x" * 10**4]))
anything = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), names, st.sampled_from([10**18, 10**400, 1.0])),
    lambda inner: st.one_of(st.lists(inner, max_size=2), st.dictionaries(names, inner, max_size=2)),
    max_leaves=4,
)
edits = st.lists(st.tuples(st.integers(0, 10**6), st.sampled_from(["lose", "rename", "replace"]), anything), min_size=1)


@settings(max_examples=40, deadline=None)
@given(edits=edits)
def test_changed_anywhere_it_is_read_or_refused_in_one_line(smoke, edits):
    values = copy.deepcopy(smoke)
    for place, kind, value in edits[:2]:
        found = list(places(values))
        inner, key = found[place % len(found)]
        if kind == "lose":
            del inner[key]
        elif kind == "rename" and isinstance(inner, dict):
            inner[value if isinstance(value, str) else repr(value)] = inner.pop(key)
        else:
            inner[key] = value
    message = "read"
    try:
        params.parse(values, "params.yaml")
    except UserError as error:
        message = str(error)
    assert len(message.splitlines()) == 1
    assert len(message) <= 2003


@pytest.fixture
def room(values):
    """An environment that sees images: the first that there is, with the parameters of block push."""
    name = next(path.parts[-3] for path in Path(envs.__path__[0]).glob("*/demonstrations/raw.py"))
    values["environments"][name] = {**copy.deepcopy(values["environments"]["block_push"]), "collect": RAW}
    values["images"][name] = IMAGES
    values["studies"] = {key: study for key, study in values["studies"].items() if study["env"] != name}
    return name


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("preprocess", "size"), 65, r"preprocess\.size = 65: must be at most collect\.camera\.size, 64"),
        (("preprocess", "held_out"), 1.0, r"preprocess: held_out = 1\.0: must be between 0 and 1"),
        (("features", "width"), 24, r"features: width = 24: must be one of 64, 32, 16, 8"),
        (("features", "head"), "flat", r"features\.head = 'flat': expected one of average, pyramid"),
        (("features", "weights"), {"path": "x"}, r"features\.weights\.sha256 is missing"),
        (("features", "weights"), WEIGHTS | {"mean": [0.5]}, r"weights: mean = \[0\.5\]: must be three numbers"),
        (("features", "weights"), WEIGHTS | {"std": [1, 0, 1]}, r"weights: std = .*: must be positive"),
        (("features", "pretraining", "horizon"), 0, r"pretraining: horizon = 0: must be at least 1"),
        (
            ("features", "pretraining", "steps"),
            0,
            r"features: pretraining\.steps = 0: must be at least 1 unless finetune",
        ),
        (("features", "pretraining", "steps"), -1, r"pretraining: steps = -1: must not be negative"),
        (("features", "finetune"), "maybe", r"features\.finetune = 'maybe': expected true or false"),
        (("features",), None, r"features = None: expected a mapping"),
        ((), None, r"images\.\w+ = None: expected a mapping"),
    ],
)
def test_mistakes_about_images(values, room, monkeypatch, path, value, message):
    spec = envs.spec
    monkeypatch.setattr(envs, "spec", lambda name: spec("block_push"))
    monkeypatch.setattr(envs, "single_tasks", lambda name: ())
    assert params.parse(values, "params.yaml").images[room].preprocess.size == 64
    inner = values["images"] = copy.deepcopy(values["images"])
    *parents, last = (room, *path)
    for key in parents:
        inner = inner[key]
    inner[last] = value
    with pytest.raises(UserError, match=message):
        params.parse(values, "params.yaml")
    del values["images"][room]
    with pytest.raises(UserError, match=rf"images\.{room} is missing: its policies see images"):
        params.parse(values, "params.yaml")
    values["environments"][room]["collect"] = values["environments"]["block_push"]["collect"]
    with pytest.raises(UserError, match=r"collect\.to = 'play': must be raw: its policies see images"):
        params.parse(values, "params.yaml")


def test_every_key_is_needed(values, tmp_path, monkeypatch):
    """Nothing has a silent default: a recipe, with all that is inherited, is refused when one of its keys is gone."""
    for key in values:
        with pytest.raises(UserError, match=rf"{key} is missing"):
            params.parse({name: value for name, value in values.items() if name != key}, "params.yaml")
    monkeypatch.setattr(recipes, "FOLDER", tmp_path)

    def paths(inner, path=()):
        for key, value in inner.items():
            yield (*path, key)
            if isinstance(value, dict) and path[-1:] != ("methods",):
                yield from paths(value, (*path, key))

    read = {"train": recipes.read_train, "evaluate": recipes.read_evaluate, "study": recipes.read_study}
    read |= {"collect": lambda env: recipes.read_environment(Collect, "collect", env)}
    read |= {"features": lambda env: recipes.read_environment(Features, "features", env)}
    optional = {("evaluation", "tasks"), ("settings", "camera")}
    for name, recipe in resolve.recipes(params.parse(values, "params.yaml")):
        kind, *parts = name.split("/")
        if kind not in read or "kitchen" in name:
            continue
        whole, file = dataclasses.asdict(recipe), tmp_path / f"{name}.json"
        for path in paths(whole):
            broken = copy.deepcopy(whole)
            inner = broken
            for key in path[:-1]:
                inner = inner[key]
            del inner[path[-1]]
            write_json(file, broken)
            if path not in optional and path != ("first", "config", "model", "final_goals"):
                with pytest.raises(UserError, match="is missing"):
                    read[kind](*parts)
        write_json(file, whole)
        assert json.loads(json.dumps(dataclasses.asdict(read[kind](*parts)))) == json.loads(json.dumps(whole))


def test_numbers_are_read_as_dvc_reads_them(tmp_path):
    file = tmp_path / "params.yaml"
    file.write_text("rate: 1e-4\nswitch: on\n")
    assert yaml.read_yaml(file) == {"rate": 1e-4, "switch": "on"}


def test_unreadable_files_are_one_line(tmp_path):
    file = tmp_path / "params.yaml"
    with pytest.raises(UserError, match=r"params\.yaml is missing$"):
        yaml.read_yaml(file)
    for text in ("a: [1,\nb: 2", f"a: {'9' * 5000}", "a: !!int x", "[" * 5000, "a: 2020-13-45"):
        file.write_text(text)
        with pytest.raises(UserError, match="is not valid YAML") as error:
            yaml.read_yaml(file)
        assert "\n" not in str(error.value)
        assert len(str(error.value)) < 400
    for content, message in ((b"a: \xe9", "is not UTF-8 text"), (b"a: 1\n<<<<<<< HEAD\n", "has git's merge markers")):
        file.write_bytes(content)
        with pytest.raises(UserError, match=message):
            yaml.read_yaml(file)
    with pytest.raises(UserError, match="is a folder, expected a file"):
        yaml.read_yaml(tmp_path)


@pytest.mark.parametrize(
    ("file", "text", "message"),
    [
        ("paper/kitchen.yaml", "a: [1,", r"paper/kitchen\.yaml is not valid YAML"),
        ("paper/kitchen.yaml", "", r"paper/kitchen\.yaml: must be a mapping"),
        ("smoke/kitchen.yaml", "- 1", r"smoke/kitchen\.yaml: must be a mapping"),
    ],
)
def test_a_broken_profile_is_one_line(tmp_path, monkeypatch, file, text, message):
    shutil.copytree(profile.FOLDER, tmp_path / "profiles")
    (tmp_path / "profiles" / file).write_text(text)
    monkeypatch.setattr(profile, "FOLDER", tmp_path / "profiles")
    with pytest.raises(UserError, match=message):
        profile.render("smoke")


def test_unknown_profile_is_refused():
    with pytest.raises(UserError, match="profile 'tiny' is not one of cpu, gpu, paper, quick, smoke"):
        profile.render("tiny")


def test_profiles_build_on_each_other(tmp_path, monkeypatch):
    """What a profile says of all environments replaces what those before it said of each."""
    shutil.copytree(profile.FOLDER, tmp_path / "profiles")
    monkeypatch.setattr(profile, "FOLDER", tmp_path / "profiles")
    (tmp_path / "profiles/mine").mkdir()
    file = tmp_path / "profiles/mine/common.yaml"
    file.write_text("extends: quick\nall_environments: {evaluation: {chunk: 5}}\n")
    mine, quick = (yaml.parse_yaml(profile.render(name), name) for name in ("mine", "quick"))
    assert params.parse(mine, "mine").environments["block_push"].evaluation.chunk == 5
    assert mine["environments"]["block_push"]["evaluation"] == {"rollouts": 20}
    assert mine["profile"] == "mine"
    assert {**mine, "profile": "quick", "all_environments": 0, "environments": 0} == {
        **quick,
        "all_environments": 0,
        "environments": 0,
    }
    file.write_text("images: {calvin: {features: {weights: {path: mine.pth}}}}\n")
    with pytest.raises(UserError, match=r"features\.weights\.sha256 is missing"):  # a mapping in place of null
        profile.render("mine")
    file.write_text("extends: mine\n")
    with pytest.raises(UserError, match="profile mine extends itself: mine -> mine"):
        profile.render("mine")
    file.write_text("extends: other\n")
    with pytest.raises(UserError, match="profile 'other' is not one of cpu, gpu, mine, paper, quick, smoke"):
        profile.render("mine")


def test_labels_may_have_letters_of_any_alphabet(values):
    values["methods"]["gcbc"]["label"] = "GCBC (λ), 2nd: a/b + c"
    assert params.parse(values, "p").labels["gcbc"] == "GCBC (λ), 2nd: a/b + c"


def test_every_whole_number_of_params_has_a_largest_value():
    """One that is in no table could be any."""
    unlimited = {"guidance_scale"}  # a number with decimals, given without
    for name in PROFILES:
        for key, value in profile.leaves(YAML(typ="safe").load(profile.render(name))):
            numbers = value if isinstance(value, list) else [value]
            if "vary" not in key and any(type(number) is int for number in numbers):
                assert key.rpartition(".")[2] in {*LARGEST, *unlimited}, key


def test_a_whole_number_among_a_studys_decimals_is_the_decimal(values):
    """The paper's number beside it is found by the value."""
    values["studies"]["guidance_block_push"]["vary"]["guidance_scale"] = [0, 1, 1.5]
    changes = params.parse(values, "p").studies["guidance_block_push"].changes
    assert [repr(change["guidance_scale"]) for change in changes] == ["0.0", "1.0", "1.5"]
