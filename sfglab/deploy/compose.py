"""Compose project of an agent's two containers (paper A, section 4.4, Fig. 5): agent and router.

Both containers run the application image with minimal rights: no capabilities, a read-only root, and a user of their
own. Only the router uses the host's network, because DDS discovers other agents with multicast.
"""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

from sfglab.deploy.dds_router import ROUTER_FILE
from sfglab.deploy.deployment import FLEET_FILE, USER_ID, Deployment
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import BundleFile, one_line, text_file
from sfglab.fleet.fleet_file import Accelerator, RosDistribution, RouterSoftware

_NEEDS_INITIALIZE = "run hooks/initialize.sh first"
_USB = "/dev/bus/usb"
_USB_MAJOR = 189  # Linux, Documentation/admin-guide/devices.txt

_ACCELERATOR_DEVICES: dict[Accelerator, tuple[str, ...]] = {
    Accelerator.VAAPI: ("/dev/dri",),
    Accelerator.ROCM: ("/dev/kfd", "/dev/dri"),
}
"""Device nodes. NVIDIA's come with its runtime; those of V4L2 differ by board and are in the fleet file."""


def compose_files(deployment: Deployment) -> dict[str, BundleFile]:
    """Return ``compose.yaml`` and its overlay for development.

    Raises:
        DeployError: The folder of the certificates is no absolute path.
    """
    projects = {"compose.yaml": _project(deployment), "compose.dev.yaml": _development(deployment)}
    return {name: text_file(_yaml(deployment, project)) for name, project in projects.items()}


def _project(deployment: Deployment) -> dict[str, Any]:
    """Return the Compose project of an agent (Compose Specification)."""
    project: dict[str, Any] = {
        "name": deployment.project,
        "services": {"agent": _agent(deployment), "router": _router(deployment)},
    }
    if deployment.bridge:
        options = {"com.docker.network.bridge.name": deployment.bridge}
        project["networks"] = {
            "agent": {"driver": "bridge", "internal": True, "driver_opts": options}
        }
    return project


def _development(deployment: Deployment) -> dict[str, Any]:
    """Return the overlay for development: the user's workspace as a folder, debuggers, and a route to other hosts."""
    agent: dict[str, Any] = {
        "image": f"{deployment.repository}:development",
        "build": {"context": ".", "target": "development"},
        "command": ["sleep", "infinity"],
        "entrypoint": [],
        "read_only": False,
        "volumes": ["${SFGLAB_WORKSPACE:-./workspace}:/workspace", "./.vscode:/workspace/.vscode"],
    }
    overlay: dict[str, Any] = {"services": {"agent": agent}}
    if deployment.bridge:
        # With two networks, only a name decides which one is eth0; needs Docker Engine 28.1.
        agent["networks"] = {
            "agent": {"interface_name": deployment.agent_interface},
            "outside": {"interface_name": "eth1"},
        }
        overlay["networks"] = {"outside": {}}
    return overlay


def _agent(deployment: Deployment) -> dict[str, Any]:
    service = {
        "image": _image(deployment),
        "build": {"context": ".", "target": "application"},
        "command": list(deployment.agent_command),
        "environment": _environment(deployment),
        **_hardening(),
        **_hardware(deployment),
    }
    bridged = bool(deployment.bridge)
    return service | ({"networks": ["agent"]} if bridged else {"network_mode": "host"})


def _router(deployment: Deployment) -> dict[str, Any]:
    service: dict[str, Any] = {"image": deployment.common.router_image or _image(deployment)}
    if deployment.common.router is RouterSoftware.SFGLAB:
        own = [
            "router",
            "--fleet",
            FLEET_FILE,
            "--agent",
            deployment.agent.name,
            "--interface",
            deployment.router_interface,
        ]
        service["command"] = own
        if deployment.fleet.zenoh and deployment.fleet.zenoh.certificates:
            service["volumes"] = [_certificates(deployment.fleet.zenoh.certificates)]
    else:
        service["entrypoint"] = ["ddsrouter", "--config-path", f"/etc/{ROUTER_FILE}"]
        service["volumes"] = [f"./{ROUTER_FILE}:/etc/{ROUTER_FILE}:ro"]
    return service | _hardening() | {"network_mode": "host", "depends_on": ["agent"]}


def _certificates(folder: str) -> dict[str, Any]:
    """Return a mount of the host's folder of certificates at the path that the fleet file names."""
    if not PurePosixPath(folder).is_absolute():
        raise DeployError(
            f"global.certificates: given {folder!r}, allowed in a deployed fleet: an absolute path on "
            "the agents' hosts, as in /etc/sfglab/keys"
        )
    path = folder.replace("$", "$$")  # a single dollar sign begins a variable
    # Without `create_host_path`, Docker refuses a missing folder in place of making an empty one.
    options = {"create_host_path": False}
    mount = {"type": "bind", "source": path, "target": path, "read_only": True}
    return {**mount, "bind": options}


def _image(deployment: Deployment) -> str:
    return f"{deployment.repository}:${{SFGLAB_TAG:?{_NEEDS_INITIALIZE}}}"


def _environment(deployment: Deployment) -> dict[str, str]:
    """Return the environment with which the agent's nodes and the user's nodes join the agent's domain."""
    values = {
        "SFG_AGENT_NAME": deployment.agent.name,
        "HOME": "/tmp",  # noqa: S108 - a tmpfs of the container's own
        "NUMBA_CACHE_DIR": "/run/numba",
    }
    if deployment.common.ros is RosDistribution.NONE:
        return values
    return values | {
        "ROS_DOMAIN_ID": str(deployment.agent.domain),
        "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp",
        "CYCLONEDDS_URI": _cyclone(deployment.agent_interface),
    }


def _cyclone(interface: str) -> str:
    """Return a configuration of Cyclone DDS that keeps to one interface, as text in place of a file."""
    return (
        "<CycloneDDS><Domain><General><Interfaces>"
        f'<NetworkInterface name="{interface}"/>'
        "</Interfaces></General></Domain></CycloneDDS>"
    )


def _hardening() -> dict[str, Any]:
    return {
        "init": True,
        "user": f"{USER_ID}:{USER_ID}",
        "read_only": True,
        "tmpfs": ["/tmp:mode=1777,size=256m", "/run:mode=1777,size=64m"],  # noqa: S108 - of the container's own
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
        # systemd starts the project at boot; Docker restarts a container after a crash.
        "restart": "on-failure",
        "logging": {"driver": "json-file", "options": {"max-size": "10m", "max-file": "3"}},
    }


def _hardware(deployment: Deployment) -> dict[str, Any]:
    accelerator = deployment.accelerator
    nodes = dict.fromkeys((*_ACCELERATOR_DEVICES.get(accelerator, ()), *deployment.host.devices))
    wanted: dict[str, Any] = {}
    if nodes:
        wanted["devices"] = [f"{node}:{node}" for node in nodes]
        wanted["group_add"] = [
            f"${{SFGLAB_{group}_GID:?{_NEEDS_INITIALIZE}}}" for group in ("VIDEO", "RENDER")
        ]
    if _USB in nodes:
        # The rule also covers devices that are plugged in later.
        wanted["device_cgroup_rules"] = [f"c {_USB_MAJOR}:* rwm"]
    if accelerator is Accelerator.JETSON:
        wanted["runtime"] = "nvidia"
    if accelerator is Accelerator.CUDA:
        gpu = {
            "driver": "nvidia",
            "count": "all",
            "capabilities": ["gpu", "compute", "utility", "video"],
        }
        wanted["deploy"] = {"resources": {"reservations": {"devices": [gpu]}}}
    return wanted


def _yaml(deployment: Deployment, project: dict[str, Any]) -> str:
    import yaml

    origin = f"Agent {deployment.agent.name} of fleet {deployment.fleet.name}: generated from the fleet file."
    return f"# {one_line(origin)}\n{yaml.safe_dump(project, sort_keys=False, width=110)}"
