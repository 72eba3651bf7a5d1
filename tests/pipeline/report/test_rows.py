"""A file of rows has every episode once, or the report says in one line what is wrong."""

import dataclasses
from pathlib import Path

import pandas as pd
import pytest

from beso.errors import UserError
from beso.evaluation.config import EvaluationConfig
from pipeline.report.rows import read

EVALUATION = EvaluationConfig(seed=0, rollouts=3, goals=("training", "held_out"), chunk=2, max_actions=None)
CHANGES = ({"sampler": "ddim", "steps": None}, {"sampler": "heun", "steps": 3})
PATH = Path("rows.csv")
EVALUATED = ({},)  # an evaluation changes nothing


def rows(changes=EVALUATED):
    scores = {"tasks": "2", "reward": 0.5, "result": 1, "length": 9}
    return pd.DataFrame(
        [
            {**change, "seed": seed, "goals": goals, "episode": i, **scores}
            for change in changes
            for seed in (1, 2)
            for goals in EVALUATION.goals
            for i in range(3)
        ]
    )


@pytest.fixture
def told(tmp_path, monkeypatch):
    """told(text, changes) -> the rows that are read, or the line that says what is wrong."""
    monkeypatch.chdir(tmp_path)

    def told(text, changes=EVALUATED):
        PATH.write_bytes(text if isinstance(text, bytes) else text.encode())
        try:
            return read(PATH, "evaluate@block_push-gcbc", "block_push", (1, 2), EVALUATION, changes)
        except UserError as error:
            line = str(error)
        assert len(line.splitlines()) == 1
        assert line.startswith(("rows.csv ", "rows.csv: "))
        return line

    return told


def test_whole_rows_are_read_in_any_order(told):
    assert told(rows().to_csv(index=False))["tasks"].tolist() == ["2"] * 12
    study = rows(CHANGES).sample(frac=1, random_state=0)
    assert len(told(study.to_csv(index=False), CHANGES)) == 24


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: pd.concat([r, r[3:5]]), "rows.csv has seed 1, goals held_out, episode 0 twice"),
        (lambda r: r.drop([4, 7]), "lacks 2 episodes, the first of seed 1, goals held_out, episode 1: make it again"),
        (lambda r: r[:0], "lacks 12 episodes"),
        (lambda r: pd.concat([r, r[:6].assign(seed=7)]), "has, unasked for, 6 episodes, the first of seed 7, goals "),
        (lambda r: r.replace("held_out", "moon"), "lacks 6 episodes, the first of seed 1, goals held_out, episode 0"),
        (lambda r: r.assign(episode=r["episode"] + 0.5), "lacks 12 episodes"),
        (lambda r: r.drop(columns="reward"), "has no column reward"),
        (lambda r: r.drop(columns="seed"), "has no column seed"),
        (lambda r: r.rename(columns=str.upper), "has no column seed"),
        (lambda r: r.assign(result=["much", *[1] * 11]), "result of row 1 is 'much', no number"),
        (lambda r: r.assign(result=[*[1] * 11, None]), "result of row 12 is 'nan', no number"),
    ],
)
def test_other_rows_are_one_line(told, change, message):
    assert message in told(change(rows()).to_csv(index=False))


def test_a_study_has_every_sampling(told):
    assert "lacks 12 episodes, the first of sampler heun, steps 3" in told(
        rows(CHANGES[:1]).to_csv(index=False), CHANGES
    )
    assert "has no column sampler" in told(rows().to_csv(index=False), CHANGES)
    more = rows((*CHANGES, {"sampler": "heun", "steps": 5}))
    assert "has, unasked for, 12 episodes, the first of sampler heun, steps 5" in told(
        more.to_csv(index=False), CHANGES
    )


@pytest.mark.parametrize("text", ["", "\n", "seed,goals,episode\n1,2\n3,4,5,6,7\n", b"\xff\xfe\x00", "no table"])
def test_text_that_is_no_table_is_one_line(told, text):
    assert "make it again" in told(text)


def test_a_file_that_is_not_there_says_which_stage_makes_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=r"rows\.csv is missing: run `dvc repro study@x`"):
        read(PATH, "study@x", "block_push", (1,), dataclasses.replace(EVALUATION, rollouts=1))
