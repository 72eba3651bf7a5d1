import pytest
import torch

from beso.core.device import pick_device, pick_precision
from beso.errors import UserError

CPU = torch.device("cpu")


@pytest.mark.parametrize(("capability", "precision"), [("avx512_bf16", "bf16"), ("amx_bf16", "bf16"), ("avx2", "fp32")])
def test_auto_is_bf16_where_the_processor_multiplies_it(monkeypatch, capability, precision):
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: {capability: True})
    assert pick_precision("auto", CPU) == precision
    assert pick_precision("bf16", CPU) == "bf16"
    assert pick_precision("fp32", CPU) == "fp32"


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_without_a_gpu():
    assert pick_device("auto") == CPU
    with pytest.raises(UserError, match="finds no GPU"):
        pick_device("cuda")
    with pytest.raises(UserError, match="device = cuda:1: this PyTorch finds no GPU"):
        pick_device("cuda:1")


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:-1", "cuda:x", "cuda:1:2", "meta", "CPU", "cpu:0", "", 3])
def test_other_names_are_refused_in_one_line(name):
    with pytest.raises(UserError, match="must be auto, cpu, cuda, or one GPU as cuda:0, cuda:1") as caught:
        pick_device(name)
    assert "\n" not in str(caught.value)


def test_one_of_several_gpus(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    assert pick_device("cuda:1") == torch.device("cuda", 1)
    with pytest.raises(UserError, match="device = cuda:2: the last GPU here is cuda:1"):
        pick_device("cuda:2")
