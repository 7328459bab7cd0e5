"""DDS finds its peers and delivers between test hosts, by multicast discovery as on a real network."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from sfglab.lab.hosts import Network

pytestmark = [pytest.mark.netns, pytest.mark.live]
TIMEOUT_S = 60
CONFIG = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='eth0'/></Interfaces>"
    "</General></Domain></CycloneDDS>"
)
ENVIRONMENT = os.environ | {"CYCLONEDDS_URI": CONFIG}

TYPE = """
import sys
from dataclasses import dataclass
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.core import InstanceState, ReadCondition, SampleState, ViewState, WaitSet
from cyclonedds.qos import Policy, Qos
from cyclonedds.topic import Topic
from cyclonedds.util import duration

@dataclass
class Note(IdlStruct, typename="sfglab_test.Note"):
    number: int
    text: str

participant = DomainParticipant(7)
qos = Qos(Policy.Reliability.Reliable(duration(seconds=5)), Policy.Durability.TransientLocal,
          Policy.DurabilityService(0, Policy.History.KeepAll, -1, -1, -1), Policy.History.KeepAll)
topic = Topic(participant, "notes", Note, qos=qos)
"""
WRITER = (
    TYPE
    + """
from cyclonedds.pub import DataWriter
writer = DataWriter(participant, topic, qos=qos)
for number in range(20):
    writer.write(Note(number, sys.argv[1]))
print("ready", flush=True)
input()
"""
)
READER = (
    TYPE
    + """
from cyclonedds.sub import DataReader
reader = DataReader(participant, topic, qos=qos)
condition = ReadCondition(reader, SampleState.Any | ViewState.Any | InstanceState.Any)
waitset = WaitSet(participant)
waitset.attach(condition)
seen = []
while len(seen) < 20 and waitset.wait(duration(seconds=10)):
    seen += reader.take(N=20)
print(*sorted({(note.number, note.text) for note in seen}))
"""
)


@pytest.fixture(scope="module")
def network():
    with Network() as net:
        for name in ("edge", "station"):
            net.add_host(name)
        yield net


@pytest.mark.parametrize("loss", [None, 0.1])
def test_a_reliable_writer_reaches_a_reader_on_another_host(network, loss):
    edge, station = network.hosts["edge"], network.hosts["station"]
    network.set_link("station", loss=loss)
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with edge.popen([sys.executable, "-c", WRITER, "hello"], env=ENVIRONMENT, text=True, **pipes) as writer:
        assert writer.stdout.readline() == "ready\n"
        done = station.run([sys.executable, "-c", READER], TIMEOUT_S, env=ENVIRONMENT)
        writer.communicate("\n", timeout=TIMEOUT_S)
    assert done.stdout.strip() == " ".join(str((number, "hello")) for number in range(20)), done.stderr
    assert station.interface_bytes().rx_bytes > 20 * 40
