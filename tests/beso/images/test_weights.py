import pickle

import pytest
import safetensors.torch
import torch

from beso.errors import UserError
from beso.files import sha256
from beso.images.weights import read_weights

STATE = {"conv1.weight": torch.arange(6.0).reshape(2, 3), "bn1.num_batches_tracked": torch.tensor(3)}


def test_both_formats_are_read(tmp_path):
    safetensors.torch.save_file(STATE, tmp_path / "a.safetensors")
    torch.save(STATE, tmp_path / "a.pth")
    for path in tmp_path.iterdir():
        read = read_weights(path, sha256(path))
        assert read.keys() == STATE.keys()
        assert all(torch.equal(read[name], value) for name, value in STATE.items())


def test_another_file_is_refused_before_it_is_opened(tmp_path):
    with pytest.raises(UserError, match=r"a.pth is missing: features.weights names it"):
        read_weights(tmp_path / "a.pth", "0")
    (tmp_path / "a.pth").write_bytes(b"x")
    with pytest.raises(UserError, match=r"a.pth has SHA-256 2d71\w+, but features.weights says 0"):
        read_weights(tmp_path / "a.pth", "0")


class Dangerous:
    def __reduce__(self):
        return exit, (1,)


@pytest.mark.parametrize("name", ["a.pth", "a.safetensors"])
def test_code_and_damage_are_refused(tmp_path, name):
    path = tmp_path / name
    for content in (pickle.dumps(Dangerous()), b"x" * 100):
        path.write_bytes(content)
        with pytest.raises(UserError, match="is damaged or holds more than plain tensors"):
            read_weights(path, sha256(path))


def test_something_else_is_refused(tmp_path):
    torch.save([1, 2], tmp_path / "a.pth")
    with pytest.raises(UserError, match="does not hold tensors by name"):
        read_weights(tmp_path / "a.pth", sha256(tmp_path / "a.pth"))
