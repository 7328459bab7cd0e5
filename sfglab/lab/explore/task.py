"""The task of a worker, as its one argument has it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """What a worker is for."""

    experiment: str  #: The experiment's name.
    profile: str = ""  #: Of the run that it makes; empty: it draws.
    log: str = ""  #: Path of that run's log.
    settings: dict[str, Any] = field(default_factory=dict)  #: Fields of that run, as JSON has them.
    only: tuple[str, ...] | None = None  #: Tables of sweeps and names of parts that it makes; None: all.
