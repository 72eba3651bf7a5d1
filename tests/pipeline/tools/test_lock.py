from pathlib import Path

from pipeline.tools import lock

ROOT = Path(__file__).parents[3]


def test_results_come_from_the_versions_that_are_locked():
    """What `make setup` installs; another environment runs, but its bytes may differ."""
    assert lock.pinned()["results"] == (ROOT / lock.FOLDER / "results.txt").read_text().splitlines()


def test_every_package_stands_in_one_file():
    pinned = lock.pinned()
    names = [line.split("==")[0] for lines in pinned.values() for line in lines]
    assert len(names) == len(set(names))
    assert {"dvc", "click"} <= {line.split("==")[0] for line in pinned["tools"]}
    assert not any("+" in line for lines in pinned.values() for line in lines), "no build of one machine"
