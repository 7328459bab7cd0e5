"""A machine as text for a terminal: what was found, from what, and why it was chosen or not."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.deploy.hardware.codecs import CodecFound
    from sfglab.deploy.hardware.machine import DeviceGroup, Evidence, Machine


def render_machine(machine: Machine, codecs: Sequence[CodecFound] | None = None) -> str:
    """Return a report of a machine.

    Args:
        machine: The machine.
        codecs: What `codecs_found` found; None leaves them out.
    """
    lines = [*_head(machine), "", "Accelerators, in order of preference:"]
    for item in machine.evidence:
        lines += _evidence(item)
    if codecs is not None:
        lines += ["", *_codecs(codecs)]
    return "\n".join(lines) + "\n"


def _head(machine: Machine) -> Iterator[str]:
    architecture = f"{machine.architecture.value}, " if machine.architecture else ""
    rows = {
        "Model": machine.model,
        "Operating system": machine.operating_system,
        "Architecture": f"{architecture}{machine.architecture_reason}",
        "JetPack": str(machine.jetpack) if machine.jetpack else "",
        "Accelerator": machine.accelerator.value,
        "Devices": ", ".join(machine.devices) or "none needed",
        "Groups": ", ".join(map(_group, machine.groups)) or "none needed",
    }
    yield from (f"{title + ':':18}{text}" for title, text in rows.items() if text)


def _group(group: DeviceGroup) -> str:
    return f"{group.name} ({group.gid if group.gid is not None else 'not in /etc/group'})"


def _evidence(item: Evidence) -> Iterator[str]:
    found = "found" if item.found else "not found"
    yield f"{'*' if item.chosen else ' '} {item.accelerator.value:7} {found}: {item.reason}"
    if item.found:
        yield f"{'':10}{item.verdict}"
    for source in item.sources:
        yield f"{'':10}- {source}"


def _codecs(codecs: Sequence[CodecFound]) -> Iterator[str]:
    yield "H.264 codecs, as PyAV opens them in this process:"
    yield f"  {'name':14} {'role':8} {'expected':8} {'opens':6} tried; why"
    for codec in codecs:
        expected, works = ("yes" if flag else "no" for flag in (codec.expected, codec.works))
        yield f"  {codec.name:14} {codec.role.value:8} {expected:8} {works:6} {codec.tried}; {codec.why}"
