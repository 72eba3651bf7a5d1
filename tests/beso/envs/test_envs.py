import importlib

import pytest

from beso import envs
from beso.errors import UserError


@pytest.mark.parametrize(
    "error", [RuntimeError("invalid value for environment variable MUJOCO_GL: elg\nmore"), ImportError()]
)
def test_an_environment_whose_packages_refuse_to_load_is_one_line(monkeypatch, error):
    def refuse(name):
        raise error

    name = envs.names()[0]
    monkeypatch.setenv("MUJOCO_GL", "elg")
    monkeypatch.setattr(importlib, "import_module", refuse)
    with pytest.raises(UserError, match=f"environment '{name}' cannot be loaded, with MUJOCO_GL=elg") as caught:
        envs.evaluation(name)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", envs.names())
def test_the_interface_tells_of_every_number(name):
    interface, spec = envs.interface(name), envs.spec(name)
    assert sum(part.width for part in interface.observation) == spec.observation_size
    assert sum(part.width for part in interface.action) == spec.action_size
    assert interface.period > 0
