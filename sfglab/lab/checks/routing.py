"""Checks of the routing policy: paper A, section 4.1, Eq. 1 and Table 1. The checks are computed; no router runs."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from sfglab.fleet.policy import Crossing, Direction, Policy, Side
from sfglab.lab.checks import Checks
from sfglab.names import RosFqn, all_standard_fqns, dds_topic

if TYPE_CHECKING:
    from collections.abc import Iterator

AGENT = "go2"

NEAR_MISSES = (
    "/chatter",
    "/global",
    "/global_x/y",
    "/globally/x",
    "/Global/x",
    "/local/global/x",
    "/robot/global/x",
    "/rt/global/x",
    "/tf2",
    "/tf/x",
    "/robot/tf",
    "/robot/tf_static",
)
"""Topics that Table 1 does not name, although they resemble those that it names."""

checks = Checks()


def in_table_1(dds_name: str) -> bool:
    """Return whether Table 1 of paper A names a DDS topic, without its patterns."""
    prefix, _, rest = dds_name.partition("/")
    if prefix == "rt" and rest in {"tf", "tf_static"}:
        return True
    return prefix in {"rt", "rq", "rr"} and rest.startswith("global/")


def random_dds_names(count: int, *, rng: np.random.Generator) -> Iterator[str]:
    """Yield DDS names that are random sequences of the parts of Table 1 and of other parts."""
    heads = ("rt", "rq", "rr", "rs", "RT", "")
    parts = (
        "tf",
        "tf_static",
        "global",
        "local",
        "globally",
        "global_x",
        "a",
        "camera_front",
        "*",
        "",
    )
    tails = ("", "Request", "Reply")
    for _ in range(count):
        middle = [parts[i] for i in rng.integers(len(parts), size=rng.integers(1, 5))]
        head, tail = heads[rng.integers(len(heads))], tails[rng.integers(len(tails))]
        yield "/".join((head, *middle)) + tail


@cache
def _names(count: int, seed: int) -> tuple[str, ...]:
    """Return the DDS names of all standard names, the near misses, and `count` random ones."""
    standard = (name for fqn in all_standard_fqns(AGENT) for name in fqn.dds_names)
    drawn = random_dds_names(count, rng=np.random.default_rng(seed))
    return ("rt/tf", "rt/tf_static", *standard, *map(dds_topic, NEAR_MISSES), *drawn)


@checks.each("a name crosses exactly if Table 1 names it, both ways", _names)
def _as_table_1(name: str) -> bool:
    return all(Policy().crosses(name, way) is in_table_1(name) for way in Direction)


@checks.each("a message is heard in the domains that Eq. 1 says", _names)
def _as_eq_1(name: str) -> bool:
    is_in = in_table_1(name)
    return all(
        Policy().domains(name, side) == (frozenset(Side) if is_in else {side}) for side in Side
    )


@checks.each(
    "a standard name crosses whole if it is global, else not at all",
    lambda *_: all_standard_fqns(AGENT),
)
def _crosses_by_scope(fqn: RosFqn) -> bool:
    expected = Crossing.WHOLE if fqn.is_global else Crossing.NONE
    return all(Policy().crossing(str(fqn), fqn.kind, way) is expected for way in Direction)
