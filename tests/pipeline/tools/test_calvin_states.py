import numpy as np
import pytest

from beso.envs.calvin import trials
from beso.errors import UserError
from pipeline.tools import calvin_states
from pipeline.tools.calvin_states import StatesEnv, judge, see


def test_play_is_recorded_a_policy_trained_and_judged_once(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(calvin_states, "LENGTH", 60)
    monkeypatch.setattr(trials, "MAX_ACTIONS", {"single_tasks": 5, "two_tasks": 5})
    monkeypatch.setenv("BESO_WORKERS", "1")
    judge("gcbc", steps=240, updates=3, trials=2, seed=77, folder=tmp_path)
    told = capsys.readouterr().out
    assert "gcbc, single_tasks: 0.00 of 2\n  close_drawer: 0 of 1\n  open_drawer: 0 of 1\n" in told
    assert "gcbc, two_tasks: 0.00 of 2\n" in told
    weights = tmp_path / "gcbc-240-3" / "seed1.safetensors"
    before = weights.stat()
    judge("gcbc", steps=240, updates=3, trials=2, seed=77, folder=tmp_path)
    assert capsys.readouterr().out == told
    assert weights.stat() == before


def test_an_unknown_method_is_one_line(tmp_path):
    with pytest.raises(UserError, match="has no cell calvin-nothing"):
        judge("nothing", steps=240, updates=3, trials=2, seed=77, folder=tmp_path)


def test_states_are_seen_and_the_goal_is_told():
    environment, goal = StatesEnv(), np.zeros((1, calvin_states.SIZE), dtype=np.float32)
    observation, info = environment.reset(seed=0, options={"goal": goal})
    assert observation.shape == (calvin_states.SIZE,)
    assert info["goal"] is goal
    after = environment.step(np.array([1.0, 0, 0, 0, 0, 0, 1.0]))[0]
    assert np.array_equal(after, see(environment.table))
    assert not np.array_equal(after, observation)
    environment.close()
