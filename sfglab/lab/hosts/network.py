"""Several hosts on one machine, joined by one Ethernet: network namespaces, made through netlink.

The network needs root or a user namespace, and no external program. It leaves nothing behind, even if its
creator is killed. The hub, a process of its own, owns the namespaces. It is separate because only a process
inside a namespace can configure it, and because the cleaning must not depend on the creator.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Literal, Self

from sfglab.errors import InvalidValueError
from sfglab.lab.hosts.channel import Channel
from sfglab.lab.hosts.host import Host, HostsError, HostsUnavailableError, end_members
from sfglab.lab.hosts.radio import RadioCounters

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.rtps import Medium


@dataclass(frozen=True, slots=True, kw_only=True)
class Capability:
    """Ability of this machine to run test hosts."""

    ok: bool  #: Whether the machine can run test hosts.
    #: Way to make namespaces: as root, rootless in a user namespace, or none.
    how: Literal["root", "rootless", "none"]
    reason: str = ""  #: Reason why the machine cannot run them; empty if it can.


class Network:
    """A network of test hosts, as a context manager.

    At its end, every process inside the hosts ends (TERM, a grace period in seconds, KILL), and then the
    hosts. If the creating process is killed, there is no grace period.

    Raises:
        HostsError: A method was called, and the network is closed or has lost its hub.
    """

    def __init__(self, *, grace_s: float = 2.0) -> None:
        self._grace_s = grace_s
        self._running: Channel | None = None
        self.how = ""  #: Way to make namespaces: ``root`` or ``rootless``.
        self.hosts: dict[str, Host] = {}  #: Hosts by name.
        self._on_radio = False

    @staticmethod
    def available() -> Capability:
        """Find out by a trial whether test hosts work here; takes about half a second and leaves nothing behind."""
        try:
            with Network() as network:
                network.add_host("probe")
                return Capability(ok=True, how="root" if network.how == "root" else "rootless")
        except (HostsUnavailableError, HostsError) as error:
            return Capability(ok=False, how="none", reason=getattr(error, "reason", str(error)))

    def __enter__(self) -> Self:
        channel = Channel()
        try:
            self.how = channel.receive()
        except BaseException as error:
            channel.close()
            if isinstance(error, HostsError):
                raise HostsUnavailableError(str(error)) from error
            raise
        self._running = channel
        return self

    def __exit__(self, *_: object) -> None:
        channel, self._running = self._channel, None
        hosts, self.hosts = self.hosts, {}
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

    def argv(self, host: str, command: Sequence[str]) -> list[str]:
        """Return the command line that runs a command inside a host, see `Host.argv`."""
        return self.hosts[host].argv(command)

    def add_host(self, name: str) -> Host:
        """Add a host to the network; the first one has the address 10.77.0.2, the next one 10.77.0.3.

        Raises:
            HostsUnavailableError: The kernel refuses.
            HostsError: The network is closed, lost, or a radio.
        """
        if self._on_radio:
            raise HostsError("this network is a radio now: add its hosts before `set_radio`")
        try:
            made = self._channel.request("add_host", name=name)
        except PermissionError as error:
            raise HostsUnavailableError(str(error)) from error
        host = Host(name, address=made["address"], holder=made["holder"], how=self.how)
        self.hosts[name] = host
        return host

    def set_connected(self, name: str, *, connected: bool) -> None:
        """Connect a host to the Ethernet, or disconnect it; all frames of a disconnected host are lost.

        Raises:
            HostsError: The network is closed, lost, or a radio.
        """
        if self._on_radio:
            raise HostsError("this network is a radio now, without an Ethernet")
        self._channel.request("set_connected", name=name, connected=connected)

    def set_radio(self, medium: Medium, *, seed: int = 0) -> None:
        """Replace the Ethernet between the hosts by a shared medium, or change that medium.

        The hub relays every frame by the rules of the medium. `RadioCounters.kept_up` states whether it was
        fast enough. The relay has the queues, and hosts never wait. The seed determines the random numbers of
        the losses; the assignment of numbers to frames depends on the machine. Counters begin at 0. The size
        of a frame is that of its Ethernet header and payload.

        Raises:
            InvalidValueError: Hosts do not share the medium, or its queue blocks, which a relay cannot make a
                sender do.
            HostsError: The kernel refuses.
        """
        if not medium.shared or medium.queue_rule == "block":
            allowed = "a shared one whose queue does not block"
            raise InvalidValueError("medium", medium, allowed)
        try:
            self._channel.request("set_radio", medium=asdict(medium), seed=seed)
        except PermissionError as error:
            raise HostsError(f"the kernel refused a radio: {error}") from error
        self._on_radio = True

    def radio_counters(self) -> RadioCounters:
        """Return the counters of the radio since its medium was set.

        Raises:
            HostsError: The network has no radio, is closed, or is lost.
        """
        if not self._on_radio:
            raise HostsError("this network has no radio: call `set_radio` first")
        return RadioCounters(**self._channel.request("radio_counters"))
