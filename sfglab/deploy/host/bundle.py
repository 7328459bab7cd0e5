"""The files of an agent's folder that make its machine ready.

The scripts are the same for all agents; what differs stands in ``hooks/settings.sh``, ``hooks/firewall.nft``
and the unit. Refuses to know the machine: that is for the scripts, which run on it.
"""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING, NamedTuple

from sfglab.deploy.files import PLAIN, PROGRAM, BundleFile
from sfglab.deploy.host.firewall import firewall_left_out, firewall_rules, firewall_table
from sfglab.deploy.host.time_servers import plan_time
from sfglab.deploy.host.unit import service_unit
from sfglab.deploy.templates import render

if TYPE_CHECKING:
    from sfglab.deploy.deployment import Deployment


STATE = "/var/lib/sfglab"
"""Where machines keep what a run of the hooks still owes, one folder an agent."""
CONTAINER_GID = 10001
"""The group that the containers run as."""


class Hook(NamedTuple):
    """A script of the folder ``hooks``.

    Attributes:
        name: Its path within that folder.
        what: What it does, for tables.
    """

    name: str
    what: str


HOOKS = (
    Hook("initialize.sh", "runs the hooks below in order, then custom.d; --dry-run shows, --undo takes back"),
    Hook(
        "10-time.sh", "NTP: chrony or systemd-timesyncd goes by the fleet's time servers, or serves their time"
    ),
    Hook(
        "20-firewall.sh",
        "nftables: the agent's own domain does not leave the machine, its bridge has no way out",
    ),
    Hook(
        "30-service.sh",
        "systemd: the agent's containers start with the machine; and .env has release and groups",
    ),
    Hook("custom.d/*.sh", "scripts of the user, after ours in the order of their names, never overwritten"),
)
"""The hooks, in the order in which they run."""

_STATIC = {
    "initialize.sh": PROGRAM,
    "lib.sh": PLAIN,
    "10-time.sh": PROGRAM,
    "20-firewall.sh": PROGRAM,
    "30-service.sh": PROGRAM,
    "custom.d/README": PLAIN,
}


def host_files(deployment: Deployment) -> dict[str, BundleFile]:
    """Return the hooks and the unit, by their paths in the agent's folder.

    Args:
        deployment: The agent on its machine.

    Raises:
        DeployError: A time server has no address, or an interface a name that Linux does not take.
    """
    scripts = resources.files(__package__) / "scripts"
    files = {
        f"hooks/{name}": BundleFile(text=scripts.joinpath(name).read_text(encoding="utf-8"), mode=mode)
        for name, mode in _STATIC.items()
    }
    rules = firewall_rules(deployment)
    files["hooks/settings.sh"] = BundleFile(text=_settings(deployment, firewall=bool(rules)))
    if rules:
        files["hooks/firewall.nft"] = BundleFile(text=rules)
    files[f"systemd/{deployment.service}"] = BundleFile(text=service_unit(deployment))
    return files


def _settings(deployment: Deployment, *, firewall: bool) -> str:
    time = plan_time(deployment)
    return render(
        "sfglab.deploy.host",
        "settings.sh",
        agent=deployment.agent.name,
        folder=deployment.folder,
        service=deployment.service,
        state=f"{STATE}/{deployment.agent.name}",
        gid=CONTAINER_GID,
        interface=deployment.network.global_interface or "",
        servers=time.servers,
        serves=time.serves,
        firewall=firewall,
        left_out=firewall_left_out(deployment),
        table=firewall_table(deployment),
    )
