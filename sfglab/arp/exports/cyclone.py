"""The timing that a plan reckoned with as a Cyclone DDS configuration.

Cyclone's XML configures domains, not endpoints (docs/manual/options.md): heartbeats and delays can be said
there, depths and deadlines cannot. They go into the ROS 2 parameter file.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from sfglab.arp.exports.document import child, new_comment, render, require_vendor, summary
from sfglab.rtps import CYCLONE_DDS

if TYPE_CHECKING:
    from sfglab.arp.plan import Plan


_NAMESPACE = "https://cdds.io/config"
_LEAST_NS = 5_000_000
"""HeartbeatInterval's `min`, Cyclone's default; the model does not reckon with it."""

_SCHEDULED_LEAST_NS = 20_000_000
"""HeartbeatInterval's `minsched`, Cyclone's default."""

_HOW = (
    "Set RMW_IMPLEMENTATION=rmw_cyclonedds_cpp and CYCLONEDDS_URI to this file. Here stands timing only: this "
    "configuration has no QoS of single topics, so reliability, history, depth and deadline come from the "
    "ROS 2 parameter file, and rates from the nodes' timers."
)


def cyclone_xml(plan: Plan) -> str:
    """Return a plan's timing as a Cyclone DDS configuration.

    Args:
        plan: Reckoned with Cyclone DDS's timing.

    Raises:
        ExportError: The plan was reckoned with another vendor's timing.
    """
    require_vendor(plan, CYCLONE_DDS)
    vendor = plan.vendor
    root = ET.Element("CycloneDDS", xmlns=_NAMESPACE)
    root.append(new_comment(summary(plan)))
    root.append(new_comment(_HOW))
    child(root, "Domain", Id="any")
    child(
        root,
        "Domain/Internal/HeartbeatInterval",
        _duration(vendor.heartbeat_ns),
        min=_duration(_LEAST_NS),
        minsched=_duration(min(_SCHEDULED_LEAST_NS, vendor.heartbeat_ns)),
        max=_duration(vendor.heartbeat_max_ns),
    )
    child(root, "Domain/Internal/NackDelay", _duration(vendor.nack_delay_ns))
    child(root, "Domain/Internal/AckDelay", _duration(vendor.ack_delay_ns))
    return render(root)


def _duration(duration_ns: int) -> str:
    return f"{duration_ns / 1e6:g} ms"
