"""Domains that nobody uses, and a decoder between a camera and a viewer in two of them."""

from contextlib import asynccontextmanager
from dataclasses import asdict

import pytest
from cameras import STREAM, Decoder
from waiting import until

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.component import beside
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.decoder.node import run_decoder


@pytest.fixture
def address(domain_id):
    """An address in a domain that nobody uses."""
    return BusAddress(domain_id=domain_id, interface="lo")


@pytest.fixture
def domains(free_domains):
    """Addresses in two domains that nobody uses: the remote streams' and the local subscribers'."""
    remote, local = free_domains(2)
    return BusAddress(domain_id=remote, interface="lo"), BusAddress(domain_id=local, interface="lo")


@pytest.fixture
def serve(domains):
    """A context manager: camera node, viewer node and a decoder that runs between them, as it is told."""

    @asynccontextmanager
    async def serving(streams=(STREAM,), **told):
        remote, local = domains
        config = DecoderConfig(
            remote=remote, local=local, streams=streams, idle_timeout_s=0.05, **told
        )
        decoder = Decoder()
        decoding = run_decoder(config, on_status=decoder.note, on_ready=decoder.is_ready)
        async with (
            Node("camera", **asdict(remote)) as far,
            Node("viewer", **asdict(local)) as near,
            beside(decoding) as (task,),
        ):
            await until(lambda: decoder.ready.is_set() or task.done())
            if task.done():
                task.result()
            yield far, near, decoder

    return serving
