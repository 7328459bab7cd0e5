"""Compose files: the Compose Specification's own schema, and our rules on what may run how.

Least privileges, and nothing that changes by itself. The overlay for development is asked those alone that hold
for it too: it has a debugger, a shell and the user's folder.
"""

from __future__ import annotations

import importlib
import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from typing import TYPE_CHECKING, Any

from sfglab.deploy.compose_values import (
    environment,
    mounts,
    named,
    references,
    scalars,
    variables,
    without_variables,
)
from sfglab.deploy.errors import DeployError, MissingProgramError
from sfglab.deploy.text_check import SECRET_NAME
from sfglab.deploy.verdicts import State, Verdict, verdict_of
from sfglab.documents import Document, DocumentError
from sfglab.fleet.fleet_file import Accelerator, ContainerNetwork

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.files import BundleFile


AGENT, ROUTER = "agent", "router"
_NVIDIA = (Accelerator.CUDA, Accelerator.JETSON)
_DRI = ("/dev/dri", "/dev/dri/*")
_NODES: dict[Accelerator, tuple[str, ...]] = {
    Accelerator.JETSON: ("/dev/nv*", *_DRI),
    Accelerator.CUDA: ("/dev/nvidia*",),
    Accelerator.ROCM: ("/dev/kfd", *_DRI),
    Accelerator.VAAPI: _DRI,
    Accelerator.V4L2: ("/dev/video*", "/dev/media*", "/dev/dma_heap", "/dev/dma_heap/*", *_DRI),
    Accelerator.NONE: (),
}
"""Device nodes by which accelerators are driven on Linux."""

_USB, _USB_RULE = "/dev/bus/usb", "c 189:"  # Linux, Documentation/admin-guide/devices.txt
_SOCKETS = ("docker.sock", "podman.sock", "containerd.sock", "crio.sock")
_TOO_WIDE = ("/", "/run", "/var/run", "/var/lib/docker")
_DEBUGGER = "SYS_PTRACE"


@dataclass(frozen=True, slots=True, kw_only=True)
class Project:
    """One Compose file and what it is asked against."""

    values: dict[str, Any]  #: What stands in it.
    base: dict[str, Any]  #: What stands in the file that it overlays; empty where it overlays none.
    overlay: bool  #: Whether it overlays another.
    deployment: Deployment  #: What the fleet file says.
    variables: frozenset[str]  #: Names that the folder's files of variables define.

    def services(self) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield the services by name."""
        yield from self.values["services"].items()

    def known(self, section: str) -> tuple[str, ...]:
        """Return the names that a section of this file or of its base defines."""
        return (*named(self.base.get(section)), *named(self.values.get(section)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Rule:
    """A rule."""

    name: str  #: What holds where it is kept.
    wrong: Callable[[Project], Iterator[str]]  #: Yields where it is not.
    overlay: bool = False  #: Whether development keeps it too.


def _services(project: Project) -> Iterator[str]:
    names, allowed = set(named(project.values["services"])), {AGENT, ROUTER}
    for name in sorted(names - allowed):
        yield f"services.{name}: allowed are {AGENT} and {ROUTER}"
    for name in sorted(allowed - names) if not project.overlay else ():
        yield f"services.{name}: nothing is given"


def _images(project: Project) -> Iterator[str]:
    for name, service in project.services():
        image = service.get("image")
        if image is None and project.overlay:
            continue
        optional = [entry.name for entry in variables(image) if not entry.must_be_set]
        last = without_variables(str(image or "")).rpartition("/")[2]
        tag = last.partition("@")[0].partition(":")[2]
        if not tag and "@sha256:" not in last:
            yield f"services.{name}.image: given {image!r}, allowed: an image with a tag or a digest"
        elif tag == "latest":
            yield f"services.{name}.image: given the tag latest, which means another image tomorrow"
        for variable in optional:
            yield f"services.{name}.image: {variable} may be unset, allowed: ${{{variable}:?...}}"


def _capabilities(project: Project) -> Iterator[str]:
    allowed = {_DEBUGGER} if project.overlay else set()
    for name, service in project.services():
        if not project.overlay and "ALL" not in scalars(service.get("cap_drop")):
            yield f"services.{name}.cap_drop: nothing is given, allowed: [ALL]"
        for capability in scalars(service.get("cap_add")):
            if capability not in allowed:
                words = ", ".join(allowed) or "none"
                yield f"services.{name}.cap_add: given {capability}, allowed: {words}"


def _no_new_privileges(project: Project) -> Iterator[str]:
    for name, service in project.services():
        options = scalars(service.get("security_opt"))
        if not project.overlay and not {"no-new-privileges:true", "no-new-privileges"} & set(
            options
        ):
            yield f"services.{name}.security_opt: nothing is given, allowed: [no-new-privileges:true]"
        for option in options:
            if option.endswith(("unconfined", ":false", "disable")):
                yield f"services.{name}.security_opt: given {option}, allowed: no protection is switched off"


def _read_only(project: Project) -> Iterator[str]:
    for name, service in project.services():
        if service.get("read_only") is not True:
            given = service.get("read_only")
            yield f"services.{name}.read_only: given {given!r}, allowed: true, with tmpfs for what is written"


def _user(project: Project) -> Iterator[str]:
    for name, service in project.services():
        user = service.get("user")
        if user is None and project.overlay:
            continue
        owner, _, group = str(user).partition(":")
        if not owner.isdigit() or int(owner) == 0 or (group.isdigit() and int(group) == 0):
            yield f"services.{name}.user: given {user!r}, allowed: user and group by number, without root"


def _privileged(project: Project) -> Iterator[str]:
    for name, service in project.services():
        if service.get("privileged") not in (None, False):
            yield f"services.{name}.privileged: given {service['privileged']!r}, allowed: false"


def _sockets(project: Project) -> Iterator[str]:
    for name, service in project.services():
        for mount in mounts(service):
            if mount.source.endswith(_SOCKETS):
                yield f"services.{name}.volumes: {mount.source} makes whoever writes to it root of the machine"
            elif mount.source != "/" and mount.source.rstrip("/") in _TOO_WIDE:
                yield f"services.{name}.volumes: {mount.source} holds sockets of the machine's services"
            elif mount.source == "/":
                yield f"services.{name}.volumes: / is the whole machine"


def _namespaces(project: Project) -> Iterator[str]:
    for name, service in project.services():
        for key in ("pid", "ipc", "uts", "userns_mode", "cgroup"):
            if service.get(key) == "host":
                yield f"services.{name}.{key}: given host, allowed: the container's own"


def _networks(project: Project) -> Iterator[str]:
    on_host = {ROUTER}
    if project.deployment.host.network is ContainerNetwork.HOST:
        on_host.add(AGENT)
    for name, service in project.services():
        mode = service.get("network_mode")
        allowed = (None, "none", "host") if name in on_host else (None, "none")
        if mode not in allowed:
            own = "its own network, because the fleet file does not say host"
            words = own if name == AGENT else "host or none"
            yield f"services.{name}.network_mode: given {mode!r}, allowed: {words}"


def _inside(project: Project) -> Iterator[str]:
    """Find networks by which an agent's own domain has a way out beside the router."""
    networks = project.values.get("networks")
    for name in named(project.values["services"].get(AGENT, {}).get("networks")):
        settings = networks.get(name) if isinstance(networks, dict) else None
        if not isinstance(settings, dict) or settings.get("internal") is not True:
            yield f"networks.{name}.internal: nothing is given, allowed: true, as only the router has a way out"


def _ports(project: Project) -> Iterator[str]:
    for name, service in project.services():
        if service.get("ports"):
            yield f"services.{name}.ports: given {service['ports']!r}, allowed: none, as DDS needs none opened"


def _secrets(project: Project) -> Iterator[str]:
    for name, service in project.services():
        build = service.get("build")
        places = {"environment": service.get("environment")}
        if isinstance(build, dict):
            places["build.args"] = build.get("args")
        for place, values in places.items():
            for variable, value in environment(values):
                if value and SECRET_NAME.search(variable):
                    yield f"services.{name}.{place}.{variable}: a secret stands there, allowed: none"


def _mounts(project: Project) -> Iterator[str]:
    folder = f"{project.deployment.folder}/"
    for name, service in project.services():
        for mount in mounts(service):
            inside = mount.source.startswith(("./", folder)) and ".." not in mount.source.split("/")
            if mount.bind and not mount.read_only and not inside:
                yield f"services.{name}.volumes: {mount.source} can be written; allowed: :ro, or below {folder}"


def _devices(project: Project) -> Iterator[str]:
    accelerator, given = project.deployment.accelerator, project.deployment.host.devices
    nodes = (*_NODES[accelerator], *given)
    for name, service in project.services():
        for device in scalars(service.get("devices"), key="source"):
            source = device.partition(":")[0]
            if not any(fnmatchcase(source, node) for node in nodes):
                words = ", ".join(nodes) or "none"
                yield f"services.{name}.devices: given {source}, allowed by the fleet file: {words}"
        for rule in scalars(service.get("device_cgroup_rules")):
            if not (rule.startswith(_USB_RULE) and any(node.startswith(_USB) for node in given)):
                words = f"{_USB_RULE}* where the fleet file names {_USB}"
                yield f"services.{name}.device_cgroup_rules: given {rule!r}, allowed: {words}"
        if accelerator not in _NVIDIA and (
            service.get("runtime") == "nvidia" or service.get("gpus")
        ):
            yield f"services.{name}: NVIDIA's runtime is asked for, but its accelerator is {accelerator.value}"
        yield from _reserved(name, service, accelerator)


def _reserved(name: str, service: dict[str, Any], accelerator: Accelerator) -> Iterator[str]:
    value: Any = service
    for key in ("deploy", "resources", "reservations", "devices"):
        value = value.get(key) if isinstance(value, dict) else None
    for device in value if isinstance(value, list) else []:
        driver = device.get("driver") if isinstance(device, dict) else None
        if driver != "nvidia" or accelerator not in _NVIDIA:
            words = f"its accelerator is {accelerator.value}"
            yield f"services.{name}.deploy.resources.reservations.devices: given driver {driver!r}, but {words}"


def _variables(project: Project) -> Iterator[str]:
    for entry in dict.fromkeys(variables(project.values)):
        if not entry.must_be_set and not entry.has_default and entry.name not in project.variables:
            words = f"a value in release.env, or ${{{entry.name}:?what to do}}"
            yield f"${{{entry.name}}}: nobody sets it, and Compose would take nothing for it; allowed: {words}"


def _references(project: Project) -> Iterator[str]:
    for name, service in project.services():
        for key, section, target in references(service):
            if target not in project.known(section):
                known = ", ".join(project.known(section)) or "none"
                yield f"services.{name}.{key}: given {target!r}, allowed: {known}"


RULES: tuple[Rule, ...] = (
    Rule(name="services agent and router alone", wrong=_services, overlay=True),
    Rule(name="images have a tag that stays", wrong=_images, overlay=True),
    Rule(name="no capabilities", wrong=_capabilities, overlay=True),
    Rule(name="no new privileges", wrong=_no_new_privileges, overlay=True),
    Rule(name="read-only root", wrong=_read_only),
    Rule(name="no root user", wrong=_user, overlay=True),
    Rule(name="not privileged", wrong=_privileged, overlay=True),
    Rule(name="no sockets of the machine", wrong=_sockets, overlay=True),
    Rule(name="namespaces of their own", wrong=_namespaces, overlay=True),
    Rule(name="host network for the router alone", wrong=_networks, overlay=True),
    Rule(name="agent's network has no way out", wrong=_inside),
    Rule(name="no published ports", wrong=_ports, overlay=True),
    Rule(name="no secrets in variables", wrong=_secrets, overlay=True),
    Rule(name="mounts read-only or of the agent's folder", wrong=_mounts),
    Rule(name="devices of the fleet file alone", wrong=_devices, overlay=True),
    Rule(name="every variable is set", wrong=_variables, overlay=True),
    Rule(name="what is named exists", wrong=_references, overlay=True),
)
"""Every rule."""


BASE, OVERLAY = "compose.yaml", "compose.dev.yaml"
SCHEMA = "Compose Specification"
_LIBRARY = "check_jsonschema"
_VARIABLES = ("release.env",)
_ASSIGNMENT = re.compile(r"^(?:export )?([A-Za-z_]\w*)=", re.MULTILINE)


def check_compose(files: Mapping[str, BundleFile], deployment: Deployment) -> tuple[Verdict, ...]:
    """Return one verdict about each rule for the agent's project and for its overlay for development."""
    verdicts: list[Verdict] = []
    base: dict[str, Any] = {}
    texts = (files[name].text for name in _VARIABLES if name in files)
    defined = frozenset(name for text in texts for name in _ASSIGNMENT.findall(text))
    for name in (BASE, OVERLAY):
        try:
            values = _services_of(files, name)
        except (DeployError, DocumentError) as error:
            verdicts.append(Verdict(check=SCHEMA, subject=name, state=State.FAILS, says=str(error)))
            continue
        verdicts.append(verdict_of(SCHEMA, name, _by_schema, values))
        overlay = name == OVERLAY
        project = Project(
            values=values, base=base, overlay=overlay, deployment=deployment, variables=defined
        )
        asked = (rule for rule in RULES if rule.overlay or not overlay)
        verdicts += (verdict_of(rule.name, name, rule.wrong, project) for rule in asked)
        base = values
    return tuple(verdicts)


def _services_of(files: Mapping[str, BundleFile], name: str) -> dict[str, Any]:
    """Return a project with services that rules can be asked about."""
    if name not in files:
        raise DeployError("there is no such file")
    values: Any = Document(files[name].text, name).value
    services = values.get("services") if isinstance(values, dict) else None
    if not isinstance(services, dict) or not all(
        isinstance(service, dict) for service in services.values()
    ):
        raise DeployError("services: allowed is a mapping of services, each a mapping")
    return dict(values)


def _by_schema(values: Any) -> Iterator[str]:
    try:
        schemas = importlib.import_module(f"{_LIBRARY}.builtin_schemas")
        validators = importlib.import_module("jsonschema.validators")
    except ImportError as error:
        raise MissingProgramError(_LIBRARY.replace("_", "-")) from error
    for wrong in _validator(schemas, validators).iter_errors(values):
        yield f"{wrong.json_path.removeprefix('$.')}: {wrong.message}"


@cache
def _validator(schemas: Any, validators: Any) -> Any:
    """Return what checks Compose files, made once: a fleet has many."""
    schema = schemas.get_builtin_schema("vendor.compose-spec")
    return validators.validator_for(schema)(schema)
