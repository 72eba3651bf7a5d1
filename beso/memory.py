"""What a policy carries from step to step of its episodes."""

from torch import Tensor

Memory = dict[str, Tensor]  # by name, with a row an episode; empty at the episodes' start
