"""Program that serves and calls services of ROS 2's default middleware: ``python program.py``.

The program runs in ROS 2's own interpreter, from Python 3.10 on, with the standard library and rclpy alone.
Orders are JSON lines that name a method of `_Program` as ``do``; reports are JSON lines. Requests and responses
are CDR in hexadecimal digits, with two numbers that identify the call. If there are too many calls, the oldest
are forgotten.
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
os.dup2(2, 1)  # stdout carries reports, so output of libraries goes to stderr
_LOCK = threading.RLock()  # orders arrive in one thread, samples of ROS 2 in another


def report(kind: str, **values: Any) -> None:
    """Write a report; a slow reader of the reports slows the program down."""
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
_FAST_DDS = b"\x01\x0f"  # vendor id: the first bytes of its GUIDs (RTPS 2.5, clause 9.3.1.5)
_OF_ACTIONS = {"_SendGoal": "SendGoalService", "_GetResult": "GetResultService"}


def interface(name: str) -> Any:
    """Return the class of a service; those of an action have names such as ``package/action/Name_SendGoal``."""
    package, kind, title = name.split("/")
    module = importlib.import_module(f"{package}.{kind}")
    action, mark, ending = title.rpartition("_")
    service = _OF_ACTIONS.get(mark + ending) if kind == "action" else None
    found = getattr(getattr(module, action).Impl, service) if service else getattr(module, title)
    check_for_type_support(found)
    return found


def _asked_by_fast_dds(header: Any) -> bool:
    """Return whether a request is from a client of Fast DDS; a Cyclone client's has another frame.

    rclpy shows only the sequence number of `rmw_service_info_t`: int64 source and reception time, 16 bytes of
    GUID, int64 number (rmw/types.h). A pybind11 instance has a pointer to it right behind the object header. An
    unknown layout counts as Fast DDS.
    """
    where = ctypes.c_void_p.from_address(id(header) + object.__basicsize__).value
    info = ctypes.string_at(where, 40) if where else bytes(40)
    known = int.from_bytes(info[32:], sys.byteorder) == header.request_id.sequence_number
    return not known or info[16:18] == _FAST_DDS


def report_sample(key: str, call: Any, message: Any) -> None:
    """Report a request or a response, in CDR, to the process that started the program.

    Raises:
        ValueError: The CDR is larger than a report may be.
    """
    cdr = serialize_message(message)
    if len(cdr) > _MAX_MESSAGE_BYTES:
        raise ValueError(f"{key}: given {len(cdr)} bytes, allowed: {_MAX_MESSAGE_BYTES}")
    report("sample", key=key, call=call, cdr=cdr.hex())


def keep(calls: dict[Any, Any], call: Any, value: Any) -> Any:
    """Store the value of a call; if there are too many, remove the oldest call and return its value."""
    with _LOCK:
        calls[call] = value
        return calls.pop(next(iter(calls))) if len(calls) > _MAX_CALLS else None


class _Server:
    """Server of a service; the reader of the reports sends the responses."""

    def __init__(self, node: Any, key: str, kind: Any, name: str) -> None:
        self._key, self._kind = key, kind
        self._calls: dict[Any, Any] = {}
        self._guid, self._numbers = secrets.randbits(64), itertools.count()
        self._entity = node.create_service(kind, name, lambda request, _: request, qos_profile=_QOS)
        self._respond = self._entity.send_response
        # The executor passes the callback's result to `send_response`. Here that is the request, which `_ask`
        # reports; the response is sent later.
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
        if header is not None:  # otherwise the call belongs to another server
            self._respond(deserialize_message(cdr, self._kind.Response), header)


class _Client:
    """Client of a service; a request waits up to 5 s for a server."""

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
    """Node of the program with its open servers and clients; the public methods are the orders."""

    def __init__(self) -> None:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        name = f"_sfglab_services_{os.getpid()}"
        self._node = rclpy.create_node(name, enable_rosout=False, start_parameter_services=False)
        self._open: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._spin)
        self._thread.start()
        # rclpy shows the GUIDs of topic endpoints only, so this publisher gives the participant's prefix.
        ends = self._node.get_publishers_info_by_topic("/parameter_events")
        (gid,) = (bytes(end.endpoint_gid) for end in ends if end.node_name == name)
        report("ready", prefix=gid[:12].hex())

    def find(self, service: str) -> None:
        why = ""
        try:
            interface(service)
        except Exception as error:  # noqa: BLE001 - any exception of the import is the reason
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
        rclpy.shutdown()  # in order, because a killed participant leaves its shared memory behind
        self._thread.join()
        self._node.destroy_node()

    def _spin(self) -> None:
        executor = SingleThreadedExecutor()
        executor.add_node(self._node)
        while rclpy.ok():
            unless_it_fails(executor.spin)


def unless_it_fails(act: Callable[[], Any]) -> None:
    """Call a function; the failure of one order or request is printed and does not stop the others."""
    try:
        act()
    except ExternalShutdownException:
        pass
    except Exception as error:  # noqa: BLE001 - printed
        sys.stderr.write(f"ROS 2's services: {type(error).__name__}: {error}\n")


signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent process decides when this one ends
_program = _Program()
try:
    for _line in sys.stdin:
        _order = json.loads(_line)
        unless_it_fails(partial(getattr(_program, _order.pop("do")), **_order))
finally:
    _program.end()
