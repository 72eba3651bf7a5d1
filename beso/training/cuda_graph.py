"""CUDA graphs: the kernels of a function, recorded once and launched by one call ever after.

A training step of these networks is hundreds of small kernels, so that a GPU waits for Python between them.
torch.compile would fuse some, but stops at every dropout: it cannot trace draws from an explicit generator.
"""

from collections.abc import Callable

import torch
from torch import Tensor

WARM_UPS = 3  # calls before the recording, in which libraries set themselves up (PyTorch's documentation)


def record(function: Callable[[], Tensor], draws: torch.Generator) -> Callable[[], Tensor]:
    """A function that does the same on the GPU as `function`, each time with new random numbers from `draws`.

    `function` is called a few times, which leaves `draws` where it was, and must change nothing but gradients; it must
    not wait for the GPU, and must make the gradients that it adds to anew. Its result and the gradients are overwritten
    by the next call. Call this, and what it returns, on a stream that is not the default one.
    """
    state = draws.get_state()
    for _ in range(WARM_UPS):
        function()
    draws.set_state(state)
    graph = torch.cuda.CUDAGraph()
    graph.register_generator_state(draws)
    with torch.cuda.graph(graph):
        result = function()

    def replay() -> Tensor:
        graph.replay()
        return result

    return replay
