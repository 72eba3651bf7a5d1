import numpy as np

from beso.envs.calvin.states import SIZE, StatesEnv, see


def test_states_are_seen_and_the_goal_is_told():
    environment, goal = StatesEnv(), np.zeros((1, SIZE), dtype=np.float32)
    observation, info = environment.reset(seed=0, options={"goal": goal})
    assert observation.shape == (SIZE,)
    assert info["goal"] is goal
    after = environment.step(np.array([1.0, 0, 0, 0, 0, 0, 1.0]))[0]
    assert np.array_equal(after, see(environment.table))
    assert not np.array_equal(after, observation)
    environment.close()
