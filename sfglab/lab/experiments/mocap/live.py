"""The live rounds: robot, bridge and listener as processes of their own, and what became of every look.

Knows how to start, order and end them, and how their reports become rows; what the cameras got wrong is known
from the same seed.
"""

from __future__ import annotations

import asyncio
import sys
import time
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.lab.experiments.mocap.config import ROUNDS, TAIL_S, WAYS, MocapWorkerConfig
from sfglab.lab.experiments.mocap.robot import MOTION, OBJECT
from sfglab.lab.experiments.mocap.rows import MocapEdgeRow, MocapHeardRow, MocapLookRow, SpellRow, TryRow
from sfglab.lab.staging import Staged
from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC
from sfglab.processes import LineProcess
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames import TRANSFORMS
from sfglab.spatial.mocap import Lapse, synthetic_captures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.experiments.mocap.config import Config
    from sfglab.lab.testbed import Testbed
    from sfglab.spatial.mocap import TrueCapture


HOSTS = {"robot": "agent_x", "bridge": "mocap", "listener": "viewer"}
_DOMAINS = {way: 51 + place for place, way in enumerate(WAYS)}
_MODULE = "sfglab.lab.experiments.mocap.worker"
_START_S, _LEAD_S, _SLACK_S = 40.0, 1.0, 20.0
_MOST_HEARD = 400
_FIELDS = ("at_s", "wait_ms", "error_mm", "error_mrad", "age_ms", "latest_mm", "latest_mrad")


class LiveStage(Staged):
    """The processes; an async context manager that starts and ends them.

    Args:
        config: The experiment.
        testbed: A host for each of `HOSTS`.
    """

    def __init__(self, config: Config, testbed: Testbed) -> None:
        super().__init__()
        self._config, self._testbed = config, testbed
        self._launched: list[LineProcess] = []
        self._parts: dict[str, LineProcess] = {}

    async def play(self, name: str) -> tuple[int, dict[str, dict[str, Any]]]:
        """Play one round and return its time 0 and everybody's report.

        Raises:
            ProcessFailedError: A process failed.
        """
        start_ns = time.time_ns() + round(_LEAD_S * 1e9)
        for part in self._parts.values():
            part.order(name=name, start_ns=start_ns, seconds=self._config.live_s)
        limit_s = _LEAD_S + self._config.live_s + _SLACK_S
        reports = await asyncio.gather(*(p.expect("played", timeout_s=limit_s) for p in self._parts.values()))
        return start_ns, dict(zip(self._parts, reports, strict=True))

    async def _start(self) -> None:
        self._stack.push_async_callback(self._close)
        started = await asyncio.gather(*(self._launch(role, host) for role, host in HOSTS.items()))
        self._parts = dict(zip(HOSTS, started, strict=True))
        for part in started:
            await part.expect("ready", timeout_s=_START_S)

    async def _close(self) -> None:
        await asyncio.gather(*(process.close() for process in self._launched))

    async def _launch(self, role: str, host: str) -> LineProcess:
        config = MocapWorkerConfig(
            role=role,
            ways={
                way: BusAddress(domain_id=domain, interface=self._testbed.interface(host))
                for way, domain in _DOMAINS.items()
            },
            seed=self._config.seed,
        )
        argv = self._testbed.argv(host, [sys.executable, "-m", _MODULE, argument_of(config)])
        process = await LineProcess.start(f"mocap, {role}", argv)
        self._launched.append(process)
        return process


def live_rows(
    name: str, config: Config, start_ns: int, reports: dict[str, dict[str, Any]]
) -> Iterator[tuple[str, Any]]:
    """Yield table and row for everything that a round reports.

    Args:
        name: The round.
        config: The experiment.
        start_ns: The round's time 0.
        reports: Of every role.
    """
    heard, bridge = reports["listener"], reports["bridge"]
    for numbers in heard["looks"]:
        yield "look", MocapLookRow(round=name, **dict(zip(_FIELDS, numbers, strict=True)))
    for way, outcomes in heard["tries"].items():
        for outcome, count in outcomes.items():
            yield "try", TryRow(round=name, way=way, outcome=outcome, count=count)
    names: dict[str, str] = {}
    for edge in heard["edges"]:
        authority = names.setdefault(edge["authority"], f"publisher {len(names)}")
        yield "edge", MocapEdgeRow(where=name, **{**edge, "authority": authority})
    yield from (("heard", row) for row in _times(name, start_ns, bridge["receipts"], heard["heard"]))
    yield from (("spell", row) for row in _spells(name, config))


def live_tree(start_ns: int, reports: dict[str, dict[str, Any]]) -> Iterator[tuple[str, Any, int]]:
    """Yield topic, message and time for the bridge's tree as it was heard, thinned.

    Args:
        start_ns: The round's time 0, for what holds at all times.
        reports: Of every role.
    """
    tree = reports["listener"]["tree"]
    for topic, kept in ((TF_STATIC, tree["still"]), (TF, tree["moving"])):
        for received_ns, parent, child, stamp_ns, position, quat in kept:
            pose = Pose.at(position, quat)
            value = StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose)
            yield topic, message_type(TRANSFORMS)(transforms=[value.to_msg()]), received_ns or start_ns


def _times(
    name: str, start_ns: int, receipts: list[tuple[int, int]], heard: list[tuple[int, int, int]]
) -> Iterator[MocapHeardRow]:
    received = dict(receipts)
    every = max(1, -(-len(heard) // _MOST_HEARD))
    for capture_ns, published_ns, heard_ns in heard[::every]:
        yield MocapHeardRow(
            round=name,
            at_s=(capture_ns - start_ns) / 1e9,
            receipt_ms=(received[capture_ns] - capture_ns) / 1e6,
            publication_ms=(published_ns - capture_ns) / 1e6,
            heard_ms=(heard_ns - capture_ns) / 1e6,
        )


def _spells(name: str, config: Config) -> Iterator[SpellRow]:
    """Yield when the cameras of a round were wrong, from the captures that its seed gives."""
    rng = np.random.default_rng(config.seed)
    made = synthetic_captures({OBJECT: MOTION}, ROUNDS[name], rng, duration_s=config.live_s + TAIL_S)
    last = -1
    for kind, group in groupby(made, key=_kind):
        times = [m.capture for m in group]
        for capture in times:
            number = capture.number or 0
            if number > last + 1 and last >= 0:
                yield SpellRow(
                    round=name,
                    kind="dropped",
                    begin_s=(last + 1) / ROUNDS[name].rate_hz,
                    end_s=(number - 1) / ROUNDS[name].rate_hz,
                )
            last = number
        if kind != "seen":
            yield SpellRow(
                round=name, kind=kind, begin_s=times[0].capture_ns / 1e9, end_s=times[-1].capture_ns / 1e9
            )


def _kind(made: TrueCapture) -> str:
    if made.flipped:
        return "flipped"
    return "occluded" if made.capture.sights[OBJECT] is Lapse.OCCLUDED else "seen"
