import importlib
import os
import subprocess
import sys

import pytest

from beso import envs
from beso.errors import UserError


@pytest.mark.parametrize("error", [RuntimeError("no such library\nmore"), ImportError()])
def test_an_environment_whose_packages_refuse_to_load_is_one_line(monkeypatch, error):
    def refuse(name):
        raise error

    name = envs.names()[0]
    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(UserError, match=f"environment '{name}' cannot be loaded: ") as caught:
        envs.evaluation(name)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("settings", [{"MUJOCO_GL": "elg"}, {"MUJOCO_GL": "egl", "PYOPENGL_PLATFORM": "osmesa"}])
def test_wrong_opengl_settings_stop_nothing_that_does_not_draw(settings):
    code = """
import os
from beso import envs
from beso.errors import CannotDrawError
envs.recorder("kitchen")
environment = envs.evaluation("kitchen").make(render_mode="rgb_array")
environment.reset(seed=0)
environment.step(environment.action_space.sample())
try:
    environment.render()
except CannotDrawError as error:
    assert len(str(error).splitlines()) == 1
print(os.environ["MUJOCO_GL"])
"""
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **settings}, capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split()[-1] == settings["MUJOCO_GL"], "as it was"


@pytest.mark.parametrize("name", envs.names())
def test_the_interface_tells_of_every_number(name):
    interface, spec = envs.interface(name), envs.spec(name)
    assert sum(part.width for part in interface.observation) == spec.observation_size
    assert sum(part.width for part in interface.action) == spec.action_size
    assert interface.period > 0
