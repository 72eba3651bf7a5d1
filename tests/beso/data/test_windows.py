import numpy as np
import pytest
import torch

from beso.data.scaling import Scaling
from beso.data.windows import WindowConfig, Windows
from beso.errors import UserError

LENGTHS = (12, 9, 20, 8, 15)


@pytest.fixture
def data(make_dataset):
    return make_dataset(LENGTHS)


@pytest.fixture
def make(data, spec):
    def make(window=5, goal_window=1, episodes=(0, 1, 2, 3, 4)):
        episodes = np.array(episodes)
        return Windows(data, episodes, Scaling.fit(data, episodes, spec), WindowConfig(window, goal_window))

    return make


def drawn(windows, count, seed=0):
    start, goal, _ = windows.indices(count, torch.Generator().manual_seed(seed))
    return start.numpy(), goal.numpy()


@pytest.mark.parametrize(("window", "goal_window"), [(1, 1), (5, 1), (5, 2), (3, 4)])
def test_a_goal_follows_its_window_within_the_episode(make, data, window, goal_window):
    start, goal = drawn(make(window, goal_window), 20_000)
    episode = np.searchsorted(data.episode_ends, start, side="right")
    assert (start >= data.episode_starts[episode]).all()
    assert (goal >= start + window).all(), "a goal neither precedes nor overlaps its window"
    assert (goal + goal_window <= data.episode_ends[episode]).all(), "a goal stays in its window's episode"


@pytest.mark.parametrize(("window", "goal_window"), [(5, 1), (3, 4)])
def test_every_window_and_every_goal_can_be_drawn(make, data, window, goal_window):
    windows = make(window, goal_window)
    possible = {
        (start, goal)
        for first, end in zip(data.episode_starts, data.episode_ends, strict=True)
        for start in range(first, end)
        for goal in range(start + window, end - goal_window + 1)
    }
    assert len(windows) == len({start for start, _ in possible})
    # The rarest of the 200 or so pairs has a probability above 1/600: missing it in 20,000 draws is out of question.
    assert set(zip(*map(list, drawn(windows, 20_000)), strict=True)) == possible
    last_states = {int(end) - goal_window for end in data.episode_ends}
    assert last_states <= {goal for _, goal in possible}


def test_windows_and_goals_are_drawn_uniformly(make, data):
    windows, count = make(5, 1, [2]), 40_000
    start, goal = drawn(windows, count)
    shares = np.bincount(start - data.episode_starts[2], minlength=15) / count
    assert len(shares) == len(windows) == 15
    error = np.sqrt(1 / 15 * 14 / 15 / count)
    assert np.abs(shares - 1 / 15).max() < 4.5 * error
    of_first = goal[start == data.episode_starts[2]] - data.episode_starts[2]
    shares = np.bincount(of_first)[5:] / len(of_first)
    assert len(shares) == 15
    assert np.abs(shares - 1 / 15).max() < 4.5 * np.sqrt(1 / 15 * 14 / 15 / len(of_first))


@pytest.mark.parametrize(("horizon", "last"), [(None, 19), (3, 3)])
def test_a_share_of_the_goals_are_the_last_ones_and_the_others_stay_uniform(data, spec, horizon, last):
    """The windows of 20 steps that start at their episode's first."""
    scaling, count, share = Scaling.fit(data, np.array([2]), spec), 100_000, 0.6
    windows = Windows(data, np.array([2]), scaling, WindowConfig(1, 1, goal_horizon=horizon, final_goals=share))
    start, goal = drawn(windows, count)
    goals = goal[start == data.episode_starts[2]] - data.episode_starts[2]
    shares = np.bincount(goals)[1:] / len(goals)
    expected = np.full(last, (1 - share) / last)
    expected[-1] += share
    assert np.abs(shares - expected).max() < 4.5 * np.sqrt(share * (1 - share) / len(goals))


def test_samples_are_the_scaled_rows_of_their_indices(make, data, spec):
    windows = make(4, 2, [0, 2, 4])
    scaling = Scaling.fit(data, np.array([0, 2, 4]), spec)
    batch = windows.sample(50, torch.Generator().manual_seed(3))
    start, goal = drawn(windows, 50, seed=3)
    assert set(np.searchsorted(data.episode_ends, start, side="right")) == {0, 2, 4}
    for i in range(50):
        rows = slice(start[i], start[i] + 4)
        observations, actions = torch.from_numpy(data.observations[rows]), torch.from_numpy(data.actions[rows])
        goals = torch.from_numpy(data.observations[goal[i] : goal[i] + 2])
        assert torch.equal(batch.observations[i], scaling.scale_observations(observations))
        assert torch.equal(batch.actions[i], scaling.scale_actions(actions))
        assert torch.equal(batch.goal[i], scaling.scale_goals(goals))


def test_relative_goals_are_goals_less_the_windows_first_state(data, spec):
    episodes, config = np.arange(len(LENGTHS)), WindowConfig(3, 2)
    absolute, relative = (
        Windows(data, episodes, Scaling.fit(data, episodes, spec, relative), config) for relative in (False, True)
    )
    given, seen = (windows.sample(20, torch.Generator().manual_seed(0)) for windows in (absolute, relative))
    kept = [i for i in range(given.goal.shape[-1]) if i not in spec.goal_masked]
    assert spec.goal_masked
    assert torch.equal(seen.goal[..., kept], (given.goal - given.observations[:, :1])[..., kept])
    assert (seen.goal[..., spec.goal_masked] == 0).all()
    assert torch.equal(seen.observations, given.observations)


def test_a_sample_is_decided_by_its_generator(make):
    windows = make()
    torch.manual_seed(0)
    first = windows.sample(8, torch.Generator().manual_seed(1))
    torch.manual_seed(1)
    again = windows.sample(8, torch.Generator().manual_seed(1))
    other = windows.sample(8, torch.Generator().manual_seed(2))
    assert all(torch.equal(a, b) for a, b in zip(first, again, strict=True))
    assert not torch.equal(first.observations, other.observations)


def test_the_longest_window_that_fits_leaves_room_for_one_goal(make, data):
    windows = make(window=7, episodes=[3])  # 8 steps
    start, goal = drawn(windows, 20)
    assert len(windows) == 1
    assert set(start) == {data.episode_starts[3]}
    assert set(goal) == {data.episode_ends[3] - 1}


@pytest.mark.parametrize(("goal_window", "room"), [(1, 7), (2, 6)])
def test_a_window_that_does_not_fit_is_refused_with_the_lengths(make, goal_window, room):
    message = f"window = 8: the shortest episode has 8 steps, room for a window of at most {room} before a goal of"
    with pytest.raises(UserError, match=f"{message} {goal_window}"):
        make(window=8, goal_window=goal_window)


def test_the_future_follows_the_window_and_stops_at_the_episodes_end(data, spec):
    episodes = np.arange(len(LENGTHS))
    scaling = Scaling.fit(data, episodes, spec)
    windows = Windows(data, episodes, scaling, WindowConfig(2, 1, lookahead=6))
    start, goal, _ = windows.indices(500, torch.Generator().manual_seed(0))
    batch = windows.sample(500, torch.Generator().manual_seed(0))
    scaled = scaling.scale_observations(torch.from_numpy(np.array(data.observations)))
    last = torch.from_numpy(data.episode_ends)[np.searchsorted(data.episode_ends, start.numpy(), side="right")] - 1
    for ahead in range(6):
        assert torch.equal(batch.future[:, ahead], scaled[torch.minimum(start + 2 + ahead, last)])
    assert torch.equal(batch.goal_step, goal - start - 1)
    assert batch.goal_step.min() == 1


def test_actions_are_those_of_the_windows_episodes(data, spec):
    scaling = Scaling.fit(data, np.arange(len(LENGTHS)), spec)
    actions = Windows(data, np.array([1, 3]), scaling, WindowConfig(5, 1)).actions
    rows = np.concatenate([np.arange(data.episode_starts[i], data.episode_ends[i] - 1) for i in (1, 3)])
    assert torch.equal(actions, scaling.scale_actions(torch.from_numpy(np.array(data.actions)))[rows])
