"""The firewall on a live machine: a host, its agent's container and another host, each a network namespace."""

import contextlib
import os
import shutil
import subprocess
import sys
from dataclasses import replace

import pytest
from esslingen import FLEET, GO2

from sfglab.deploy.host import firewall_rules

MISSING = [tool for tool in ("nft", "ip", "unshare", "nsenter") if not shutil.which(tool)]
pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(bool(MISSING), reason=f"{', '.join(MISSING)} missing: install nftables, iproute2"),
    pytest.mark.skipif(os.geteuid() != 0, reason="network namespaces and nft need root"),
]

GLOBAL_PORT, OWN_PORT, FREE_PORT = 7410, 7660, 9000
HOST, OTHER, CONTAINER, HOST_IN_BRIDGE = "10.1.0.1", "10.1.0.2", "10.2.0.2", "10.2.0.1"
LISTEN = """
import select, socket, sys
ports = [int(port) for port in sys.argv[1:]]
sockets = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in ports]
for port, each in zip(ports, sockets):
    each.bind(("0.0.0.0", port))
print("ready", flush=True)
heard = set()
while ports[-1] not in heard and (ready := select.select(sockets, [], [], 5.0)[0]):
    heard.update(each.getsockname()[1] for each in ready if each.recv(9))
print(*sorted(heard))
"""
SEND = """
import socket, sys
sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
for port in sys.argv[2:]:
    try:
        sender.sendto(b"x", (sys.argv[1], int(port)))
    except PermissionError:
        pass
"""
MINE = (
    "table inet mine { chain input { type filter hook input priority 5; policy accept; udp dport 1 drop; }; }"
)


class Namespace:
    """A network namespace that lives as long as a process that only waits."""

    def __init__(self, stack):
        self.holder = subprocess.Popen(
            ["unshare", "--net", "cat"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        stack.callback(self.holder.communicate)
        # What is written comes back once the process is in its namespace.
        self.holder.stdin.write(b"\n")
        self.holder.stdin.flush()
        self.holder.stdout.readline()

    def command(self, *words):
        return ["nsenter", f"--net=/proc/{self.holder.pid}/ns/net", *words]

    def run(self, *words, text=None):
        done = subprocess.run(self.command(*words), input=text, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return done.stdout


class Lab:
    def __init__(self, stack, plan):
        self.host, self.other, self.container = (Namespace(stack) for _ in range(3))
        self.join(plan.global_interface, self.other, HOST, OTHER)
        self.host.run("ip", "link", "add", plan.bridge, "type", "bridge")
        self.host.run("ip", "link", "set", plan.bridge, "up")
        self.host.run("ip", "addr", "add", f"{HOST_IN_BRIDGE}/24", "dev", plan.bridge)
        self.join("port0", self.container, None, CONTAINER)
        self.host.run("ip", "link", "set", "port0", "master", plan.bridge)
        self.other.run("ip", "route", "add", "default", "via", HOST)
        self.container.run("ip", "route", "add", "default", "via", HOST_IN_BRIDGE)
        self.host.run("sh", "-c", "echo 1 >/proc/sys/net/ipv4/ip_forward")

    def join(self, name, peer, here, there):
        pid = str(peer.holder.pid)
        self.host.run("ip", "link", "add", name, "type", "veth", "peer", "name", "eth0", "netns", pid)
        for space, device, address in ((self.host, name, here), (peer, "eth0", there)):
            space.run("ip", "link", "set", device, "up")
            if address:
                space.run("ip", "addr", "add", f"{address}/24", "dev", device)

    def load(self, rules):
        self.host.run("nft", "-f", "-", text=rules)

    def rules(self):
        return self.host.run("nft", "-s", "list", "ruleset")


@pytest.fixture
def lab():
    with contextlib.ExitStack() as stack:
        yield Lab(stack, GO2.network)


def heard(sender, receiver, address, *ports, last):
    """Send to ports in order, then to one that is always heard; return which of the former were."""
    command = receiver.command(sys.executable, "-c", LISTEN, *map(str, (*ports, last)))
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout.readline() == "ready\n"
        sender.run(sys.executable, "-c", SEND, address, *map(str, (*ports, last)))
        said = {int(port) for port in listener.stdout.read().split()}
    assert last in said
    return said - {last}


def test_the_own_domain_is_heard_neither_from_outside_nor_outside_and_the_global_one_is(lab):
    ports = (OWN_PORT, GLOBAL_PORT)
    assert heard(lab.other, lab.host, HOST, *ports, last=FREE_PORT) == set(ports)
    assert heard(lab.host, lab.other, OTHER, *ports, last=FREE_PORT) == set(ports)
    lab.load(firewall_rules(GO2))
    assert heard(lab.other, lab.host, HOST, *ports, last=FREE_PORT) == {GLOBAL_PORT}
    assert heard(lab.host, lab.other, OTHER, *ports, last=FREE_PORT) == {GLOBAL_PORT}
    assert heard(lab.container, lab.host, HOST_IN_BRIDGE, *ports, last=FREE_PORT) == set(ports)


def test_the_container_has_no_way_out_and_nobody_a_way_in(lab):
    ways = {"no way out": (lab.container, lab.other, OTHER), "no way in": (lab.other, lab.container, CONTAINER)}
    for way in ways.values():
        assert heard(*way, OWN_PORT, last=FREE_PORT) == {OWN_PORT}
    lab.load(firewall_rules(GO2))
    for comment, (sender, _, address) in ways.items():
        assert f'packets 0 bytes 0 drop comment "{comment}"' in lab.host.run("nft", "list", "ruleset")
        sender.run(sys.executable, "-c", SEND, address, str(FREE_PORT))
        assert f'packets 1 bytes 29 drop comment "{comment}"' in lab.host.run("nft", "list", "ruleset")


def test_loading_again_changes_nothing_and_no_other_table_is_touched(lab):
    lab.load(MINE)
    before = lab.rules()
    for agent in ("go2", "go2", "pi1", "go2"):
        lab.load(firewall_rules(replace(GO2, agent=FLEET.agent(agent))))
    assert before in lab.rules()
    once = lab.rules().count("table inet sfglab_go2")
    assert (once, lab.rules().count("table inet sfglab_pi1")) == (1, 1)
    for agent in ("go2", "pi1"):
        lab.host.run("nft", "delete", "table", "inet", f"sfglab_{agent}")
    assert lab.rules() == before
