"""What the arrays are that a policy takes and gives: sizes, order and units, in words."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple


class Columns(NamedTuple):
    """Some columns of an array: how many, what they are, their unit ("" for none)."""

    width: int
    what: str
    unit: str


class Interface(NamedTuple):
    """An environment's arrays, in its `interface.py`.

    Attributes:
        observation, action: columns of a raw observation and of a raw action, in their order.
        goal: what a goal's states are.
        period: how long an action lasts, seconds.
    """

    observation: tuple[Columns, ...]
    action: tuple[Columns, ...]
    goal: str
    period: float


@dataclass(frozen=True)
class PolicySpec:
    """What a loaded policy takes and gives, all of it raw. `print` shows it as text.

    Attributes:
        environment: None where the policy's folder does not tell.
        observation_shape, goal_shape, action_shape: of what `act` takes, `reset` takes and `act` gives; None for a size
            that is not known. A goal is a number of states, each like an observation.
        frames: whether observations are pictures, uint8 RGB, height first.
        interface: columns and units of the environment; None where it is unknown. Of `frames`, there are no columns.
        seen: columns of an observation that the policy sees.
        seen_of_goals: columns of a goal's states that it sees.
        sampling: how actions are generated, by parameter.
    """

    environment: str | None
    observation_shape: tuple[int | None, ...]
    goal_shape: tuple[int | None, ...]
    action_shape: tuple[int]
    frames: bool
    interface: Interface | None
    seen: tuple[int, ...]
    seen_of_goals: tuple[int, ...]
    sampling: dict[str, Any]

    def __str__(self) -> str:
        return "\n".join(self._lines())

    def _lines(self) -> Iterator[str]:
        interface = self.interface
        yield f"environment: {self.environment or 'unknown'}"
        yield f"observation: {_shape(self.observation_shape)}{', uint8 RGB' if self.frames else ''}"
        if interface and not self.frames:
            yield from _columns(interface.observation, self.seen)
        yield f"goal: {_shape(self.goal_shape)}{f', {interface.goal}' if interface else ''}"
        if interface and not self.frames and set(self.seen_of_goals) != set(self.seen):
            yield from _columns(interface.observation, self.seen_of_goals)
        yield f"action: {_shape(self.action_shape)}{f', for {interface.period:.3g} s' if interface else ''}"
        if interface:
            yield from _columns(interface.action, range(self.action_shape[0]))
        told = ", ".join(f"{name} {'null' if value is None else value}" for name, value in self.sampling.items())
        yield f"sampling: {told or 'nothing to choose'}"


def _shape(shape: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if size is None else str(size) for size in shape) + ("," * (len(shape) == 1)) + ")"


def _columns(parts: tuple[Columns, ...], seen: Any) -> Iterator[str]:
    first = 0
    for width, what, unit in parts:
        last = first + width - 1
        numbers = str(first) if width == 1 else f"{first}-{last}"
        hidden = "" if {*range(first, first + width)} & {*seen} else "; not seen"
        yield f"    {numbers:<7} {what}{f' ({unit})' if unit else ''}{hidden}"
        first += width
