"""Whoever adds an environment writes one folder, a method one file, a variant parameters; nothing else is touched."""

import textwrap

import pandas as pd
from ruamel.yaml import YAML

ENVIRONMENT = {
    "spec.py": """
        from beso.data.spec import PlaySpec

        SPEC = PlaySpec(
            name="toy", observation_size=2, action_size=2, visible=(0, 1), goal_masked=(), goal_window=1,
            tasks=("arrive",), goal_sets=("training",),
        )
        """,
    "report.py": """
        from matplotlib.figure import Figure

        from beso.envs.protocol import Drawing, Metric, Table

        LABEL = "Toy"
        GOAL_LABELS = {"training": "training goals"}
        METRICS = (Metric("success", "Success", 1.0),)
        PUBLISHED = {}


        def summary(dataset):
            return {"statistics": {"demonstrations": len(dataset)}, "lengths": dataset.lengths.tolist()}


        def drawings(play, episodes):
            figure = Figure()
            figure.subplots().plot(play["lengths"])
            return [Drawing("toy_lengths", f"Lengths, and {len(episodes)} methods.", figure)]


        def tables(episodes):
            return [Table("toy", "Toy rows.", ("Method", "Rows"), [(m, len(rows)) for m, rows in episodes.items()])]
        """,
    "simulator/__init__.py": """
        import gymnasium
        import numpy as np


        class ToyEnv(gymnasium.Env):
            def reset(self, *, seed=None, options=None):
                super().reset(seed=seed)
                self.state, self.goal = self.np_random.uniform(-1, 1, 2), options["goal"]
                return self.state.copy(), {"goal": self.goal}

            def step(self, action):
                self.state = self.state + np.clip(action, -0.1, 0.1)
                arrived = bool(np.linalg.norm(self.state - self.goal[-1]) < 0.2)
                return self.state.copy(), float(arrived), arrived, False, {}
        """,
    "demonstrations/scripted.py": """
        import numpy as np

        from beso.data.play import Episode
        from beso.core.seeding import generator


        def record(seed, index):
            rng = generator(seed, "toy", index)
            state, goal, rows = rng.uniform(-1, 1, 2), rng.uniform(-1, 1, 2), []
            for _ in range(30):
                action = np.clip(goal - state, -0.1, 0.1)
                rows.append((state, action))
                state = state + action
            observations, actions = (np.array(part, dtype=np.float32) for part in zip(*rows))
            return Episode(observations, actions, np.zeros((30, 1), dtype=np.uint8), failed_takes=index % 2)
        """,
    "trials.py": """
        from beso.envs.protocol import demonstration_trials
        from beso.envs.toy.spec import SPEC


        def make(request):
            return demonstration_trials(request, SPEC, 40)
        """,
    "evaluation.py": """
        from beso.envs.protocol import identity
        from beso.envs.toy.simulator import ToyEnv


        def make(render_mode=None):
            return ToyEnv()


        def encoder(data, device):
            return identity


        def score(trial, outcome):
            return {"success": outcome.reward, "length": outcome.length}
        """,
}
METHOD = '''
    """A linear policy."""

    from dataclasses import dataclass

    import torch
    from torch import nn

    from beso.core.method import BaseMethod, ModelConfig, SamplingConfig


    @dataclass(frozen=True)
    class Config(ModelConfig):
        window: int


    @dataclass(frozen=True)
    class Sampling(SamplingConfig):
        gain: float


    class Method(nn.Module, BaseMethod):
        def __init__(self, config, sampling, sizes, generator):
            super().__init__()
            self.layer = nn.Linear(2 * sizes.observation, sizes.action)
            with torch.no_grad():
                self.layer.weight.normal_(0, 0.1, generator=generator)
                self.layer.bias.zero_()
            self.gain = sampling.gain if sampling else 1.0

        def _predict(self, observations, goal):
            return self.layer(torch.cat([observations[:, -1], goal[:, -1]], dim=1))

        def loss(self, batch, generator):
            return (self._predict(batch.observations, batch.goal) - batch.actions[:, -1]).square().mean()

        def act(self, observations, actions, goal, noise, memory):
            return self.gain * self._predict(observations, goal)
    '''


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(textwrap.dedent(text).lstrip())


def parameters(workspace):
    return YAML(typ="safe").load((workspace.folder / "params.yaml").read_text())


def add_cell(workspace, env, method, of, source=None):
    cell = {"env": env, "method": method, "of": of, "source": source or f"data/play/{env}"}
    workspace.set("cells", {**parameters(workspace)["cells"], f"{env}-{method}": cell})


def changed(workspace):
    """Tracked source files that differ from the last commit, and new ones."""
    lines = workspace.run("git", "status", "--porcelain", "-uall", "beso", "pipeline", "stages", "dvc.yaml").stdout
    return {line[3:] for line in lines.splitlines() if "__pycache__" not in line}


def test_an_environment_is_one_folder_and_its_parameters(small):
    values = parameters(small)
    for name, text in ENVIRONMENT.items():
        write(small.folder / "beso/envs/toy" / name, text)
    (small.folder / "beso/envs/toy/__init__.py").touch()
    block_push = values["environments"]["block_push"]
    toy = {**block_push, "evaluation": {"goals": ["training"], "max_actions": None}}
    small.set("environments", {**values["environments"], "toy": toy})
    add_cell(small, "toy", "gcbc", "gcbc")
    ran = small.repro()
    assert set(ran) == {"collect@toy", "trials@toy", "train@toy-gcbc", "evaluate@toy-gcbc", "latency", "tables", "page"}
    assert all(name.startswith("beso/envs/toy/") for name in changed(small))
    rows = pd.read_csv(small.folder / "results/toy/gcbc.csv")
    assert len(rows) == 2 * 2  # seeds, rollouts
    assert rows["success"].isin([0, 1]).all()
    table = (small.folder / "reports/tables.tex").read_text()
    assert "Toy & Success & ours, training goals" in table
    assert "GCBC & 4" in table  # the room's own table
    assert (small.folder / "reports/figures/toy_lengths.pdf").is_file()
    assert '"failed_takes": 6' in (small.folder / "data/play/toy/meta.json").read_text()


def test_a_method_is_one_file_and_its_parameters(small):
    values = parameters(small)
    write(small.folder / "beso/methods/linear.py", METHOD)
    train = {"model": {"window": 1}, "optimization": {"steps": 30, "batch_size": 32}}
    block = {"label": "Linear", "train": {"all": train}, "sample": {"all": {"gain": 1.0}}}
    small.set("methods", {**values["methods"], "linear": block})
    add_cell(small, "block_push", "linear", "linear")
    cells = {"train@block_push-linear", "evaluate@block_push-linear"}
    assert set(small.repro()) == cells | {"latency", "fork", "tables", "page"}
    assert changed(small) == {"beso/methods/linear.py"}
    assert "& Linear" in (small.folder / "reports/tables.tex").read_text()
    small.set("methods.linear.sample.all.gain", 2.0)
    assert small.stale() == {"evaluate@block_push-linear", "tables", "page"}
    assert small.repro("evaluate@block_push-linear") == ["evaluate@block_push-linear"]


def test_a_variant_is_parameters_alone(small):
    values = parameters(small)
    wide = {"like": "c_beso", "all": {"model": {"transformer": {"width": 24}}}}
    block = {"label": "C-BESO, wide", "train": wide, "sample": {"like": "c_beso"}}
    small.set("methods", {**values["methods"], "c_beso_wide": block})
    add_cell(small, "block_push", "c_beso_wide", "c_beso")
    cells = ["train@block_push-c_beso_wide", "evaluate@block_push-c_beso_wide"]
    assert set(small.repro("tables")) == {*cells, "tables"}
    assert changed(small) == set()
    comparison = pd.read_csv(small.folder / "reports/comparison.csv")
    ours = comparison[(comparison["method"] == "c_beso_wide") & comparison["ours"].notna()]
    assert len(ours) == 2 * 2  # metrics, goal sets
    # A change of the method it changes reaches the variant too.
    small.set("methods.c_beso.sample.block_push.steps", 4)
    assert small.repro("evaluate@block_push-c_beso_wide") == ["evaluate@block_push-c_beso_wide"]
    small.set("methods.c_beso_wide.train.all.model.depth", 3)
    done = small.run("dvc", "repro", check=False)
    assert "methods.c_beso_wide.train.all.model.depth = 3: unknown key" in done.stdout


def test_a_student_follows_its_teacher(small):
    student = ["train@block_push-c_beso_one_step", "evaluate@block_push-c_beso_one_step"]
    small.set("methods.c_beso_one_step.train.block_push", {"optimization": {"steps": 31}})
    assert small.repro("train", "evaluate", "study") == student
    small.set("methods.c_beso.train.block_push.optimization.steps", 31)
    ran = small.repro(student[1])
    assert ran.index("train@block_push-c_beso") < ran.index(student[0]) < ran.index(student[1])
    assert small.repro(student[1]) == []
    text = (small.folder / "reports/tables.tex").read_text()
    assert "C-BESO and its students in Block-Push: the same starts and noise in every row" in text
