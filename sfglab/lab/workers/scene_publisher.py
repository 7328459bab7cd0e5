"""Publishers of scenes and images, and a sink that receives them: ``python -m sfglab.lab.workers.scene_publisher CONFIG``.

The configuration names one of three roles, each ends with its standard input: ``scene`` sends a log's messages
(``path``), one moment an order; ``camera`` sends one picture at a fixed rate; both in ``domain_id``. ``sink``
takes what is shown at a ``port``, as a viewer does.
"""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from itertools import groupby
from typing import Any

import numpy as np

from sfglab.bus import Node
from sfglab.component import Reporter, claim_standard_output, run, standard_input_lines
from sfglab.messages import default_message, serialize, stamp_from_ns
from sfglab.qos import Durability, QoSProfile
from sfglab.record import LogReader

CAMERA_TOPIC = "/global/go2/camera_front/color/image_rect"
CAMERA_HZ = 30.0
CAMERA_SIZE = (640, 360)

_IMAGE = "sensor_msgs/msg/Image"
_MATCH_S = 60.0
#: Offers whatever a visualizer asks for.
_QOS = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=20)


def picture() -> Any:
    """Return noise, shape (360, 640, 3): nothing on its way can make it smaller."""
    width, height = CAMERA_SIZE
    return np.random.default_rng(0).integers(0, 255, (height, width, 3), np.uint8)


async def _scene(report: Reporter, domain_id: int, path: str) -> None:
    with LogReader(path) as log:
        types = {topic: info.type_name for topic, info in log.topics.items()}
        moments = [list(group) for _, group in groupby(log.messages(), key=lambda m: m.log_time_ns)]
        async with Node("scene", domain_id=domain_id, interface="lo") as node:
            publishers = {t: node.create_publisher(kind, t, _QOS) for t, kind in types.items()}
            for publisher in publishers.values():
                await publisher.wait_for_subscriptions(1, timeout_s=_MATCH_S)
            report({"is": "ready", "moments": len(moments)})
            orders = standard_input_lines()
            for moment in moments:
                await anext(orders)
                for message in moment:
                    publishers[message.topic].publish_raw(message.cdr)
                report({"is": "sent", "topics": [message.topic for message in moment]})
            async for (
                _
            ) in orders:  # the last messages are repaired, if they have to be, until it is over
                pass


async def _camera(report: Reporter, domain_id: int) -> None:
    image, array = default_message(_IMAGE), picture()
    (image.width, image.height), image.encoding, image.step = CAMERA_SIZE, "rgb8", array[0].nbytes
    image.data, image.header.stamp = array.reshape(-1), stamp_from_ns(1)
    cdr = serialize(image)
    async with Node("camera", domain_id=domain_id, interface="lo") as node:
        publisher = node.create_publisher(_IMAGE, CAMERA_TOPIC)
        timer = node.create_timer(1 / CAMERA_HZ, lambda: publisher.publish_raw(cdr))
        report({"is": "ready"})
        async for _ in standard_input_lines():
            pass
        timer.cancel()


def _sink(report: Reporter, port: int) -> None:
    from sfglab.view.rerunning import rerun

    recording = rerun().RecordingStream("sink")
    recording.serve_grpc(grpc_port=port, server_memory_limit="128MB")
    report({"is": "ready"})
    sys.stdin.read()


def main() -> None:
    """Play the role that the configuration names."""
    config = json.loads(sys.argv[1])
    role, report = config.pop("role"), claim_standard_output()
    with suppress(StopAsyncIteration):
        match role:
            case "scene":
                run(_scene(report, **config))
            case "camera":
                run(_camera(report, **config))
            case "sink":
                _sink(report, **config)


if __name__ == "__main__":
    main()
