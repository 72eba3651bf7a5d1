"""One torch thread: several threads on busy cores run many times slower than one."""

import torch

torch.set_num_threads(1)


def pytest_collection_modifyitems(items):
    """One file that needs the whole run comes first, then those that do not: on two cores, they run beside it."""
    waiting = list(dict.fromkeys(item.path for item in items if "finished" in item.fixturenames))
    waiting.sort(key=lambda path: path.name != "test_publish.py")  # the longest
    items.sort(key=lambda item: waiting.index(item.path) if item.path in waiting else 0.5)
