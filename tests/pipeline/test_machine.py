import pytest

from beso.errors import UserError
from pipeline.machine import Machine


def test_without_a_file_all_is_default(tmp_path):
    assert Machine.load(tmp_path / "machine.yaml") == Machine()


def test_a_file_gives_what_differs(tmp_path):
    file = tmp_path / "machine.yaml"
    file.write_text("workers: 3\ndevice: cpu\n")
    assert Machine.load(file) == Machine(workers=3, device="cpu")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("workers: -1", r"machine\.yaml: workers = -1: must be 0 \(one a processor\) or more"),
        ("wrokers: 1", r"machine\.yaml\.wrokers = 1: unknown key; allowed are workers, device"),
        ("engine: ray", r"machine\.yaml: device = auto: engine ray needs cpu"),
        ("seeds_together: 0", r"machine\.yaml: seeds_together = 0: must be at least 1"),
        ("- 1", r"machine\.yaml = \[1\]: expected a mapping"),
    ],
)
def test_a_mistake_is_one_line(tmp_path, text, message):
    file = tmp_path / "machine.yaml"
    file.write_text(text)
    with pytest.raises(UserError, match=message):
        Machine.load(file)
