"""A node of pyzeros: it repeats what it hears, serves, and calls when it is told to; with a router's endpoint."""

import asyncio
import json
import sys

import zenoh
from asyncio_for_robotics import Scope
from pyzeros.node import Node
from ros2_pyterfaces.cydr.all_msgs import String
from ros2_pyterfaces.cydr.all_srvs import SetBool


async def main(place):
    settings = {
        "mode": "client",
        "connect": {"endpoints": [place]},
        "scouting": {"multicast": {"enabled": False}},
        "transport": {"shared_memory": {"enabled": False}},
    }
    session = zenoh.open(zenoh.Config.from_json5(json.dumps(settings)))
    async with Scope():
        node = Node("peer", session, 0, "/there")
        said = node.create_publisher(String, "/from_peer")
        heard = node.create_subscriber(String, "/to_peer")
        server = node.create_service(SetBool, "/peer_serves")
        client = node.create_client(SetBool, "/we_serve")
        await asyncio.gather(repeat(heard, said, client), serve(server))


async def repeat(heard, said, client):
    async for message in heard.listen_reliable():
        text = message.data  # bytes, as all strings of pyzeros
        if text == b"call":
            response = await client.call_async(SetBool.Request(data=True))
            text = b"%d %s" % (response.success, response.message)
        said.publish(String(data=b"peer: " + text))


async def serve(server):
    async for asked in server.listen_reliable():
        asked.response.success = not asked.request.data
        asked.response.message = b"peer"
        asked.send()


asyncio.run(main(sys.argv[1]))
