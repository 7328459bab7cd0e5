"""Services over ROS 2's own middleware: endpoints of servers and clients, and the program behind them.

rmw_fastrtps correlates requests and replies by RTPS sample identities, which Cyclone DDS neither sets nor
shows. `program` therefore sends and receives them in ROS 2's own interpreter. It is one more transport for
the frames of `sfglab.messages.frame_service`.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from sfglab.bus.api import FAST_DDS, RawEndpoint
from sfglab.bus.errors import PublishError
from sfglab.bus.loop import Signal
from sfglab.messages import ServiceFrame, frame_service, unframe_service
from sfglab.names import ros_name_from_dds
from sfglab.processes import LineProcess

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.endpoints import Inbox
    from sfglab.bus.loop import CallbackRunner
    from sfglab.component import Report

#: Environment variable that names ROS 2's interpreter; if unset, that of a sourced ROS 2 is used.
PYTHON_VARIABLE = "SFGLAB_ROS_PYTHON"
_NO_ROS = f"there is none here: source it, or name its interpreter in {PYTHON_VARIABLE}"
_NAME = "ROS 2's services"
_PROGRAM = Path(__file__).with_name("program.py")
_LINE_LIMIT_BYTES = 40 * 2**20  # above the program's limit of a message in hexadecimal digits
_PAUSE_S = 0.5
_PATIENCE_S = 5.0
_PARTICIPANT = bytes.fromhex("000001c1")  # entity id of a participant (RTPS 2.5, clause 9.3.1.3)
# Variables of this process, or of a sourced ROS 2, that would mislead the interpreter of another ROS 2.
_FOREIGN = ("PYTHONPATH", "LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE")


def sourced_python() -> str:
    """Return the interpreter of the ROS 2 that is sourced in this environment; empty if there is none."""
    return "/usr/bin/python3" if os.environ.get("AMENT_PREFIX_PATH") else ""


def ros_python() -> str:
    """Return ROS 2's interpreter: the named one, or that of a sourced ROS 2; empty if there is none."""
    return os.environ.get(PYTHON_VARIABLE) or sourced_python()


def ros_command(python: str, *arguments: str, **environment: object) -> list[str]:
    """Return the command line that runs a script in ROS 2's interpreter with additional variables."""
    foreign = [] if python == sourced_python() else [f"--unset={name}" for name in _FOREIGN]
    values = {"PYTHONSAFEPATH": 1, **environment}
    return [
        "env",
        *foreign,
        *(f"{name}={value}" for name, value in values.items()),
        python,
        *arguments,
    ]


def ros_gid(dds_topic: str) -> bytes:
    """Return one 16-byte GID for all writers of a request or reply topic: rclpy does not tell them apart."""
    service = service_of(dds_topic)
    return (
        FAST_DDS
        + hashlib.blake2b(service.encode(), digest_size=12).digest()
        + dds_topic[:2].encode()
    )


def service_of(dds_topic: str) -> str:
    """Return the name of the service to which a topic belongs."""
    wire = ros_name_from_dds(dds_topic)
    return dds_topic if wire is None else wire.name


class RosHalf:
    """Request or reply endpoint of a server or client; a reader has an inbox."""

    lost = 0

    def __init__(
        self,
        services: RosServices,
        endpoint: RawEndpoint,
        notify: Callable[[], None],
        inbox: Inbox | None,
    ) -> None:
        self.gid = ros_gid(endpoint.dds_topic)
        self.matched = 0  #: 1 if a call can be made or answered, otherwise 0.
        self.notify, self.inbox = notify, inbox
        self._services = services
        role = "server" if endpoint.dds_topic.startswith("rq/") == (inbox is not None) else "client"
        name, service = service_of(endpoint.dds_topic), endpoint.type.rpartition("_")[0]
        self.key = f"{role} {name}"  #: Name of the server or client in the program.
        #: Order that opens it.
        self.order = {"key": self.key, "role": role, "name": name, "service": service}

    @property
    def matched_prefixes(self) -> frozenset[bytes]:
        """GUID prefix that stands for all peers; empty while there are none."""
        return frozenset({self.gid[:12]} if self.matched else ())

    def write(self, cdr: Any, source_timestamp_ns: int | None = None) -> None:
        """Send the frame of a request or reply; rclpy sets the time stamp.

        Raises:
            PublishError: The program does not keep up.
        """
        del source_timestamp_ns
        self._services.write(self.key, unframe_service(bytes(cdr)))

    def write_message(self, message: Any) -> NoReturn:
        """Refuse a message, because this endpoint sends only frames.

        Raises:
            TypeError: Always.
        """
        raise TypeError(f"{self.key}: given {message!r}, allowed: frames")

    def close(self) -> None:
        """Close the endpoint; the last one of a server or client closes that as well."""
        self._services.close(self)


class RosServices:
    """Access of one node to the services of rmw_fastrtps, through a helper program that runs rclpy.

    Args:
        calls: Function that returns the runner for the callbacks of a named endpoint.
        domain_id: DDS domain of the node; None: the node is in no such domain.
        interface: Network interface; None for any.
    """

    def __init__(
        self,
        calls: Callable[[str], CallbackRunner],
        domain_id: int | None = None,
        interface: str | None = None,
    ) -> None:
        python = ros_python()
        #: Reason why no service can be reached; empty if none is known.
        self.why = "" if python and domain_id is not None else _NO_ROS
        #: 16-byte GUIDs of all participants that the program had.
        self.participants: set[bytes] = set()
        self._calls = calls
        self._argv = _argv(python, domain_id, interface)
        self._halves: list[RosHalf] = []
        self._opened: set[str] = set()  # servers and clients that the program has or has to open
        self._askers: dict[str, dict[object, Callable[[str], None]]] = {}
        self._unknown: set[str] = set()
        self._changed = Signal(asyncio.get_running_loop())
        self._process: LineProcess | None = None
        self._serves = False
        self._running: asyncio.Task[Any] | None = None

    def find(self, half: str, asker: object, on_answer: Callable[[str], None]) -> None:
        """Call `on_answer` with the reason why a type of request or reply cannot be served, empty if it can.

        The answer comes at once, or once the program runs. Until then a new question of the same asker about
        the same service replaces its former one.
        """
        if self.why:
            on_answer(self.why)
            return
        service = half.rpartition("_")[0]
        self._askers.setdefault(service, {})[asker] = on_answer
        self._order(do="find", service=service)

    def when_settled(self, endpoint: RawEndpoint, act: Callable[[], None]) -> None:
        """Call `act` as soon as no client of rclpy can mistake a request reader over DDS for its own server.

        That is at once for any other endpoint, or if the program cannot serve the service. Otherwise it is when
        the program's server has matched, at the latest after 5 s.
        """
        misleads = endpoint.transport == "dds" and endpoint.dds_topic.startswith("rq/")
        if misleads and not self._is_settled(endpoint):
            self._calls(_NAME).spawn(self._act_when_settled(endpoint, act))
        else:
            act()

    async def _act_when_settled(self, endpoint: RawEndpoint, act: Callable[[], None]) -> None:
        await self._changed.wait_until(lambda: self._is_settled(endpoint), _PATIENCE_S)
        act()

    def _is_settled(self, endpoint: RawEndpoint) -> bool:
        unserved = (
            self.why or self._running is None or endpoint.type.rpartition("_")[0] in self._unknown
        )
        halves = self._halves_of(f"server {service_of(endpoint.dds_topic)}")
        return bool(unserved) or any(half.matched for half in halves)

    def open(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox | None
    ) -> RosHalf:
        """Open a reader, which needs an inbox, or a writer.

        The program opens a server or client once its request endpoint and its reply endpoint are open. Clients
        would discover and call a server without its reply endpoint, and the replies would be lost.
        """
        half = RosHalf(self, endpoint, notify, inbox)
        beside = self._halves_of(half.key)
        self._halves.append(half)
        if half.key in self._opened:
            half.matched = beside[0].matched
        elif len({one.inbox is None for one in (half, *beside)}) == 2:  # a reader and a writer
            self._opened.add(half.key)
            self._order(do="open", **half.order)
        self.start()
        return half

    def close(self, half: RosHalf) -> None:
        """Remove an endpoint; repeated calls are harmless."""
        if half in self._halves:
            self._halves.remove(half)
            if half.key in self._opened and not self._halves_of(half.key):
                self._opened.remove(half.key)
                self._order(do="close", key=half.key)

    def write(self, key: str, frame: ServiceFrame) -> None:
        """Send a frame; it is dropped while the server or client is not open.

        Raises:
            PublishError: The program does not keep up.
        """
        if key not in self._opened:
            return
        if self._process is not None and self._process.unsent_bytes > _LINE_LIMIT_BYTES:
            raise PublishError(key, code=-1, reason="ROS 2's program does not keep up")
        self._order(
            do="write", key=key, call=(frame.client_guid, frame.sequence), cdr=frame.cdr.hex()
        )

    def _halves_of(self, key: str) -> list[RosHalf]:
        return [half for half in self._halves if half.key == key]

    def _order(self, **values: Any) -> None:
        if self._process is not None and self._serves:
            self._process.order(**values)

    def start(self) -> None:
        """Start the program, unless it runs or cannot serve."""
        if self._running is None and not self.why:
            self._running = self._calls(_NAME).spawn(self._run())

    async def _run(self) -> None:
        """Keep the program running until the node ends or the program cannot serve."""
        while not self.why:
            self._process = await LineProcess.start(
                _NAME, self._argv, on_report=self._heard, limit_bytes=_LINE_LIMIT_BYTES
            )
            self._process.buffers_reports = False
            try:
                status = await self._process.wait()
            finally:
                await self._process.close()
            if not self._serves:
                self._refuse(f"its program ended with status {status} before it served")
            self._serves = False
            self._match(self._halves, ready=False)
            await asyncio.sleep(_PAUSE_S)

    def _heard(self, report: Report) -> None:
        match report:
            case {"is": "ready", "prefix": prefix}:
                self._serve(bytes.fromhex(prefix))
            case {"is": "failed", "why": why}:
                self._refuse(why)
            case {"is": "found", "service": service, "why": why}:
                for on_answer in self._askers.pop(service, {}).values():
                    on_answer(why)
                self._unknown |= {service} if why else set()
                self._changed.notify()
            case {"is": "matched", "key": key, "ready": ready}:
                self._match(self._halves_of(key), ready=ready)
            case {"is": "sample", "key": key, "call": [guid, number], "cdr": cdr}:
                self._push(key, frame_service(ServiceFrame(guid, number, bytes.fromhex(cdr))))

    def _serve(self, prefix: bytes) -> None:
        self._serves = True
        self.participants.add(prefix + _PARTICIPANT)
        orders = {half.key: half.order for half in self._halves if half.key in self._opened}
        for order in orders.values():
            self._order(do="open", **order)
        for service in self._askers:
            self._order(do="find", service=service)

    def _refuse(self, why: str) -> None:
        self.why = self.why or why
        while self._askers:
            for on_answer in self._askers.popitem()[1].values():
                on_answer(self.why)
        self._changed.notify()

    def _match(self, halves: list[RosHalf], *, ready: bool) -> None:
        for half in halves:
            half.matched = int(ready)
            half.notify()
        self._changed.notify()

    def _push(self, key: str, frame: bytes) -> None:
        now_ns = time.time_ns()
        for half in self._halves_of(key):
            if half.inbox is not None:
                half.inbox.push((frame, now_ns, now_ns, half.gid))


def _argv(python: str, domain_id: int | None, interface: str | None) -> list[str]:
    """Return the program's command line; on loopback, variables of the distribution keep it on this host."""
    values = {"ROS_DOMAIN_ID": domain_id, "RMW_IMPLEMENTATION": "rmw_fastrtps_cpp"}
    if interface == "lo":
        humble = os.environ.get("ROS_DISTRO") == "humble"
        values |= (
            {"ROS_LOCALHOST_ONLY": 1} if humble else {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        )
    return ros_command(python, str(_PROGRAM), **values)
