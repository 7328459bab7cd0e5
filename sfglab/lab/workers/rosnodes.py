"""The ROS 2 nodes of one agent, started at an order: ``python -m sfglab.lab.workers.rosnodes CONFIG``.

Stands for as many processes of demo_nodes_cpp, see `rosstack`; a Python process for each of them would measure
Python. Everything is loaded before ``ready`` is reported; the order ``{"do": "start"}`` creates the nodes. The
first node then polls its graph, as an operator would, and two lines tell when it is complete: ``resolved`` when
that node has seen every endpoint and the announcement of every node of the other agents, then ``settled`` when
every node has found every other process. Ends with its standard input, at once: nobody is left to be told.
"""

from __future__ import annotations

import ctypes as ct
import json
import os
import select
import sys
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.bus.dds import clib
from sfglab.bus.dds.domain import DomainConfig
from sfglab.component import claim_standard_output, config_from_argument
from sfglab.errors import SfglabError
from sfglab.lab.workers.rosstack import LISTENER, TALKER, EndpointPlan, RosStack, endpoints_of

if TYPE_CHECKING:
    from collections.abc import Callable

_POLL_S = 0.02
_BATCH = 256
# Stacks of one process need domain ids of their own, whatever domain they join on the network.
_FIRST_STACK_ID = 110
_ROS_TOPICS = (b"rt/", b"rq/", b"rr/", b"ros_discovery_info")


@dataclass(frozen=True, slots=True, kw_only=True)
class RosNodesConfig:
    """What the process is told."""

    namespace: str  #: Namespace of the nodes and of their topics.
    address: BusAddress  #: Where they stand.
    talkers: int = 10  #: Publishing nodes; the n-th talker and the n-th listener share a topic.
    listeners: int = 10  #: Subscribing nodes.
    peers: int = 0  #: How many other agents there are in the domain, each with as many nodes.

    def node_plans(self) -> list[tuple[str, tuple[EndpointPlan, ...]]]:
        """Return the name and the endpoints of every node."""
        names = [
            (role, f"{role}_{i}", f"{self.namespace}/chatter_{i}")
            for role, count in ((TALKER, self.talkers), (LISTENER, self.listeners))
            for i in range(count)
        ]
        return [
            (name, endpoints_of(role, f"{self.namespace}/{name}", topic))
            for role, name, topic in names
        ]


class _Poller:
    """What one node's graph shows of the other agents' nodes; `own` are GUID prefixes of its own agent's."""

    def __init__(self, stack: RosStack, own: frozenset[bytes]) -> None:
        lib = clib.library()
        kinds = (clib.BUILTIN_PUBLICATION, clib.BUILTIN_SUBSCRIPTION)
        self._readers = [
            lib.dds_create_reader(stack.participant, kind, None, None) for kind in kinds
        ]
        self._info_reader = stack.info_reader
        self._own = own
        self._pointers: Any = (ct.c_void_p * _BATCH)()
        self._infos: Any = (clib.SampleInfo * _BATCH)()
        self.endpoints: dict[int, bytes] = {}
        self._announced: set[int] = set()

    def poll(self) -> None:
        """Read what has changed."""
        for reader in self._readers:
            self._poll_endpoints(reader)
        self._poll_announcements()

    @property
    def participants(self) -> int:
        """Processes of the other agents of which at least one endpoint is known."""
        return len(set(self.endpoints.values()))

    @property
    def announcements(self) -> int:
        """Processes, its own agent's included, whose nodes are announced."""
        return len(self._announced)

    def _poll_endpoints(self, reader: int) -> None:
        lib = clib.library()
        while True:
            self._pointers[0] = None
            count = lib.dds_take(reader, self._pointers, self._infos, _BATCH, _BATCH)
            if count <= 0:
                return
            for i in range(count):
                self._note(self._infos[i], self._pointers[i])
            lib.dds_return_loan(reader, self._pointers, count)

    def _note(self, info: Any, pointer: int) -> None:
        if not info.valid_data or info.instance_state != clib.ALIVE:
            self.endpoints.pop(info.instance_handle, None)
            return
        sample = clib.Endpoint.from_address(pointer)
        prefix = bytes(sample.participant_key)[:12]
        if prefix not in self._own and sample.topic_name.startswith(_ROS_TOPICS):
            self.endpoints[info.instance_handle] = prefix

    def _poll_announcements(self) -> None:
        lib, into = clib.library(), (self._pointers, _BATCH, self._infos)
        while (count := lib.dds_takecdr(self._info_reader, *into, clib.ANY_STATE)) > 0:
            for i in range(count):
                if self._infos[i].valid_data:
                    self._announced.add(self._infos[i].publication_handle)
                lib.ddsi_serdata_unref(self._pointers[i])


class _RosNodes:
    """The nodes of one agent."""

    def __init__(self, config: RosNodesConfig, report: Callable[[dict[str, Any]], None]) -> None:
        self._report = report
        self._config = config
        self._plans = config.node_plans()
        self._everybody = len(self._plans) * (1 + config.peers)
        self._expected = config.peers * sum(len(endpoints) for _, endpoints in self._plans)
        self._stacks: list[RosStack] = []
        self._poller: _Poller
        self._waiting: deque[tuple[str, Callable[[], bool]]] = deque()

    @property
    def complete(self) -> bool:
        """Whether everything there is to report was reported."""
        return not self._waiting

    def start(self) -> None:
        """Create all nodes."""
        config = self._config
        self._say("started")
        for number, (name, endpoints) in enumerate(self._plans):
            stack = {
                "domain_id": _FIRST_STACK_ID + number,
                "external_domain_id": config.address.domain_id,
            }
            domain = DomainConfig(**config.address.options() | stack)
            self._stacks.append(RosStack(domain, config.namespace, name, endpoints))
        self._poller = _Poller(self._stacks[0], frozenset(stack.prefix for stack in self._stacks))
        self._waiting.extend((("resolved", self._is_resolved), ("settled", self._is_settled)))
        self._say("running")

    def poll(self) -> None:
        """Look at the graph once and report what has become complete."""
        self._poller.poll()
        while self._waiting and self._waiting[0][1]():
            kind, _ = self._waiting.popleft()
            self._say(kind)

    def look(self) -> None:
        """Report what is known now."""
        self._poller.poll()
        self._say("seen")

    def _is_resolved(self) -> bool:
        poller = self._poller
        return len(poller.endpoints) >= self._expected and poller.announcements >= self._everybody

    def _is_settled(self) -> bool:
        return all(stack.known_nodes() >= self._everybody for stack in self._stacks)

    def _say(self, kind: str) -> None:
        known = self._counts() if hasattr(self, "_poller") else {}
        self._report(
            {"is": kind, "t_ns": time.time_ns(), "cpu_ns": time.process_time_ns(), **known}
        )

    def _counts(self) -> dict[str, int]:
        poller = self._poller
        return {
            "endpoints": len(poller.endpoints),
            "participants": poller.participants,
            "announcements": poller.announcements,
            "expected": self._expected,
        }


def _orders(timeout_s: float | None, rest: bytearray) -> list[dict[str, Any]] | None:
    """Return the orders that arrive in time, None when there will be no more."""
    if not select.select([0], [], [], timeout_s)[0]:
        return []
    data = os.read(0, 65536)
    if not data:
        return None
    rest += data
    *lines, last = bytes(rest).split(b"\n")
    rest[:] = last
    return [json.loads(line) for line in lines]


def _serve(nodes: _RosNodes) -> None:
    rest = bytearray()
    running = False
    while (
        orders := _orders(_POLL_S if running and not nodes.complete else None, rest)
    ) is not None:
        for order in orders:
            if order["do"] == "start":
                nodes.start()
                running = True
            else:
                nodes.look()
        if running:
            nodes.poll()


def main() -> None:
    """Run the nodes with the configuration given as the one argument."""
    report = claim_standard_output()
    try:
        clib.library()
        nodes = _RosNodes(config_from_argument(RosNodesConfig, sys.argv[1]), report)
        report({"is": "ready"})
        _serve(nodes)
    except SfglabError as error:
        report({"is": "failed", "why": str(error)})
        os._exit(1)
    os._exit(
        0
    )  # leaving the domain in order would take as long as finding it, and everybody ends together


if __name__ == "__main__":
    main()
