"""A planned QoS as Fast DDS XML profiles, one writer and one reader profile a topic.

Elements as in Fast DDS's own schemas: `resources/xsd/fastRTPS_profiles.xsd` of generation 2 (ROS 2 Humble and
Jazzy) and `fastdds_profiles.xsd` of generation 3 (from Kilted), which renamed the times. Which profile an
endpoint takes follows from its topic's name; that, and when the XML counts at all, stands in rmw_fastrtps's
README.
"""

from __future__ import annotations

from typing import TYPE_CHECKING
from xml.etree import ElementTree as ET

from sfglab.arp.exports.document import (
    ExportError,
    child,
    new_comment,
    rate_text,
    render,
    require_vendor,
    summary,
)
from sfglab.rtps import FAST_DDS

if TYPE_CHECKING:
    from sfglab.arp.plan import Plan, TopicPlan
    from sfglab.rtps import Vendor


_NAMESPACES = {2: "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles", 3: "http://www.eprosima.com"}
_TIMES = {
    2: ("heartbeatPeriod", "nackResponseDelay", "heartbeatResponseDelay"),
    3: ("heartbeat_period", "nack_response_delay", "heartbeat_response_delay"),
}
_SAMPLES_PER_INSTANCE = 400
"""Default limit before Fast DDS 3.5; a deeper history must raise it."""

_HOW = (
    "Set RMW_IMPLEMENTATION=rmw_fastrtps_cpp, RMW_FASTRTPS_USE_QOS_FROM_XML=1, and "
    "FASTRTPS_DEFAULT_PROFILES_FILE (FASTDDS_DEFAULT_PROFILES_FILE from generation 3) to this file. "
    "Reliability, durability, history and deadline count only where a node leaves them to SYSTEM_DEFAULT; else "
    "use the ROS 2 parameter file for them. No DDS QoS sets a rate: each topic's is in its comment, for the "
    "node's timer."
)


def fast_dds_xml(plan: Plan, *, generation: int = 2) -> str:
    """Return a plan as Fast DDS XML profiles.

    Args:
        plan: Reckoned with Fast DDS's timing.
        generation: First number of the Fast DDS version, 2 or 3.

    Raises:
        ExportError: The plan was reckoned with another vendor's timing, or the generation is unknown.
    """
    require_vendor(plan, FAST_DDS)
    if generation not in _NAMESPACES:
        raise ExportError(f"Fast DDS generation: given {generation}, allowed are 2 and 3")
    root = ET.Element("dds", xmlns=_NAMESPACES[generation])
    root.append(new_comment(summary(plan)))
    root.append(new_comment(_HOW))
    profiles = ET.SubElement(root, "profiles")
    for part in plan.topics:
        profiles.append(new_comment(f"{part.topic.name}: {rate_text(part)}"))
        _add_profile(profiles, "data_writer", part, _writer_times(plan.vendor, generation))
        _add_profile(profiles, "data_reader", part, _reader_times(plan.vendor, generation))
    return render(root)


def _add_profile(profiles: ET.Element, kind: str, part: TopicPlan, times: dict[str, int]) -> None:
    profile = ET.SubElement(profiles, kind, profile_name=part.topic.name)
    child(profile, "topic/historyQos/kind", part.qos.history.name)
    child(profile, "topic/historyQos/depth", str(part.depth))
    if part.depth > _SAMPLES_PER_INSTANCE:
        for limit, value in (("max_samples", part.depth), ("max_instances", 1)):
            child(profile, f"topic/resourceLimitsQos/{limit}", str(value))
        child(profile, "topic/resourceLimitsQos/max_samples_per_instance", str(part.depth))
    if part.deadline_ns is not None:
        _add_duration(child(profile, "qos/deadline/period"), part.deadline_ns)
    child(profile, "qos/durability/kind", part.qos.durability.name)
    child(profile, "qos/reliability/kind", part.qos.reliability.name)
    if part.topic.reliable:
        for name, duration_ns in times.items():
            _add_duration(child(profile, f"times/{name}"), duration_ns)
    # Fast DDS's default would refuse messages that grow, such as texts; this is rmw_fastrtps's own choice.
    child(profile, "historyMemoryPolicy", "PREALLOCATED_WITH_REALLOC")


def _writer_times(vendor: Vendor, generation: int) -> dict[str, int]:
    heartbeat, response, _ = _TIMES[generation]
    return {heartbeat: vendor.heartbeat_ns, response: vendor.nack_response_ns}


def _reader_times(vendor: Vendor, generation: int) -> dict[str, int]:
    return {_TIMES[generation][2]: vendor.nack_delay_ns}


def _add_duration(parent: ET.Element, duration_ns: int) -> None:
    seconds, nanoseconds = divmod(duration_ns, 1_000_000_000)
    child(parent, "sec", str(seconds))
    child(parent, "nanosec", str(nanoseconds))
