"""What can go wrong with test hosts, and what to try then."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Iterable


_REMEDY = (
    "Try one of: run as root; allow user namespaces (sysctl user.max_user_namespaces and max_net_namespaces "
    "above 0, which 'No space left' is about, and on Debian and Ubuntu kernel.unprivileged_userns_clone=1 and "
    "kernel.apparmor_restrict_unprivileged_userns=0); in a container, start it with --cap-add=SYS_ADMIN "
    "--cap-add=NET_ADMIN and a seccomp profile that allows unshare"
)


class HostsUnavailableError(SfglabError, OSError):
    """This machine does not let us make network namespaces.

    Attributes:
        reason: What the kernel or the starting process said.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"test hosts need network namespaces, which failed here: {reason}. {_REMEDY}")


class HostsError(SfglabError, RuntimeError):
    """A network of test hosts is closed, lost its hub, or did not do what it was asked for."""


class HostNameError(SfglabError, ValueError):
    """A host's name is empty or taken.

    Attributes:
        name: The name that was given.
    """

    def __init__(self, name: str, taken: Iterable[str]) -> None:
        self.name = name
        super().__init__(
            f"host name: given {name!r}, allowed is any text that is not empty nor in {sorted(taken)}"
        )


class UnknownHostError(SfglabError, LookupError):
    """The network has no host of that name.

    Attributes:
        name: The name that was given.
    """

    def __init__(self, name: str, known: Iterable[str]) -> None:
        self.name = name
        super().__init__(f"host: given {name!r}, this network has {sorted(known)}")


class LinkError(SfglabError, ValueError):
    """A link's rate, loss or queue lies outside what can be emulated."""


class LinkControlError(SfglabError, OSError):
    """The kernel refuses to limit or to lose packets.

    Attributes:
        reason: What the kernel said.
    """

    def __init__(self, host: str, reason: str) -> None:
        self.reason = reason
        super().__init__(
            f"link of host {host!r}: the kernel refused it: {reason}. Rates need the tbf queueing discipline "
            "(module sch_tbf), loss needs nftables in bridges (modules nf_tables and nft_numgen)"
        )
