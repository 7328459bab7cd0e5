"""Compressed streams are best effort at every end: paper A, section 4.3."""

import asyncio
from contextlib import asynccontextmanager

from cameras import STREAM

from sfglab.bus.address import BusAddress
from sfglab.bus.api import EndpointAdded, EndpointKind
from sfglab.bus.sim import run_simulated
from sfglab.component import beside
from sfglab.fleet.decoder.pipeline import Statistics, run_pipeline
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.fleet.gop_cache import GopCacheNode
from sfglab.lab.workers import camera
from sfglab.names import dds_topic
from sfglab.qos import Durability, Reliability


class Outputs:
    """Local publishers that are not there."""

    def open(self):
        pass


def test_camera_gop_cache_and_decoder_ask_for_best_effort(monkeypatch):
    config = camera.CameraConfig(places=((BusAddress(domain_id=0), STREAM),), encoder="libx264")
    route, _ = routes_of_topic(STREAM)
    seen = []

    def note(event):
        if isinstance(event, EndpointAdded):
            seen.append(event.endpoint)

    async def main(world):
        @asynccontextmanager
        async def opened(*_, **__):
            yield world.node("camera")

        monkeypatch.setattr(camera, "Node", opened)
        observer = world.node("observer")
        for kind in (EndpointKind.PUBLISHER, EndpointKind.SUBSCRIPTION):
            observer.graph.watch(dds_topic(STREAM), kind, note)
        keeper = GopCacheNode(world.node("keeper"), (STREAM,))
        decoding = run_pipeline(
            route, remote=world.node("decoder"), outputs=Outputs(), counts=Statistics()
        )
        async with beside(keeper.run(), decoding, camera.run_camera(config)):
            await asyncio.sleep(2)

    run_simulated(main, seed=1, limit_s=60)
    kinds = [endpoint.kind for endpoint in seen]
    assert kinds.count(EndpointKind.PUBLISHER) == 1, "the camera's"
    assert kinds.count(EndpointKind.SUBSCRIPTION) == 2, "those of GOP cache and decoder"
    for endpoint in seen:
        assert endpoint.qos.reliability is Reliability.BEST_EFFORT
        assert endpoint.qos.durability is Durability.VOLATILE
