"""DDS domains that this process has joined, each once, and the participants of its nodes with their threads.

Cyclone allows one configuration per domain and process; a second, different one raises an error here.
"""

from __future__ import annotations

import ctypes as ct
import os
import re
import socket
import threading
from collections import deque
from dataclasses import dataclass, field
from functools import partial
from html import escape
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from sfglab.bus.dds.clib import (
    ANY_STATE,
    INFINITY_NS,
    EndpointOptions,
    endpoint_qos,
    entity_guid,
    error_text,
    library,
    qos_object,
)
from sfglab.bus.errors import BusError, DomainError
from sfglab.bus.loop import JOIN_S, call_logged
from sfglab.domains import MAX_DOMAIN

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.qos import QoSProfile

Multicast = Literal["default", "spdp", "true", "false"]

_MAX_INDEX = "<MaxAutoParticipantIndex>99</MaxAutoParticipantIndex>"
"""Highest participant index: without multicast a hundred processes of a domain discover each other per host."""
# Fast DDS from version 3 on announces type information that Cyclone DDS cannot read. Cyclone ignores it, so
# that its endpoints match by name; 1.15 is eProsima's vendor id. Without the hash of the key Fast DDS does
# not notice that an endpoint of this process has ended. With an adaptive limit of unacknowledged samples, a
# service stopped responding after 144 of its clients had been killed. With a fixed limit it still responded
# after 264.
_COMPATIBILITY = (
    "<Compatibility><IgnoreTypeInformation>1.15</IgnoreTypeInformation></Compatibility>"
    "<Internal><GenerateKeyhash>true</GenerateKeyhash><Watermarks><WhcAdaptive>false</WhcAdaptive></Watermarks>{}"
    "</Internal>"
)
_INTERFACE_ELEMENTS = ("Interfaces", "NetworkInterfaceAddress")
_PIECE_END = re.compile(r"(?<=>)\s*,\s*(?=<|file:|/)")
# Loopback carries 64 KiB datagrams whole. Measured against 1344-byte fragments, they halve the latency of a
# 691 kB image. Real links keep Cyclone's default, which fits an Ethernet frame.
_LOOPBACK_SIZES = "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>64000B</FragmentSize>"
# Three such datagrams fill the default socket buffer of Fast DDS's readers; more of the smaller ones are read
# in time. Measured at 30 reliable images of 921 kB per second: 150 of 150 arrive, and 138 to 148 with large
# ones.
_LOOPBACK_SIZES_BESIDE_FAST_DDS = (
    "<MaxMessageSize>14720B</MaxMessageSize><FragmentSize>14000B</FragmentSize>"
)


class DomainOptions(TypedDict, total=False):
    """Keyword arguments of a node that configure its DDS domain; see `DomainConfig`."""

    interface: str | None
    multicast: Multicast
    lease_s: float
    external_domain_id: int | None
    max_sample_bytes: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DomainConfig:
    """Configuration of one process in one DDS domain; all its nodes of that domain share it.

    Raises:
        DomainError: A domain id is not in 0 to 232, or the lease is shorter than 0.1 s.
    """

    domain_id: int = 0  #: DDS domain, 0 to 232.
    #: Network interface, such as "lo" or "eth0"; None lets Cyclone choose.
    interface: str | None = None
    #: Cyclone's AllowMulticast: "spdp" uses multicast only to discover participants. "false" never uses it and
    #: discovers participants on this host only.
    multicast: Multicast = "default"
    #: Lease, s, at least 0.1: other participants remove those of this process after this silence.
    lease_s: float = 10.0
    #: Domain that is joined on the network, 0 to 232; None for `domain_id`. Cyclone keeps one set of sockets
    #: and threads for each `domain_id`. Several of them with one external id therefore appear to others as
    #: many processes in one domain.
    external_domain_id: int | None = None
    #: Largest message that is sent or received, bytes; larger ones are dropped. None for 2 GiB. The first of a
    #: process's nodes in the domain decides.
    max_sample_bytes: int | None = field(default=None, compare=False)

    @property
    def wire_id(self) -> int:
        """Id of the domain on the network, which determines its UDP ports."""
        return self.domain_id if self.external_domain_id is None else self.external_domain_id

    def __post_init__(self) -> None:
        for domain_id in (self.domain_id, self.wire_id):
            if not 0 <= domain_id <= MAX_DOMAIN:
                why = "allowed ids are 0 to 232, because higher ids have no UDP ports"
                raise DomainError(domain_id, why)
        if not self.lease_s >= 0.1:
            raise DomainError(
                self.domain_id, f"lease_s: given {self.lease_s}, allowed: at least 0.1"
            )


def check_interface(config: DomainConfig) -> None:
    """Check that this host has the configured interface.

    Raises:
        DomainError: The interface does not exist; the message names those that exist.
    """
    here = sorted(name for _, name in socket.if_nameindex())
    if config.interface is not None and config.interface not in here:
        why = f"there is no network interface {config.interface!r} here; allowed: {', '.join(here)}"
        raise DomainError(config.domain_id, why)


def domain_xml(config: DomainConfig) -> str:
    """Return Cyclone's configuration for a domain; it follows CYCLONEDDS_URI, if set, and overrides it.

    Without a configured interface, ROS 2's ROS_LOCALHOST_ONLY and ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
    restrict the domain to loopback, and OFF restricts it to this process. ROS_STATIC_PEERS are added as
    peers.

    Raises:
        DomainError: CYCLONEDDS_URI cannot be read, and an interface is configured.
    """
    interface = config.interface or ("lo" if _stays_on_this_host() else None)
    size = config.max_sample_bytes
    bound = "" if size is None else f"<MaxSampleSize>{size}B</MaxSampleSize>"
    parts = _general(config, interface), _discovery(config, interface), _COMPATIBILITY.format(bound)
    own = f'<CycloneDDS><Domain Id="any">{"".join(parts)}</Domain></CycloneDDS>'
    environment = os.environ.get("CYCLONEDDS_URI", "")
    if environment and interface:
        environment = without_interfaces(environment, config.domain_id)
    return f"{environment},{own}" if environment else own


def _stays_on_this_host() -> bool:
    values = map(os.environ.get, ("ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"))
    return any(value in {"1", "LOCALHOST", "OFF"} for value in values)


def _beside_fast_dds() -> bool:
    """Return whether the environment is that of ROS 2 with its default middleware."""
    return bool(os.environ.get("ROS_DISTRO")) and "fastrtps" in os.environ.get(
        "RMW_IMPLEMENTATION", "fastrtps"
    )


def _general(config: DomainConfig, interface: str | None) -> str:
    parts = [f"<AllowMulticast>{config.multicast}</AllowMulticast>"]
    if interface is not None:
        parts.insert(0, f'<Interfaces><NetworkInterface name="{escape(interface)}"/></Interfaces>')
    if interface == "lo":
        parts.append(_LOOPBACK_SIZES_BESIDE_FAST_DDS if _beside_fast_dds() else _LOOPBACK_SIZES)
    return f"<General>{''.join(parts)}</General>"


def _discovery(config: DomainConfig, interface: str | None) -> str:
    peers = [peer for peer in os.environ.get("ROS_STATIC_PEERS", "").split(";") if peer]
    # The id is written even if it is the default, so that CYCLONEDDS_URI cannot join separate domains.
    parts = [f"<LeaseDuration>{round(config.lease_s * 1e3)}ms</LeaseDuration>"]
    parts.append(f"<ExternalDomainId>{config.wire_id}</ExternalDomainId>")
    if config.multicast == "false" or interface == "lo":
        # Linux's lo has no multicast by default, and Fast DDS uses none with LOCALHOST.
        parts.append(f"<ParticipantIndex>auto</ParticipantIndex>{_MAX_INDEX}")
        peers.append("localhost")
    if config.interface is None and os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "OFF":
        parts.append(f"<Tag>off-{os.getpid()}</Tag>")  # participants with another tag are ignored
    named = "".join(f'<Peer Address="{escape(peer)}"/>' for peer in peers)
    parts.append(f"<Peers>{named}</Peers>" if peers else "")
    return f"<Discovery>{''.join(parts)}</Discovery>"


def without_interfaces(uri: str, domain_id: int) -> str:
    """Return a CYCLONEDDS_URI as XML without its interfaces, which Cyclone DDS would use beside ours.

    Raises:
        DomainError: A file or a piece of XML in it cannot be read.
    """
    from xml.dom.minidom import parseString
    from xml.parsers.expat import ExpatError

    kept = []
    try:
        for document in _documents(uri):
            root: Any = parseString(document).documentElement  # noqa: S318 - the user's own environment
            for element in [
                e for e in root.getElementsByTagName("*") if e.tagName in _INTERFACE_ELEMENTS
            ]:
                element.parentNode.removeChild(element)
            kept.append(root.toxml())
    except (OSError, ExpatError) as error:
        raise DomainError(
            domain_id,
            f"CYCLONEDDS_URI: given {uri!r}, which cannot be read ({error}); correct or unset it",
        ) from error
    return ",".join(kept)


def _documents(uri: str) -> Iterator[str]:
    """Yield the XML of a comma-separated list of files and pieces of XML."""
    while uri := uri.strip(", "):
        if uri.startswith("<"):
            end = _PIECE_END.search(uri)
            yield uri[: end.start()] if end else uri
            uri = uri[end.end() :] if end else ""
        else:
            file, _, uri = uri.partition(",")
            yield Path(file.removeprefix("file://")).read_text("utf-8")


@dataclass(slots=True)
class _Joined:
    config: DomainConfig
    handle: int
    users: int = 0


_joined: dict[int, _Joined] = {}
_lock = threading.Lock()


def join(config: DomainConfig) -> None:
    """Join a domain, or count one more user of it.

    Raises:
        DomainError: This process uses another configuration of the domain, the interface does not exist or
            cannot be used, or its ports are taken.
    """
    with _lock:
        entry = _joined.get(config.domain_id)
        if entry is None:
            entry = _joined[config.domain_id] = _Joined(config, _create(config))
        elif entry.config != config:
            both = f"this process already joined it as {entry.config}, now asked for {config}"
            cure = "close the other nodes first or use the same settings"
            raise DomainError(config.domain_id, f"{both}; {cure}")
        entry.users += 1


def leave(domain_id: int) -> None:
    """Count one user less; the last one leaves the domain, which frees its sockets and threads."""
    with _lock:
        entry = _joined[domain_id]
        entry.users -= 1
        if entry.users == 0:
            del _joined[domain_id]
            library().dds_delete(entry.handle)


def _create(config: DomainConfig) -> int:
    check_interface(config)
    if [os.environ.get(f"ROS_SECURITY_{name}") for name in ("ENABLE", "STRATEGY")] == [
        "true",
        "Enforce",
    ]:
        # The wheels of Cyclone DDS have no DDS Security. ROS 2's own nodes do not start without it, either.
        why = "ROS_SECURITY_STRATEGY=Enforce is set, but sfglab has no DDS Security; unset it"
        raise DomainError(config.domain_id, why)
    handle: int = library().dds_create_domain(config.domain_id, domain_xml(config).encode())
    if handle < 0:
        raise DomainError(
            config.domain_id,
            f"Cyclone DDS cannot start on interface {config.interface or '(automatic)'}: {error_text(handle)}; "
            f"check that the interface is up and has an address, that UDP port "
            f"{7400 + 250 * config.wire_id} is not taken (ids above 101 lie among Linux's "
            f"ephemeral ports), and that nothing else in this process joined the domain",
        )
    return handle


# --- Participants ---------------------------------------------------------------------------------------------

_MAX_TRIGGERED = 64


class WaitSetThread:
    """Thread that calls handlers when DDS entities have something to take, and functions that are posted to it.

    A Python listener would deadlock with a writer that waits for acknowledgements while it holds the
    interpreter lock. After each round of handlers the thread calls `after_round`.
    """

    def __init__(self, participant: int, after_round: Callable[[], None], *, name: str) -> None:
        lib = library()
        self._set: int = lib.dds_create_waitset(participant)
        self._guard: int = lib.dds_create_guardcondition(participant)
        self._handlers: dict[int, Callable[[], None]] = {}
        self._keys = count(1)
        self._key_of: dict[int, int] = {}
        self._posted: deque[Callable[[], None]] = deque()
        self._is_stopping = False
        lib.dds_waitset_attach(self._set, self._guard, 0)
        self._thread = threading.Thread(
            target=self._run, args=(after_round,), name=name, daemon=True
        )
        self._thread.start()

    def attach_reader(self, reader: int, handler: Callable[[], None]) -> int:
        """Call `handler` whenever `reader` holds samples; return the condition for `detach`."""
        condition: int = library().dds_create_readcondition(reader, ANY_STATE)
        self.attach(condition, handler)
        return condition

    def attach(self, entity: int, handler: Callable[[], None]) -> None:
        """Call `handler` whenever an enabled status of `entity` is set."""
        key = self._key_of[entity] = next(self._keys)
        self._handlers[key] = handler
        library().dds_waitset_attach(self._set, entity, key)
        self._wake()

    def detach(self, entity: int) -> None:
        """Stop waiting for an entity; its handler may still be running."""
        library().dds_waitset_detach(self._set, entity)
        self._handlers.pop(self._key_of.pop(entity, 0), None)

    def post(self, function: Callable[[], None]) -> None:
        """Call a function in the thread; thread-safe."""
        self._posted.append(function)
        self._wake()

    def run_posted(self) -> None:
        """Call the functions posted so far; what they post themselves runs later, after all other work."""
        for _ in range(len(self._posted)):
            call_logged(self._posted.popleft())

    def stop(self) -> None:
        """Stop the thread, and return when it has ended, after 5 s at most."""
        self._is_stopping = True
        self._wake()
        if self._thread is not threading.current_thread():
            self._thread.join(JOIN_S)
        self._handlers.clear()

    def _wake(self) -> None:
        library().dds_set_guardcondition(self._guard, True)

    def _run(self, after_round: Callable[[], None]) -> None:
        lib = library()
        handlers = self._handlers
        keys: Any = (ct.c_ssize_t * _MAX_TRIGGERED)()
        triggered = ct.c_bool()
        while not self._is_stopping:
            ready = lib.dds_waitset_wait(self._set, keys, _MAX_TRIGGERED, INFINITY_NS)
            if ready < 0:
                return  # the participant was deleted, so nothing is left to wait for
            for i in range(min(ready, _MAX_TRIGGERED)):
                if keys[i] == 0:
                    lib.dds_take_guardcondition(self._guard, ct.byref(triggered))
                    self.run_posted()
                elif (handler := handlers.get(keys[i])) is not None:
                    call_logged(handler)
            after_round()


class DdsParticipant:
    """Participant of a domain, which creates raw readers and writers; its `WaitSetThread` watches them.

    Raises:
        DomainError: The domain cannot be joined with this configuration.
    """

    def __init__(
        self, config: DomainConfig, user_data: bytes, *, name: str, after_round: Callable[[], None]
    ) -> None:
        self.config = config
        join(config)
        try:
            self.handle = self._create(user_data)
        except BaseException:
            leave(config.domain_id)
            raise
        self.guid = entity_guid(self.handle)
        self.waitset = WaitSetThread(self.handle, after_round, name=name)
        self._new_callbacks = partial(
            WaitSetThread, self.handle, after_round, name=f"{name} callbacks"
        )
        self._callbacks: WaitSetThread | None = None
        self._topics: dict[tuple[str, type[Any]], int] = {}
        self._closed = False

    @property
    def callbacks(self) -> WaitSetThread:
        """Second `WaitSetThread`, for callbacks, so that they delay nothing else; the first use starts it."""
        if self._callbacks is None:
            self._callbacks = self._new_callbacks()
        return self._callbacks

    def stop(self) -> None:
        """Stop the threads; repeated calls are harmless."""
        for thread in (self.waitset, self._callbacks):
            if thread is not None:
                thread.stop()

    def create_writer(
        self, topic: str, idl_type: type[Any], qos: QoSProfile, **more: Unpack[EndpointOptions]
    ) -> int:
        """Return the C handle of a new writer of a DDS topic."""
        with endpoint_qos(qos, **more) as c_qos:
            handle = library().dds_create_writer(
                self.handle, self._topic(topic, idl_type), c_qos, None
            )
        return checked(handle, f"a writer of {topic!r}")

    def create_reader(
        self, topic: str, idl_type: type[Any], qos: QoSProfile, **more: Unpack[EndpointOptions]
    ) -> int:
        """Return the C handle of a new reader of a DDS topic."""
        with endpoint_qos(qos, **more) as c_qos:
            handle = library().dds_create_reader(
                self.handle, self._topic(topic, idl_type), c_qos, None
            )
        return checked(handle, f"a reader of {topic!r}")

    def close(self) -> None:
        """Stop the threads, delete all entities and leave the domain; repeated calls are harmless."""
        if self._closed:
            return
        self._closed = True
        self.stop()
        library().dds_delete(self.handle)
        leave(self.config.domain_id)

    def _create(self, user_data: bytes) -> int:
        with qos_object(user_data) as qos:
            handle: int = library().dds_create_participant(self.config.domain_id, qos, None)
        if handle < 0:
            raise DomainError(
                self.config.domain_id,
                f"no participant can be created ({error_text(handle)}); end other nodes or choose another id",
            )
        return handle

    def _topic(self, name: str, idl_type: type[Any]) -> int:
        # Topics are kept until the participant ends. If types are freed while others are created, Cyclone DDS
        # 11.0.1 may read freed memory (ddsi_type_resolved_locked) and crash.
        key = (name, idl_type)
        if key not in self._topics:
            self._topics[key] = checked(
                _create_topic(self.handle, name, idl_type), f"topic {name!r}"
            )
        return self._topics[key]


def _create_topic(participant: int, name: str, idl_type: Any) -> int:
    from cyclonedds._clayer import ddspy_topic_create

    idl_type.__idl__.populate()
    idl_type.__idl__.fill_type_data()
    handle: int = ddspy_topic_create(participant, name, idl_type, None, None)
    return handle


def checked(handle: int, what: str) -> int:
    """Return a handle of Cyclone DDS unchanged, if it is not an error code.

    Args:
        handle: Return value of a function of Cyclone DDS.
        what: Failed action in the error's text.

    Raises:
        BusError: The handle is an error code.
    """
    if handle < 0:
        raise BusError(f"Cyclone DDS cannot create {what}: {error_text(handle)}")
    return handle
