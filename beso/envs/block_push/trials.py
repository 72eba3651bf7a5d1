"""Which episodes policies are evaluated on: goals are last states of demonstrations (paper, "Block-Push")."""

from beso.envs.block_push.spec import SPEC
from beso.envs.protocol import Trial, TrialRequest, demonstration_trials

MAX_ACTIONS = 299  # the published loop of 300 records its result before the last action


def make(request: TrialRequest) -> list[Trial]:
    """Goals from demonstrations; the environment exchanges the blocks where its targets lie the other way round."""
    return demonstration_trials(request, SPEC, MAX_ACTIONS)
