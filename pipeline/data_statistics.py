"""Statistics of a play dataset, beside those of the published one."""

import numpy as np
import pandas as pd

from beso.data.play import PlayDataset
from beso.data.spec import PlaySpec

PUBLISHED = {  # measured on the published block-push actions and masks (Cui et al. 2023)
    "block_push": {
        "demonstrations": 1000,
        "steps": 116_793,
        "mean length (steps)": 116.8,
        "std of length (steps)": 15.4,
        "longest (steps)": 201,
        "mean action size (m)": 0.01899,
        "share of actions of 0.03 m": 0.305,
        "share ended by success": 0.981,
    }
}
FULL_STEP = 0.03  # m; the speed limit of most of the demonstrator's phases


def statistics(dataset: PlayDataset, spec: PlaySpec) -> dict[str, float]:
    """Size, lengths and action statistics of a block-push dataset."""
    sizes = np.linalg.norm(dataset.actions, axis=1)
    return {
        "demonstrations": len(dataset),
        "steps": len(dataset.actions),
        "mean length (steps)": float(dataset.lengths.mean()),
        "std of length (steps)": float(dataset.lengths.std()),
        "longest (steps)": int(dataset.lengths.max()),
        "mean action size (m)": float(sizes.mean()),
        "share of actions of 0.03 m": float(np.mean(np.abs(sizes - FULL_STEP) < 1e-6)),
        "share ended by success": float(dataset.succeeded(spec).mean()),
    }


def beside_published(dataset: PlayDataset, spec: PlaySpec) -> pd.DataFrame:
    """Columns `statistic`, `ours`, `published` (missing where not known)."""
    ours, published = statistics(dataset, spec), PUBLISHED[spec.name]
    return pd.DataFrame([{"statistic": k, "ours": v, "published": published.get(k)} for k, v in ours.items()])
