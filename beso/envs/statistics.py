"""Statistics of play data that all environments report."""

from beso.data.play import PlayDataset


def sizes(dataset: PlayDataset) -> dict[str, float]:
    """Numbers of demonstrations and steps, and the demonstrations' lengths, by the names in the report."""
    return {
        "demonstrations": len(dataset),
        "steps": len(dataset.actions),
        "mean length (steps)": float(dataset.lengths.mean()),
        "std of length (steps)": float(dataset.lengths.std()),
        "longest (steps)": int(dataset.lengths.max()),
    }
