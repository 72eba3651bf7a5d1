"""One torch thread: several threads on busy cores run many times slower than one."""

import torch

torch.set_num_threads(1)
