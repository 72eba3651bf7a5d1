import json

import numpy as np
import pytest

from beso.data import play
from beso.envs.protocol import Trial, TrialRequest, demonstration_trials
from beso.errors import UserError
from beso.evaluation import trials


def trial(number, **options):
    """A trial that is told by its number."""
    own = {"goal": np.full((1, 3), number, dtype=np.uint8), "scene": np.arange(2.0) + number, **options}
    return Trial(2**62 + number, own, (number, 0), 30 + number, {"zebra": number, "ape": f"{number} 5"})


@pytest.fixture
def made():
    return {("near", 1): [trial(0), trial(1)], ("far", 1): [trial(2)], ("far", 4): [trial(3)]}


@pytest.fixture
def folder(made, tmp_path):
    trials.save(made, tmp_path / "trials")
    return tmp_path / "trials"


def assert_equal(ours, theirs):
    assert (ours.seed, ours.tasks, ours.limit, ours.labels) == (theirs.seed, theirs.tasks, theirs.limit, theirs.labels)
    assert list(ours.labels) == list(theirs.labels), "the order of columns"
    assert ours.options.keys() == theirs.options.keys()
    for name, array in theirs.options.items():
        assert np.array_equal(ours.options[name], array)
        assert ours.options[name].dtype == array.dtype


def test_what_is_saved_is_loaded(made, folder):
    loaded = trials.load(folder)
    assert list(loaded) == list(made)
    for key in made:
        for ours, theirs in zip(loaded[key], made[key], strict=True):
            assert_equal(ours, theirs)


def test_the_same_trials_give_the_same_bytes(made, folder, tmp_path):
    trials.save(made, tmp_path / "again")
    for path in folder.iterdir():
        assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_some_are_picked(made, folder):
    (picked,) = trials.pick(trials.load(folder), "near", 1, range(1, 2))
    assert_equal(picked, made["near", 1][1])


@pytest.mark.parametrize("key", [("near", 1, 2), ("near", 4, 0), ("other", 1, 0)])
def test_those_that_were_not_made_are_named(folder, key):
    goals, seed, number = key
    with pytest.raises(UserError, match=rf"episode {number} with goal set {goals} and seed {seed} was not made"):
        trials.pick(trials.load(folder), goals, seed, [number])


def test_trials_have_the_same_options(made, tmp_path):
    made["far", 4] = [trial(3, wind=np.zeros(1))]
    with pytest.raises(ValueError, match="different options"):
        trials.save(made, tmp_path / "trials")
    assert not list(tmp_path.iterdir())


def damaged(folder, change):
    description = json.loads((folder / "trials.json").read_text())
    change(description)
    (folder / "trials.json").write_text(json.dumps(description))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "trials.json").unlink(), "has no trials.json: run `dvc repro trials`"),
        (lambda folder: (folder / "trials.json").write_text("{"), "trials.json is damaged"),
        (lambda folder: (folder / "goal.npy").unlink(), "goal.npy is missing"),
        (lambda folder: (folder / "goal.npy").write_bytes(b"x"), "goal.npy is truncated or is not"),
        (lambda folder: np.save(folder / "goal.npy", np.zeros(4)), "goal.npy is not the file that trials.json"),
        (lambda folder: damaged(folder, lambda d: d["trials"].pop()), "expected a row for each of 3 trials"),
        (lambda folder: damaged(folder, lambda d: d["trials"][0].pop("limit")), "must hold trials, each with"),
        (lambda folder: damaged(folder, lambda d: d["trials"][0].update(number=1)), "trial 0 is missing before"),
        (lambda folder: damaged(folder, lambda d: d["trials"][0].update(limit=-5)), "limit above 0"),
        (lambda folder: damaged(folder, lambda d: d["trials"][0].update(seed=-1)), "must hold trials"),
        (lambda folder: damaged(folder, lambda d: d["trials"][0].update(tasks=["x"])), "must hold trials"),
        (lambda folder: damaged(folder, lambda d: d.update(trials=[])), "must hold trials"),
        (lambda folder: damaged(folder, lambda d: d.update(sha256=3)), "sha256 must hold the SHA-256 of every array"),
    ],
)
def test_a_damaged_folder_is_refused(folder, damage, message):
    damage(folder)
    with pytest.raises(UserError, match=message) as error:
        trials.load(folder)
    assert "\n" not in str(error.value)


def test_numbers_are_divided_at_will(make_dataset, spec, tmp_path):
    """A trial depends on its number alone, so that parts made in parallel are those of the whole."""
    play.save(make_dataset(), tmp_path / "data")
    request = TrialRequest("training", 1, range(7), 3, tmp_path / "data", 0.7, 0)
    whole = demonstration_trials(request, spec, 20)
    parts = [demonstration_trials(request._replace(numbers=n), spec, 20) for n in (range(4), range(4, 7))]
    for ours, theirs in zip(parts[0] + parts[1], whole, strict=True):
        assert_equal(ours, theirs)
