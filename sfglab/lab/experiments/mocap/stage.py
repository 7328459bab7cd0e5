"""The live rounds: robot, bridge and listener as processes of their own, and how their reports become rows.

What the cameras got wrong is known from the same seed.
"""

from __future__ import annotations

import time
from collections import Counter
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.fields import from_json
from sfglab.lab.checks.trees import OBJECT
from sfglab.lab.experiments.mocap.recordings import truth_of
from sfglab.lab.workers.mocap import MOTION, ROUNDS, TAIL_S, MocapWorkerConfig
from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC
from sfglab.processes import Member, ProcessGroup
from sfglab.spatial import StampedTransform
from sfglab.spatial.frames.listener import TRANSFORMS
from sfglab.spatial.mocap.synthetic import synthetic_captures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.component import Report
    from sfglab.lab.testbed import Testbed
    from sfglab.spatial.mocap.synthetic import TrueCapture

    Reports = dict[str, Report]

HOSTS = {"robot": "agent_x", "bridge": "mocap", "listener": "viewer"}
_DOMAINS = {"proxy": 51, "direct": 52, "renamed": 53}
_MODULE = "sfglab.lab.workers.mocap"
_LEAD_S, _SLACK_S = 1.0, 90.0
_MOST_HEARD = 400


async def play(group: ProcessGroup, name: str, live_s: float) -> tuple[int, Reports]:
    """Play one of `ROUNDS` on the processes of `members`; return its time 0, ns, and everybody's report.

    Raises:
        ProcessFailedError: A process failed.
    """
    start_ns = time.time_ns() + round(_LEAD_S * 1e9)
    order: dict[str, Any] = {"name": name, "start_ns": start_ns, "seconds": live_s}
    return start_ns, await group.ask("played", timeout_s=_LEAD_S + live_s + _SLACK_S, **order)


def members(testbed: Testbed, seed: int) -> Iterator[Member]:
    """Yield the processes, each on its one of `HOSTS`; the seed is the cameras' and the listener's."""
    for role, host in HOSTS.items():
        interface = testbed.interface(host)
        ways = {way: BusAddress(domain_id=domain, interface=interface) for way, domain in _DOMAINS.items()}
        config = MocapWorkerConfig(role=role, ways=ways, seed=seed)
        yield Member(name=role, module=_MODULE, config=config, host=host)


def live_rows(
    name: str, live_s: float, seed: int, start_ns: int, reports: Reports
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield table and row for everything that a round reports, from its time 0 on."""
    heard, taken = reports["listener"], reports["bridge"]["receipts"]
    received = {capture_ns: receipt_ns for capture_ns, receipt_ns, _ in taken}
    of = {"round": name}
    yield from (("look", {**of, **look}) for look in heard["looks"])
    for way, outcomes in heard["tries"].items():
        for outcome, count in outcomes.items():
            yield "try", {**of, "way": way, "outcome": outcome, "count": count}
    names: dict[str, str] = {}
    for edge in heard["edges"]:
        authority = names.setdefault(edge["authority"], f"publisher {len(names)}")
        yield "edge", {"where": name, **edge, "authority": authority}
    every = max(1, -(-len(heard["heard"]) // _MOST_HEARD))
    for capture_ns, published_ns, heard_ns in heard["heard"][::every]:
        row = {
            "at_s": (capture_ns - start_ns) / 1e9,
            "receipt_ms": (received[capture_ns] - capture_ns) / 1e6,
            "publication_ms": (published_ns - capture_ns) / 1e6,
            "heard_ms": (heard_ns - capture_ns) / 1e6,
        }
        yield "heard", {**of, **row}
    truth = {made.capture.capture_ns: truth_of(made) for made in _made(name, live_s, seed)}
    sights = Counter((truth[capture_ns - start_ns], published) for capture_ns, _, published in taken)
    for (kind, published), count in sights.items():
        yield "sight", {**of, "truth": kind, "published": published, "count": count}
    yield from (("spell", {**of, **row}) for row in _spells(name, live_s, seed))


def live_tree(start_ns: int, reports: Reports) -> Iterator[tuple[str, Any, int]]:
    """Yield topic, message and time for the bridge's tree as heard, thinned; what is static at time 0."""
    tree = reports["listener"]["tree"]
    for topic, kept in ((TF_STATIC, tree["still"]), (TF, tree["moving"])):
        for received_ns, values in kept:
            transform = from_json(StampedTransform, values)
            yield topic, message_type(TRANSFORMS)(transforms=[transform.to_msg()]), received_ns or start_ns


def _made(name: str, live_s: float, seed: int) -> Iterator[TrueCapture]:
    """Return the captures of a round, which its seed gives, from its time 0 on."""
    rng = np.random.default_rng(seed)
    return synthetic_captures({OBJECT: MOTION}, ROUNDS[name], rng, duration_s=live_s + TAIL_S)


def _spells(name: str, live_s: float, seed: int) -> Iterator[dict[str, Any]]:
    """Yield when the cameras of a round were wrong."""
    last, rate_hz = -1, ROUNDS[name].rate_hz
    for kind, group in groupby(_made(name, live_s, seed), key=truth_of):
        captures = [m.capture for m in group]
        for capture in captures:
            number = capture.number or 0
            if number > last + 1 and last >= 0:
                yield {"kind": "dropped", "begin_s": (last + 1) / rate_hz, "end_s": (number - 1) / rate_hz}
            last = number
        if kind != "seen":
            begin_ns, end_ns = captures[0].capture_ns, captures[-1].capture_ns
            yield {"kind": kind, "begin_s": begin_ns / 1e9, "end_s": end_ns / 1e9}
