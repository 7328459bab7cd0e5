"""Demand follows the graph: who subscribes to what, by which transport."""

from __future__ import annotations

from sfglab.bus.api import EndpointAdded, EndpointInfo, EndpointKind, EndpointRemoved
from sfglab.fleet.decoder.streams import Demand
from sfglab.qos import SENSOR_DATA

TOPIC = "/local/go2/camera_front/color/image_raw"


def endpoint(gid: int, transport: str = "shm", kind: EndpointKind = EndpointKind.SUBSCRIPTION) -> EndpointInfo:
    return EndpointInfo(
        kind=kind,
        topic=TOPIC,
        type="sensor_msgs/msg/Image",
        gid=bytes([gid]) * 16,
        qos=SENSOR_DATA,
        transport=transport,
    )


def test_subscriptions_are_counted_by_topic_and_transport():
    demand = Demand()
    assert demand.feed(EndpointAdded(endpoint=endpoint(1))) == TOPIC
    demand.feed(EndpointAdded(endpoint=endpoint(2, "dds")))
    demand.feed(EndpointAdded(endpoint=endpoint(3)))
    assert demand.count(TOPIC) == 3
    assert demand.transports(TOPIC) == {"shm", "dds"}
    demand.feed(EndpointRemoved(endpoint=endpoint(2, "dds")))
    assert demand.transports(TOPIC) == {"shm"}


def test_an_endpoint_announced_twice_counts_once_and_unknown_removals_change_nothing():
    demand = Demand()
    demand.feed(EndpointRemoved(endpoint=endpoint(9)))
    demand.feed(EndpointAdded(endpoint=endpoint(1)))
    demand.feed(EndpointAdded(endpoint=endpoint(1)))
    assert demand.count(TOPIC) == 1
    demand.feed(EndpointRemoved(endpoint=endpoint(1)))
    assert demand.transports(TOPIC) == frozenset()
    assert demand.count("/elsewhere") == 0


def test_publishers_are_no_demand():
    demand = Demand()
    assert demand.feed(EndpointAdded(endpoint=endpoint(1, kind=EndpointKind.PUBLISHER))) is None
    assert demand.count(TOPIC) == 0
