"""Program that serves and calls services of ROS 2's default middleware: ``python program.py``.

Runs in ROS 2's own interpreter, from Python 3.10 on, with the standard library and rclpy alone. Orders are JSON
lines that name a method of `Program` as ``do``; reports are JSON lines. Requests and responses are CDR in
hexadecimal digits, with two numbers that say which call it is. The oldest of too many calls are forgotten.
"""

from __future__ import annotations

import ctypes
import importlib
import itertools
import json
import os
import secrets
import signal
import sys
import threading
import time
from functools import partial
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable

_OUT = os.fdopen(os.dup(1), "w", buffering=1)
os.dup2(2, 1)  # what libraries print is no report
_LOCK = threading.RLock()  # orders come in one thread, what ROS 2 brings in another


def report(kind: str, **values: Any) -> None:
    """Write a report; its reader's pace is ours."""
    with _LOCK:
        _OUT.write(json.dumps({"is": kind, **values}) + "\n")


try:
    import rclpy
    from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
    from rclpy.qos import QoSProfile
    from rclpy.serialization import deserialize_message, serialize_message
    from rclpy.signals import SignalHandlerOptions
    from rclpy.type_support import check_for_type_support
except ImportError as error:
    report("failed", why=f"{sys.executable} has no rclpy ({error})")
    sys.exit(1)

_MAX_CALLS = 4096
_MAX_MESSAGE_BYTES = 16 * 2**20
_PATIENCE_S = 5.0
_LOOK_S = 0.05
_QOS = QoSProfile(depth=1000)
_FAST_DDS = b"\x01\x0f"  # the vendor's id begins its GUIDs (RTPS 2.5, clause 9.3.1.5)
_OF_ACTIONS = {"_SendGoal": "SendGoalService", "_GetResult": "GetResultService"}


def interface(name: str) -> Any:
    """Return the class of a service; an action's are called ``package/action/Name_SendGoal`` and so on."""
    package, kind, title = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    action, mark, ending = title.rpartition("_")
    service = _OF_ACTIONS.get(mark + ending) if kind == "action" else None
    found = getattr(getattr(module, action).Impl, service) if service else getattr(module, title)
    check_for_type_support(found)
    return found


def _asked_by_fast_dds(header: Any) -> bool:
    """Whether a request names a client of Fast DDS; a Cyclone client's is framed otherwise and makes no sense.

    rclpy shows only the number of `rmw_service_info_t`: int64 source and reception time, 16 bytes of GUID,
    int64 number (rmw/types.h). A pybind11 instance points to it right behind the object's head.
    """
    where = ctypes.c_void_p.from_address(id(header) + object.__basicsize__).value
    info = ctypes.string_at(where, 40) if where else bytes(40)
    known = int.from_bytes(info[32:], sys.byteorder) == header.request_id.sequence_number
    return not known or info[16:18] == _FAST_DDS


def report_sample(key: str, call: Any, message: Any) -> None:
    """Report a request or a response."""
    cdr = serialize_message(message)
    if len(cdr) > _MAX_MESSAGE_BYTES:
        raise ValueError(f"{key}: given {len(cdr)} bytes, allowed are {_MAX_MESSAGE_BYTES}")
    report("sample", key=key, call=call, cdr=cdr.hex())


def keep(calls: dict[Any, Any], call: Any, value: Any) -> Any:
    """Add what is known of a call; return that of the oldest one, now forgotten, if there are too many."""
    with _LOCK:
        calls[call] = value
        return calls.pop(next(iter(calls))) if len(calls) > _MAX_CALLS else None


class _Server:
    """A service's server, whose requests are answered by whoever reads the reports."""

    def __init__(self, node: Any, key: str, kind: Any, name: str) -> None:
        self._key, self._kind = key, kind
        self._calls: dict[Any, Any] = {}
        self._guid, self._numbers = secrets.randbits(64), itertools.count()
        self._entity = node.create_service(kind, name, lambda request, _: request, qos_profile=_QOS)
        self._respond = self._entity.send_response
        # The executor sends what the callback returns; ours is the request, and what is sent comes later.
        self._entity.send_response = self._ask
        self.destroy = partial(node.destroy_service, self._entity)
        report("matched", key=key, ready=True)

    def _ask(self, request: Any, header: Any) -> None:
        if _asked_by_fast_dds(header):
            call = self._guid, next(self._numbers)
            keep(self._calls, call, header)
            report_sample(self._key, call, request)

    def write(self, call: Any, cdr: bytes) -> None:
        header = self._calls.pop(call, None)
        if header is not None:  # else it is another's
            self._respond(deserialize_message(cdr, self._kind.Response), header)


class _Client:
    """A service's client; a request waits a little for a server."""

    def __init__(self, node: Any, key: str, kind: Any, name: str) -> None:
        self._key, self._kind, self._ready = key, kind, False
        self._calls: dict[Any, Any] = {}
        self._waiting: dict[Any, Any] = {}
        self._entity = node.create_client(kind, name, qos_profile=_QOS)
        timer = node.create_timer(_LOOK_S, self._look)
        self.destroy = lambda: node.destroy_timer(timer) and node.destroy_client(self._entity)

    def write(self, call: Any, cdr: bytes) -> None:
        request = deserialize_message(cdr, self._kind.Request)
        keep(self._waiting, call, (time.monotonic() + _PATIENCE_S, request))
        self._look()

    def _look(self) -> None:
        with _LOCK:
            ready = self._entity.service_is_ready()
            if ready != self._ready:
                self._ready = ready
                report("matched", key=self._key, ready=ready)
            for call, (deadline_s, request) in list(self._waiting.items()):
                if ready or time.monotonic() > deadline_s:
                    del self._waiting[call]
                if ready:
                    self._send(call, request)

    def _send(self, call: Any, request: Any) -> None:
        future = self._entity.call_async(request)
        if (oldest := keep(self._calls, call, future)) is not None:
            self._entity.remove_pending_request(oldest)
        future.add_done_callback(partial(self._answered, call))

    def _answered(self, call: Any, future: Any) -> None:
        self._calls.pop(call, None)
        report_sample(self._key, call, future.result())


class _Program:
    """The node and what is open; its public methods are the orders."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        name = f"_sfglab_services_{os.getpid()}"
        self._node = rclpy.create_node(name, enable_rosout=False, start_parameter_services=False)
        self._open: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()
        # Of all that the node has, only topics' endpoints tell where they are in DDS.
        ends = self._node.get_publishers_info_by_topic("/parameter_events")
        (gid,) = (bytes(end.endpoint_gid) for end in ends if end.node_name == name)
        report("ready", prefix=gid[:12].hex())

    def find(self, service: str) -> None:
        why = ""
        try:
            interface(service)
        except Exception as error:  # noqa: BLE001 - whatever an import raises is the reason
            why = f"it does not know {service} ({error})"
        report("found", service=service, why=why)

    def open(self, key: str, role: str, name: str, service: str) -> None:
        made: Any = {"server": _Server, "client": _Client}[role]
        self._open[key] = made(self._node, key, interface(service), name)

    def close(self, key: str) -> None:
        self._open.pop(key).destroy()

    def write(self, key: str, call: list[int], cdr: str) -> None:
        self._open[key].write(tuple(call), bytes.fromhex(cdr))

    def end(self) -> None:
        rclpy.shutdown()  # in order: a participant that is killed leaves its shared memory behind
        self._thread.join()
        self._node.destroy_node()

    def _spin(self) -> None:
        executor = SingleThreadedExecutor()
        executor.add_node(self._node)
        while rclpy.ok():
            unless_it_fails(executor.spin)


def unless_it_fails(act: Callable[[], Any]) -> None:
    """Act; what is wrong with one order or request is said, and must not end the others."""
    try:
        act()
    except ExternalShutdownException:
        pass
    except Exception as error:  # noqa: BLE001 - said
        sys.stderr.write(f"ROS 2's services: {type(error).__name__}: {error}\n")


signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it decides when it ends
_program = _Program()
try:
    for _line in sys.stdin:
        _order = json.loads(_line)
        unless_it_fails(partial(getattr(_program, _order.pop("do")), **_order))
finally:
    _program.end()
