"""Where published data are looked for."""

from dataclasses import replace

import pytest

from beso import envs
from beso.errors import UserError
from pipeline import profile
from pipeline.machine import Machine
from pipeline.recipes import EnvironmentRecipe
from stages.collect import collect


@pytest.mark.parametrize("env", envs.names())
def test_the_folder_may_be_below_the_home(tmp_path, monkeypatch, env):
    monkeypatch.setenv("HOME", str(tmp_path))
    settings = profile.load("smoke").environments[env].collect
    recipe = EnvironmentRecipe(env, 0, replace(settings, source="published", folder="~/play"))
    with pytest.raises(UserError, match=f"^{tmp_path}/play"):
        collect(recipe, Machine(workers=1))
    assert list(tmp_path.iterdir()) == []
