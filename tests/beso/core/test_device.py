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
