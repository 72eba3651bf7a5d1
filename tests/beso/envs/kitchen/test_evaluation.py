import numpy as np

from beso.data.play import Episode, assemble
from beso.envs.kitchen import evaluation
from beso.envs.kitchen.spec import SPEC
from beso.envs.protocol import Outcome, Trial, TrialRequest


def test_trials_have_the_last_two_states_of_their_demonstration():
    rng = np.random.default_rng(0)
    tasks = np.zeros((20, 7), dtype=np.uint8)
    tasks[5, 2] = tasks[9, 0] = 1
    episodes = [Episode(rng.standard_normal((20, 30)), rng.uniform(-1, 1, (20, 9)), tasks) for _ in range(4)]
    dataset = assemble(episodes, SPEC, {})
    for goals, chosen in (("training", [2, 0, 3, 2]), ("held_out", [1, 1, 1, 1])):
        request = TrialRequest(goals, range(4), dataset, np.array([2, 0, 3]), np.array([1]), seed=7, model_seed=1)
        trials = evaluation.trials(request)
        assert [trial.labels["goal_demonstration"] for trial in trials] == chosen
        for trial, episode in zip(trials, chosen, strict=True):
            assert np.array_equal(trial.options["goal"], dataset.observations[20 * episode + 18 : 20 * episode + 20])
            assert (trial.tasks, trial.limit) == ((2, 0), 279)
    environment = evaluation.make()
    _, info = environment.reset(seed=trials[0].seed, options=trials[0].options)
    assert np.array_equal(info["goal"], trials[0].options["goal"])


def test_reward_counts_all_tasks_and_result_the_goals():
    trial = Trial(seed=0, options={}, tasks=(0, 1, 4, 5), limit=279, labels={})
    outcome = Outcome(3.0, 279, np.zeros(30), {"tasks": (5, 2, 0)}, np.zeros((2, 30)))
    assert evaluation.score(trial, outcome) == {"tasks": "5 2 0", "reward": 3.0, "result": 2, "length": 279}
