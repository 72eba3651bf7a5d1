"""Linear probe: what features tell of the simulator's state, measured on episodes that neither encoder nor probe saw.

Every target is regressed on the standardised features with a ridge penalty. Of a target with two sides, such as an open
or closed drawer, the share of steps on the right side counts; of the others, the root of the mean squared distance.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

PENALTIES: Final = (1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)  # times the number of steps; see `fit`
BLOCK: Final = 4096  # steps


@dataclass(frozen=True)
class Target:
    """Something that features should tell.

    Attributes:
        name: what the report calls it.
        columns: its numbers in the simulator's states.
        threshold: of one number, where its two sides meet; None for places.
        margin: steps closer than that to the threshold are on neither side, as a door half open; they do not count.
    """

    name: str
    columns: tuple[int, ...]
    threshold: float | None = None
    margin: float = 0.0

    def values(self, states: np.ndarray) -> np.ndarray:
        """(T, S) -> (T, D): -1 or 1, or the numbers themselves."""
        chosen = np.asarray(states, dtype=np.float64)[:, list(self.columns)]
        return chosen if self.threshold is None else np.where(chosen > self.threshold, 1.0, -1.0)

    def counts(self, states: np.ndarray) -> np.ndarray:
        """Which steps are measured, (T,) booleans."""
        if self.threshold is None:
            return np.ones(len(states), dtype=bool)
        return np.abs(np.asarray(states, dtype=np.float64)[:, self.columns[0]] - self.threshold) >= self.margin


def probe(
    representations: Mapping[str, np.ndarray], states: np.ndarray, held_out: np.ndarray, targets: Sequence[Target]
) -> list[dict[str, Any]]:
    """A row for each target and representation.

    Args:
        representations: (T, F) by name.
        states: (T, S) of the simulator.
        held_out: (T,) booleans, the steps that are measured; the others are fitted.

    Returns:
        Columns: target, representation, measure ("accuracy" or "error"), value, and constant: the value of the best
        answer that does not look. Both are NaN if no step could be measured.
    """
    rows = []
    values = np.concatenate([target.values(states) for target in targets], axis=1)
    stops = np.cumsum([len(target.columns) for target in targets])
    constant = np.broadcast_to(values[~held_out].mean(axis=0), values[held_out].shape)
    for name, features in representations.items():
        predicted = fit(features, values, held_out)
        for target, stop in zip(targets, stops, strict=True):
            part = slice(stop - len(target.columns), stop)
            true, counted = values[held_out, part], target.counts(states[held_out])
            rows.append(
                {
                    "target": target.name,
                    "representation": name,
                    "measure": "error" if target.threshold is None else "accuracy",
                    "value": _measure(target, predicted[counted, part], true[counted]),
                    "constant": _measure(target, constant[counted, part], true[counted]),
                }
            )
    return rows


def _measure(target: Target, predicted: np.ndarray, true: np.ndarray) -> float:
    if len(true) == 0:
        return float("nan")
    if target.threshold is None:
        return float(np.sqrt(np.square(predicted - true).sum(axis=1).mean()))
    return float((np.sign(predicted) == true).mean())


def fit(features: np.ndarray, values: np.ndarray, held_out: np.ndarray) -> np.ndarray:
    """Values of the held-out steps as a ridge regression on the others predicts them.

    The penalty is that of PENALTIES with the least squared error on the last fifth of the fitted steps, for each value.

    Args:
        features: (T, F); values: (T, D); held_out: (T,) booleans.
    """
    steps = np.flatnonzero(~held_out)
    chosen, checked = steps[: len(steps) * 4 // 5], steps[len(steps) * 4 // 5 :]
    errors = [np.square(p - values[checked]).mean(axis=0) for p in _ridge(features, values, chosen, checked)]
    best = np.argmin(errors, axis=0)
    predicted = np.stack(list(_ridge(features, values, steps, np.flatnonzero(held_out))))
    return np.take_along_axis(predicted, best[None, None, :], axis=0)[0]


def _ridge(features: np.ndarray, values: np.ndarray, fitted: np.ndarray, asked: np.ndarray) -> list[np.ndarray]:
    """Predictions for the steps `asked` with each penalty; the sums go over blocks of steps."""
    blocks = [fitted[start : start + BLOCK] for start in range(0, len(fitted), BLOCK)]
    mean = sum(features[block].sum(axis=0, dtype=np.float64) for block in blocks) / len(fitted)
    variance = sum(np.square(features[block] - mean).sum(axis=0) for block in blocks) / len(fitted)
    scale = 1 / np.sqrt(np.where(variance > 0, variance, 1))
    middle = values[fitted].mean(axis=0)
    products: Any = 0
    targets: Any = 0
    for block in blocks:
        standard = (features[block] - mean) * scale
        products += standard.T @ standard
        targets += standard.T @ (values[block] - middle)
    answers = [np.linalg.solve(products + p * len(fitted) * np.eye(len(mean)), targets) for p in PENALTIES]
    return [((features[asked] - mean) * scale) @ answer + middle for answer in answers]
