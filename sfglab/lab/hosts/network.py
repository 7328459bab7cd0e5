"""Several hosts on one machine, joined by one Ethernet: network namespaces made through netlink.

Needs root or a user namespace, no external program, and leaves nothing behind, whatever ends it.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Literal, Self

from sfglab.lab.hosts.channel import Channel
from sfglab.lab.hosts.errors import (
    HostNameError,
    HostsError,
    HostsUnavailableError,
    LinkControlError,
    UnknownHostError,
)
from sfglab.lab.hosts.host import Host
from sfglab.lab.hosts.link import Link, LinkCounters
from sfglab.lab.hosts.processes import end_members
from sfglab.lab.hosts.radio import RadioCounters

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sfglab.rtps import Medium


_HOW = {None: "auto", False: "root", True: "rootless"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Capability:
    """Whether this machine can run test hosts."""

    ok: bool  #: It can.
    how: Literal["root", "rootless", "none"]  #: As root, rootless in a user namespace, or not at all.
    reason: str = ""  #: What stands against it; empty when nothing does.


class Network:
    """A network of test hosts, to be used as a context manager.

    Leaving the context ends every process inside the hosts (TERM, a grace, KILL) and then the hosts. When the
    creating process is killed, the same happens without the grace.

    Args:
        rootless: True uses a user namespace even as root, False insists on root, None takes what works.
        grace_s: How long processes may take to end after TERM, in seconds.
    """

    def __init__(self, *, rootless: bool | None = None, grace_s: float = 2.0) -> None:
        self._wanted = _HOW[rootless]
        self._grace_s = grace_s
        self._running: Channel | None = None
        self._hosts: dict[str, Host] = {}
        self._on_radio = False

    @staticmethod
    def available() -> Capability:
        """Find out by trying whether test hosts work here; takes about half a second and leaves nothing."""
        try:
            with Network() as network:
                network.add_host("probe")
                return Capability(ok=True, how="root" if network.how == "root" else "rootless")
        except (HostsUnavailableError, HostsError) as error:
            return Capability(ok=False, how="none", reason=getattr(error, "reason", str(error)))

    def __enter__(self) -> Self:
        if self._running is not None:
            raise HostsError("this network is in use already: make another Network for another `with` block")
        self._running = Channel(self._wanted)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        channel, self._running = self._channel, None
        hosts, self._hosts = self._hosts, {}
        self._on_radio = False
        try:
            end_members({host.inode for host in hosts.values()}, grace_s=self._grace_s)
        finally:
            channel.close()
            for host in hosts.values():
                host.close()

    @property
    def _channel(self) -> Channel:
        if self._running is None:
            raise HostsError("this network is closed: use it inside its `with` block")
        return self._running

    @property
    def how(self) -> str:
        """Return ``root`` or ``rootless``."""
        return self._channel.how

    @property
    def hosts(self) -> Mapping[str, Host]:
        """Return the hosts by name."""
        return MappingProxyType(self._hosts)

    def add_host(self, name: str) -> Host:
        """Add a host to the network; the first one has the address 10.77.0.2, the next one 10.77.0.3.

        Args:
            name: A name of your choice, once per network.

        Raises:
            HostNameError: The name is empty or taken.
            HostsUnavailableError: The kernel refuses.
            HostsError: The network is closed or lost, or full (253 hosts), or a radio.
        """
        if self._on_radio:
            raise HostsError("this network is a radio now: add its hosts before `set_radio`")
        if not name or name in self._hosts:
            raise HostNameError(name, self._hosts)
        try:
            made = self._channel.request("add_host", name=name)
        except PermissionError as error:
            raise HostsUnavailableError(str(error)) from error
        host = Host(name, address=made["address"], holder=made["holder"], how=self.how)
        self._hosts[name] = host
        return host

    def _check(self, name: str) -> None:
        if name not in self._hosts:
            raise UnknownHostError(name, self._hosts)

    def set_link(
        self,
        name: str,
        *,
        rate_bps: float | None = None,
        loss: float | None = None,
        queue_bytes: int | None = None,
    ) -> None:
        """Replace the properties of a host's link, in both directions; what is None is unlimited or lossless.

        Args:
            name: The host.
            rate_bps: Rate of Ethernet frames in bit/s.
            loss: Probability with which each frame is lost.
            queue_bytes: Size of the drop-tail queue before the rate; None is 100 ms at that rate.

        Raises:
            UnknownHostError: There is no such host.
            LinkError: A value cannot be emulated.
            LinkControlError: The kernel refuses.
            HostsError: The network is closed or lost, or a radio.
        """
        self._check(name)
        if self._on_radio:
            raise HostsError("this network is a radio now: the medium of `set_radio` is its only link")
        link = Link(rate_bps=rate_bps, loss=loss or 0.0, queue_bytes=queue_bytes)
        try:
            self._channel.request("set_link", name=name, **asdict(link))
        except PermissionError as error:
            raise LinkControlError(name, str(error)) from error

    def link_counters(self, name: str) -> LinkCounters:
        """Return what a host's link has lost since it was last set.

        Args:
            name: The host.

        Raises:
            UnknownHostError: There is no such host.
            HostsError: The network is closed or lost.
        """
        self._check(name)
        return LinkCounters(**self._channel.request("link_counters", name=name))

    def set_radio(self, medium: Medium, *, seed: int = 0) -> None:
        """Join the hosts by a medium that they share instead of the Ethernet, or change that medium.

        A process relays every frame as the medium says; see `RadioCounters.kept_up` for whether it could. The
        queue is the relay's: hosts never wait. Losses follow the seed, but which frame meets which number
        depends on the machine. Counters begin anew.

        Args:
            medium: As in the model of RTPS; a frame's size is its Ethernet header and payload.
            seed: Of the losses.

        Raises:
            LinkControlError: The kernel refuses.
            HostsError: The network is closed or lost, or has no hosts.
        """
        if not self._hosts:
            raise HostsError("a radio needs hosts: add them before `set_radio`")
        try:
            self._channel.request("set_radio", medium=asdict(medium), seed=seed)
        except PermissionError as error:
            raise LinkControlError(", ".join(self._hosts), str(error)) from error
        self._on_radio = True

    def end_radio(self) -> None:
        """Go back to the Ethernet; harmless without a radio.

        Raises:
            HostsError: The network is closed or lost.
        """
        self._channel.request("end_radio")
        self._on_radio = False

    def radio_counters(self) -> RadioCounters:
        """Return what the radio has done since its medium was set.

        Raises:
            HostsError: There is no radio, or the network is closed or lost.
        """
        if not self._on_radio:
            raise HostsError("this network has no radio: call `set_radio` first")
        return RadioCounters.of(self._channel.request("radio_counters"))
