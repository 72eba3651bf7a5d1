import pytest

from beso.envs.calvin import states, trials
from beso.errors import UserError
from pipeline import scratch
from pipeline.tools.states import judge


def test_play_is_recorded_a_policy_trained_and_judged_once(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(states, "LENGTH", 60)
    monkeypatch.setattr(trials, "MAX_ACTIONS", {"single_tasks": 5, "two_tasks": 5})
    monkeypatch.setenv("BESO_WORKERS", "1")
    judge("calvin-gcbc", steps=240, updates=3, trials=2, seed=77, folder=tmp_path)
    told = capsys.readouterr().out
    assert "calvin-gcbc, single_tasks: 0.00 of 2\n  close_drawer: 0 of 1\n  open_drawer: 0 of 1\n" in told
    assert "calvin-gcbc, two_tasks: 0.00 of 2\n" in told
    (weights,) = tmp_path.glob("calvin/gcbc-*/seed1.safetensors")
    before = weights.stat()
    judge("calvin-gcbc", steps=240, updates=3, trials=2, seed=77, folder=tmp_path)
    assert capsys.readouterr().out == told
    assert weights.stat() == before
    monkeypatch.setattr(scratch, "_code_digest", lambda: "another demonstrator")
    judge("calvin-gcbc", steps=240, updates=3, trials=2, seed=77, folder=tmp_path)
    assert len(list(tmp_path.glob("calvin/play-*"))) == len(list(tmp_path.glob("calvin/gcbc-*"))) == 2


def test_a_cell_that_cannot_be_judged_is_one_line(tmp_path):
    for cell, message in (("calvin-nothing", "has no cell calvin-nothing"), ("kitchen-gcbc", "has no states.py")):
        with pytest.raises(UserError, match=message):
            judge(cell, steps=240, updates=3, trials=2, seed=77, folder=tmp_path)
