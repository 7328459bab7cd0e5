"""The module `exports` exports a planned QoS as files that DDS and ROS 2 read: `EXPORTS` has the formats by name.

The file for Fast DDS has one writer profile and one reader profile per topic. The elements of the file are those of
Fast DDS' schemas (`resources/xsd/fastRTPS_profiles.xsd` of generation 2, ROS 2 Humble and Jazzy;
`fastdds_profiles.xsd` of generation 3, from Kilted, which renamed the times). The name of an endpoint's topic selects
the profile of the endpoint; rmw_fastrtps's README describes the selection, and when rmw_fastrtps uses the XML file.

The XML file of Cyclone DDS configures domains, not endpoints (docs/manual/options.md). The file has
heartbeats and delays, but neither depths nor deadlines. Depths and deadlines go into the ROS 2 parameter file,
which the nodes of both vendors read. Names and types of parameters are those that rclcpp (`detail/qos_parameters.hpp`)
and rclpy (`qos_overriding_options.py`) declare. Durations are whole nanoseconds.
"""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

from sfglab.errors import InvalidValueError
from sfglab.rtps import CYCLONE_DDS, FAST_DDS
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from sfglab.arp.plan import Plan, TopicPlan
    from sfglab.qos import QoSProfile
    from sfglab.rtps import Vendor


def _summary(plan: Plan) -> str:
    return (
        f"QoS by sfglab (method {plan.method}) for {len(plan.topics)} topics on {plan.medium.rate_bps / 1e6:g} "
        f"Mbit/s with {100 * plan.medium.loss:g} % loss, {plan.vendor.name}: {100 * plan.utilisation:.0f} % of "
        "the medium's time is planned."
    )


def _rate_text(part: TopicPlan) -> str:
    """Return how often the node of a topic works; with a local cache the rate is the rate of readings."""
    passed = ", of which a local cache lets changes pass" if part.topic.cached else ""
    return f"{part.rate_hz:.4g} Hz{passed}"


def _new_comment(text: str) -> Any:
    """Return an XML comment without two hyphens in a row, which XML forbids in comments."""
    return ET.Comment(f" {re.sub('-(?=-)', '- ', text)} ")


def _fill(parent: ET.Element, values: Mapping[str, Any]) -> None:
    """Add an element for each value: a mapping's element has an element per value, any other element has a text."""
    for name, value in values.items():
        element = ET.SubElement(parent, name)
        if isinstance(value, dict):
            _fill(element, value)
        else:
            element.text = str(value)


def _render(root: ET.Element) -> str:
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'


class Generation(NamedTuple):
    """A `Generation` has the names of elements in the profiles of one generation of Fast DDS."""

    namespace: str  #: Namespace of all elements.
    heartbeat: str  #: Element with the period of heartbeats.
    response: str  #: Element with the writer's delay before a retransmission.
    delay: str  #: Element with the reader's delay before a response.


GENERATION_2 = Generation(
    "http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles",
    "heartbeatPeriod",
    "nackResponseDelay",
    "heartbeatResponseDelay",
)
GENERATION_3 = Generation(
    "http://www.eprosima.com", "heartbeat_period", "nack_response_delay", "heartbeat_response_delay"
)
#: Default limit of samples per instance before Fast DDS 3.5; a deeper history must raise this limit.
_SAMPLES_PER_INSTANCE = 400

_FAST_HOW = (
    "Set RMW_IMPLEMENTATION=rmw_fastrtps_cpp, RMW_FASTRTPS_USE_QOS_FROM_XML=1, and "
    "FASTRTPS_DEFAULT_PROFILES_FILE (FASTDDS_DEFAULT_PROFILES_FILE from generation 3) to this file. "
    "Reliability, durability, history and deadline count only where a node leaves them to SYSTEM_DEFAULT; else "
    "use the ROS 2 parameter file for them. No DDS QoS sets a rate: each topic's is in its comment, for the "
    "node's timer."
)


def fast_dds_xml(plan: Plan, generation: Generation = GENERATION_2) -> str:
    """Return a plan with the timing of Fast DDS as an XML file of profiles for a generation of Fast DDS."""
    vendor = plan.vendor
    writer_times = {
        generation.heartbeat: vendor.heartbeat_ns,
        generation.response: vendor.nack_response_ns,
    }
    reader_times = {generation.delay: vendor.nack_delay_ns}
    root = ET.Element("dds", xmlns=generation.namespace)
    root.append(_new_comment(_summary(plan)))
    root.append(_new_comment(_FAST_HOW))
    if vendor.piggyback_bytes:
        mode = "ASYNCHRONOUS" if vendor.asynchronous else "SYNCHRONOUS"
        root.append(_new_comment(f"Planned for RMW_FASTRTPS_PUBLICATION_MODE={mode}: set it, too."))
    profiles = ET.SubElement(root, "profiles")
    for part in plan.topics:
        name = part.topic.name
        profiles.append(_new_comment(f"{name}: {_rate_text(part)}"))
        for kind, times in (("data_writer", writer_times), ("data_reader", reader_times)):
            _fill(ET.SubElement(profiles, kind, profile_name=name), _profile(part, times))
    return _render(root)


def _profile(part: TopicPlan, times: Mapping[str, int]) -> dict[str, Any]:
    """Return the elements of a topic's writer or reader with the given times, ns."""
    qos = part.qos
    topic: dict[str, Any] = {"historyQos": {"kind": qos.history.name, "depth": part.depth}}
    if part.depth > _SAMPLES_PER_INSTANCE:
        topic["resourceLimitsQos"] = {
            "max_samples": part.depth,
            "max_instances": 1,
            "max_samples_per_instance": part.depth,
        }
    policies: dict[str, Any] = {}
    if qos.deadline_ns is not None:
        policies["deadline"] = {"period": _seconds(qos.deadline_ns)}
    policies["durability"] = {"kind": qos.durability.name}
    policies["reliability"] = {"kind": qos.reliability.name}
    profile = {"topic": topic, "qos": policies}
    if part.topic.reliable:
        profile["times"] = {name: _seconds(time_ns) for name, time_ns in times.items()}
    # Fast DDS's default would refuse messages that grow, such as texts; the written profile therefore has
    # rmw_fastrtps's own choice.
    return {**profile, "historyMemoryPolicy": "PREALLOCATED_WITH_REALLOC"}


def _seconds(duration_ns: int) -> dict[str, int]:
    seconds, nanoseconds = divmod(duration_ns, NS_PER_S)
    return {"sec": seconds, "nanosec": nanoseconds}


_NAMESPACE = "https://cdds.io/config"
# These are Cyclone's defaults. The model of the link does not include them.
_LEAST_NS = 5_000_000  #: HeartbeatInterval's `min`, ns.
_SCHEDULED_LEAST_NS = 20_000_000  #: HeartbeatInterval's `minsched`, ns.
_LONGEST_NS = 8_000_000_000  #: HeartbeatInterval's `max`, ns.

_CYCLONE_HOW = (
    "Set RMW_IMPLEMENTATION=rmw_cyclonedds_cpp and CYCLONEDDS_URI to this file. It contains timing only: this "
    "configuration has no QoS of single topics, so reliability, history, depth and deadline come from the "
    "ROS 2 parameter file, and rates from the nodes' timers."
)


def cyclone_xml(plan: Plan) -> str:
    """Return the timing of a plan as a configuration file for Cyclone DDS."""
    vendor = plan.vendor
    root = ET.Element("CycloneDDS", xmlns=_NAMESPACE)
    root.append(_new_comment(_summary(plan)))
    root.append(_new_comment(_CYCLONE_HOW))
    domain = ET.SubElement(root, "Domain", Id="any")
    internal = ET.SubElement(domain, "Internal")
    interval = ET.SubElement(
        internal,
        "HeartbeatInterval",
        min=_duration(min(_LEAST_NS, vendor.heartbeat_ns)),
        minsched=_duration(min(_SCHEDULED_LEAST_NS, vendor.heartbeat_ns)),
        max=_duration(max(_LONGEST_NS, vendor.heartbeat_ns)),
    )
    interval.text = _duration(vendor.heartbeat_ns)
    delays = {
        "NackDelay": _duration(vendor.nack_delay_ns),
        "AckDelay": _duration(vendor.ack_delay_ns),
    }
    _fill(internal, delays)
    return _render(root)


def _duration(duration_ns: int) -> str:
    return f"{duration_ns / 1e6:g} ms"


_ROS2_HOW = """\
# Use: ros2 run PACKAGE NODE --ros-args --params-file THIS_FILE
# A node takes an override only if it allows it where it creates the publisher or subscription
# (QosOverridingOptions; with_default_policies() allows history, depth and reliability, so deadline and
# durability must be named), and only as it starts. Rates are no QoS; for the nodes' timers:
"""


def ros2_parameters(plan: Plan) -> str:
    """Return a plan, of either vendor, as a ROS 2 parameter file."""
    import yaml

    overrides = {
        part.topic.name: {"publisher": _policies(part.qos), "subscription": _policies(part.qos)}
        for part in plan.topics
    }
    rates = "".join(f"#   {part.topic.name}: {_rate_text(part)}\n" for part in plan.topics)
    content = {"/**": {"ros__parameters": {"qos_overrides": overrides}}}
    # YAML would write one mapping for both sides once, with an anchor; rcl's parser does not support anchors.
    body = yaml.safe_dump(content, sort_keys=False)
    return f"# {_summary(plan)}\n{_ROS2_HOW}{rates}{body}"


def _policies(qos: QoSProfile) -> dict[str, str | int]:
    policies: dict[str, str | int] = {
        "reliability": qos.reliability.value,
        "durability": qos.durability.value,
        "history": qos.history.value,
        "depth": qos.depth,
    }
    if qos.deadline_ns is not None:
        policies["deadline"] = qos.deadline_ns
    return policies


class Export(NamedTuple):
    """An `Export` is one format of a file."""

    file: str  #: Usual name of the file.
    #: Function that returns the file's text for a plan of this vendor.
    render: Callable[[Plan], str]
    #: Beginning of the name of the vendor whose timing the plan must have; all presets of a vendor begin with it.
    vendor: str

    def suits(self, vendor: Vendor) -> bool:
        """Return whether the format has keys for the timing of a vendor."""
        return vendor.name.startswith(self.vendor)

    def text(self, plan: Plan) -> str:
        """Return a plan as the file's text.

        Raises:
            InvalidValueError: The plan has the timing of another vendor.
        """
        if not self.suits(plan.vendor):
            allowed = f"a plan with the timing of {self.vendor}"
            raise InvalidValueError(self.file, plan.vendor.name, allowed)
        return self.render(plan)


EXPORTS = {
    "fastdds": Export("fastdds.xml", fast_dds_xml, FAST_DDS.name),
    "fastdds3": Export(
        "fastdds3.xml", partial(fast_dds_xml, generation=GENERATION_3), FAST_DDS.name
    ),
    "cyclone": Export("cyclonedds.xml", cyclone_xml, CYCLONE_DDS.name),
    "ros2": Export("qos_overrides.yaml", ros2_parameters, ""),
}
"""Formats by their names on the command line."""
