"""The firewall on a live machine: a host, its agent's container and another host."""

import shutil
import subprocess
import sys

import pytest
from esslingen import GO2, deployed

from sfglab.deploy.host import firewall_rules
from sfglab.lab.hosts import Network

pytestmark = [
    pytest.mark.live,
    pytest.mark.netns,
    pytest.mark.skipif(not shutil.which("nft"), reason="nft is missing: install nftables"),
]

GLOBAL_PORT, OWN_PORT, FREE_PORT = 7410, 7660, 9000
MINE = "table inet mine { chain input { type filter hook input priority 5; policy accept; udp dport 1 drop; }; }"
CONTAINER, HOST_IN_BRIDGE = "10.2.0.2", "10.2.0.1"
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


def run(host, *commands, text=None):
    """Run commands on a host; return what the last one says."""
    for command in commands:
        done = host.run(command.split(), 60, input=text)
        assert done.returncode == 0, done.stderr
    return done.stdout


class Lab:
    """A host that another one meets at its global interface, and a container at its agent's bridge."""

    def __init__(self, network, deployment):
        hosts = [network.add_host(name) for name in ("host", "other", "container")]
        self.host, self.other, self.container = hosts
        to_global, bridge = deployment.agent.global_interface, deployment.bridge
        commands = (
            "ip link set eth0 down",
            f"ip link set eth0 name {to_global}",
            f"ip link set {to_global} up",
            f"ip link add {bridge} type bridge",
            f"ip link set {bridge} up",
            f"ip addr add {HOST_IN_BRIDGE}/24 dev {bridge}",
            f"ip link add port0 type veth peer name inside netns {self.container._holder}",
            f"ip link set port0 master {bridge}",
            "ip link set port0 up",
            "tee /proc/sys/net/ipv4/ip_forward",
        )
        run(self.host, *commands, text="1")
        commands = (
            "ip link set eth0 down",
            "ip link set inside up",
            f"ip addr add {CONTAINER}/24 dev inside",
            f"ip route add default via {HOST_IN_BRIDGE}",
        )
        run(self.container, *commands)
        run(self.other, f"ip route add default via {self.host.address}")

    def load(self, rules):
        run(self.host, "nft -f -", text=rules)

    def rules(self):
        return run(self.host, "nft list ruleset")


@pytest.fixture
def lab():
    with Network(grace_s=0.2) as network:
        yield Lab(network, GO2)


def heard(sender, receiver, address, *ports, last):
    """Send to ports in order, then to one that is always heard; return which of the former were."""
    command = [sys.executable, "-c", LISTEN, *map(str, (*ports, last))]
    with receiver.popen(command, stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout.readline() == "ready\n"
        send(sender, address, *ports, last)
        said = {int(port) for port in listener.stdout.read().split()}
    assert last in said
    return said - {last}


def send(sender, address, *ports):
    sender.run([sys.executable, "-c", SEND, address, *map(str, ports)], 60, check=True)


def test_the_own_domain_is_heard_neither_from_outside_nor_outside_and_the_global_one_is(lab):
    ports = (OWN_PORT, GLOBAL_PORT)
    assert heard(lab.other, lab.host, lab.host.address, *ports, last=FREE_PORT) == set(ports)
    assert heard(lab.host, lab.other, lab.other.address, *ports, last=FREE_PORT) == set(ports)
    lab.load(firewall_rules(GO2))
    assert heard(lab.other, lab.host, lab.host.address, *ports, last=FREE_PORT) == {GLOBAL_PORT}
    assert heard(lab.host, lab.other, lab.other.address, *ports, last=FREE_PORT) == {GLOBAL_PORT}
    assert heard(lab.container, lab.host, HOST_IN_BRIDGE, *ports, last=FREE_PORT) == set(ports)


def test_the_container_has_no_way_out_and_nobody_a_way_in(lab):
    out, into = (lab.container, lab.other, lab.other.address), (lab.other, lab.container, CONTAINER)
    ways = {"no way out": out, "no way in": into}
    for way in ways.values():
        assert heard(*way, OWN_PORT, last=FREE_PORT) == {OWN_PORT}
    lab.load(firewall_rules(GO2))
    for comment, (sender, _, address) in ways.items():
        assert f'packets 0 bytes 0 drop comment "{comment}"' in lab.rules()
        send(sender, address, FREE_PORT)
        assert f'packets 1 bytes 29 drop comment "{comment}"' in lab.rules()


def test_loading_again_changes_nothing_and_no_other_table_is_touched(lab):
    lab.load(MINE)
    before = lab.rules()
    for agent in ("go2", "go2", "pi1", "go2"):
        lab.load(firewall_rules(deployed(agent)))
    assert before in lab.rules()
    for agent in ("go2", "pi1"):
        assert lab.rules().count(f"table inet sfglab_{agent}") == 1
        run(lab.host, f"nft delete table inet sfglab_{agent}")
    assert lab.rules() == before
