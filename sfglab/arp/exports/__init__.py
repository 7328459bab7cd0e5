"""A planned QoS as files that DDS and ROS 2 read: `EXPORTS` by the name of the format."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from sfglab.arp.exports.cyclone import cyclone_xml
from sfglab.arp.exports.document import ExportError
from sfglab.arp.exports.fast_dds import fast_dds_xml
from sfglab.arp.exports.ros2 import ros2_parameters

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.arp.plan import Plan

__all__ = ["EXPORTS", "Export", "ExportError", "cyclone_xml", "fast_dds_xml", "ros2_parameters"]


class Export(NamedTuple):
    """One format.

    Attributes:
        file: Usual name of the file.
        render: Returns a plan as the file's text.
    """

    file: str
    render: Callable[[Plan], str]


EXPORTS = {
    "fastdds": Export("fastdds.xml", fast_dds_xml),
    "fastdds3": Export("fastdds3.xml", partial(fast_dds_xml, generation=3)),
    "cyclone": Export("cyclonedds.xml", cyclone_xml),
    "ros2": Export("qos_overrides.yaml", ros2_parameters),
}
"""By the name that the command line uses."""
