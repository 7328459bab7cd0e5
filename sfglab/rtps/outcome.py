"""What a run of the model came to: fate and latency of every sample, and what the protocol spent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.rtps.state import W_LAST, Count, Drop, Fate, FlowColumn

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from sfglab.rtps.state import Params, State


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowOutcome:
    """One flow's samples, in the order of their sequence numbers."""

    name: str  #: The flow.
    published_ns: NDArray[np.int64]  #: When each was published, shape (n,).
    received_ns: NDArray[np.int64]  #: When the application was done with it, 0 where it never was, shape (n,).
    value: NDArray[np.int32]  #: Number of the value that it carries, shape (n,).
    fate: NDArray[np.int8]  #: A `Fate` each, shape (n,).
    dropped: NDArray[np.int8]  #: A `Drop` each: where its first frame was lost, shape (n,).
    deadline_ns: int | None = None  #: The agreed longest gap between samples; None: none.

    @property
    def delivered(self) -> NDArray[np.bool_]:
        """Which samples the application had, shape (n,)."""
        return np.equal(self.fate, Fate.DELIVERED)

    @property
    def loss(self) -> float:
        """Share of samples that the application never had; NaN without samples."""
        return float(1 - self.delivered.mean()) if len(self.fate) else float("nan")

    @property
    def latency_ns(self) -> NDArray[np.int64]:
        """From publication to application, of those delivered, shape (delivered,)."""
        return (self.received_ns - self.published_ns)[self.delivered]

    def deadlines_missed(self) -> int:
        """Return how often the reader waited beyond the deadline for the next sample (DDS 1.4, 2.2.3.7)."""
        if self.deadline_ns is None:
            return 0
        gaps = np.diff(np.sort(self.received_ns[self.delivered]))
        return int((gaps // self.deadline_ns).sum())


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """A whole run."""

    flows: dict[str, FlowOutcome]  #: By name.
    counts: dict[str, int]  #: What the protocol and the medium did, by `Count`'s names in lower case.


def outcome_of(flows: Sequence[Any], params: Params, state: State) -> Outcome:
    """Read a finished state.

    Args:
        flows: The flows, in the state's order.
        params: The run's parameters.
        state: After `simulate`.
    """
    results = {}
    for i, flow in enumerate(flows):
        samples = slice(1, int(state.writer[i, W_LAST]) + 1)
        fate = state.fate[i, samples].copy()
        open_ = fate == Fate.NEVER_SENT
        best_effort = not params.flows[i, FlowColumn.RELIABLE]
        lost = open_ & best_effort & (state.dropped[i, samples] != Drop.NOT)
        fate[open_] = Fate.UNDERWAY
        fate[lost] = Fate.NOT_REPAIRED
        results[flow.name] = FlowOutcome(
            name=flow.name,
            published_ns=state.published_ns[i, samples],
            received_ns=state.received_ns[i, samples],
            value=state.value[i, samples],
            fate=fate,
            dropped=state.dropped[i, samples],
            deadline_ns=flow.qos.deadline_ns,
        )
    return Outcome(flows=results, counts={c.name.lower(): int(state.counts[c]) for c in Count})
