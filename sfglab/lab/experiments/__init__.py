"""The experiments, each a configuration, a run into one log, tables from the log, figures and claims.

An experiment is a module or package with ``NAME``, ``measure(log)`` -> our figures by claim id, and
``figures(log)`` -> figure and twin by name; `EXPERIMENTS` is the one list of them.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from types import ModuleType

__all__ = ["EXPERIMENTS", "experiment"]

EXPERIMENTS = (
    "naming",
    "depth_codecs",
    "decode_once",
    "routing",
    "lifecycle",
    "discovery",
    "latency",
    "balancing",
    "transmission",
    "cooperation",
    "gateways",
    "transfer",
    "driving",
    "mocap",
    "planning",
    "visualisation",
    "deployment",
)


def experiment(name: str) -> ModuleType | Any:
    """Return an experiment by its name in `EXPERIMENTS`."""
    module = import_module(f"sfglab.lab.experiments.{name}")
    return getattr(module, "exp", module)
