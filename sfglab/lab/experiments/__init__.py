"""The experiments: one module or package for each, with the declaration `exp`; `EXPERIMENTS` has their names."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from sfglab.lab.experiment import Experiment

__all__ = ["EXPERIMENTS", "experiment"]

EXPERIMENTS = (
    "naming",
    "depth_codecs",
    "decode_once",
    "routing",
    "lifecycle",
    "discovery",
    "middleware",
    "latency",
    "wireless",
    "balancing",
    "transmission",
    "cooperation",
    "phases",
    "gateways",
    "transfer",
    "driving",
    "mocap",
    "planning",
    "visualisation",
    "deployment",
    "ros2",
)
"""Names of the experiments."""


def experiment(name: str) -> Experiment[Any]:
    """Return the declaration of an experiment, by its name in `EXPERIMENTS`.

    Raises:
        InvalidValueError: There is no such experiment; the error names the closest ones.
    """
    if name not in EXPERIMENTS:
        allowed = ", ".join(EXPERIMENTS) + suggestion(name, EXPERIMENTS)
        raise InvalidValueError("experiment", name, allowed)
    found: Experiment[Any] = import_module(f"sfglab.lab.experiments.{name}").exp
    return found
