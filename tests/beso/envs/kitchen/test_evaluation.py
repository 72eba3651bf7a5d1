import numpy as np

from beso.data import play
from beso.data.play import Episode, assemble
from beso.data.split import model_split
from beso.envs.kitchen import evaluation, trials
from beso.envs.kitchen.spec import SPEC
from beso.envs.protocol import Outcome, Trial, TrialRequest


def test_trials_have_the_last_two_states_of_their_demonstration(tmp_path):
    rng = np.random.default_rng(0)
    tasks = np.zeros((20, 7), dtype=np.uint8)
    tasks[5, 2] = tasks[9, 0] = 1
    episodes = [Episode(rng.standard_normal((20, 30)), rng.uniform(-1, 1, (20, 9)), tasks) for _ in range(4)]
    dataset = assemble(episodes, SPEC, {})
    play.save(dataset, tmp_path / "data")
    training, held_out = model_split(4, 0.75, 0, 1)
    for goals, chosen in (("training", [*training, training[0]]), ("held_out", [*held_out] * 4)):
        made = trials.make(TrialRequest(goals, 1, range(4), 7, tmp_path / "data", 0.75, 0))
        assert [trial.labels["goal_demonstration"] for trial in made] == chosen
        for trial, episode in zip(made, chosen, strict=True):
            assert np.array_equal(trial.options["goal"], dataset.observations[20 * episode + 18 : 20 * episode + 20])
            assert (trial.tasks, trial.limit) == ((2, 0), 279)
    environment = evaluation.make()
    _, info = environment.reset(seed=made[0].seed, options=made[0].options)
    assert np.array_equal(info["goal"], made[0].options["goal"])


def test_reward_counts_all_tasks_and_result_the_goals():
    trial = Trial(seed=0, options={}, tasks=(0, 1, 4, 5), limit=279, labels={})
    outcome = Outcome(3.0, 279, np.zeros(30), {"tasks": (5, 2, 0)}, np.zeros((2, 30)), np.zeros(30))
    assert evaluation.score(trial, outcome) == {"tasks": "5 2 0", "reward": 3.0, "result": 2, "length": 279}
