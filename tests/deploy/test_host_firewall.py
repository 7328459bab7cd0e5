"""The firewall on a live machine: a host, its agent's container and another host."""

import shutil
import subprocess
import sys

import pytest
from esslingen import GO2, deployed

from sfglab.deploy.host import firewall_rules
from sfglab.fleet.fleet_file import ContainerNetwork
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
    """Run commands on a host; return what the last one prints."""
    for command in commands:
        done = host.run(command.split(), 60, input=text)
        assert done.returncode == 0, done.stderr
    return done.stdout


def load(host, rules):
    run(host, "nft -f -", text=rules)


@pytest.fixture
def lab():
    """A host that another one meets at its global interface, and a container at its agent's bridge."""
    with Network(grace_s=0.2) as network:
        hosts = [network.add_host(name) for name in ("host", "other", "container")]
        host, other, container = hosts
        commands = (
            "ip link set eth0 down",
            f"ip link set eth0 name {GO2.agent.global_interface}",
            f"ip link set {GO2.agent.global_interface} up",
            f"ip link add {GO2.bridge} type bridge",
            f"ip link set {GO2.bridge} up",
            f"ip addr add {HOST_IN_BRIDGE}/24 dev {GO2.bridge}",
            f"ip link add port0 type veth peer name inside netns {container._holder}",
            f"ip link set port0 master {GO2.bridge}",
            "ip link set port0 up",
            "tee /proc/sys/net/ipv4/ip_forward",
        )
        run(host, *commands, text="1")
        commands = (
            "ip link set eth0 down",
            "ip link set inside up",
            f"ip addr add {CONTAINER}/24 dev inside",
            f"ip route add default via {HOST_IN_BRIDGE}",
        )
        run(container, *commands)
        run(other, f"ip route add default via {host.address}")
        yield hosts


def heard(sender, receiver, address, *ports):
    """Send to ports in order, then to one that is always heard; return which of the former were."""
    command = [sys.executable, "-c", LISTEN, *map(str, (*ports, FREE_PORT))]
    with receiver.popen(command, stdout=subprocess.PIPE, text=True) as listener:
        assert listener.stdout.readline() == "ready\n"
        send(sender, address, *ports, FREE_PORT)
        said = {int(port) for port in listener.stdout.read().split()}
    assert FREE_PORT in said
    return said - {FREE_PORT}


def send(sender, address, *ports):
    sender.run([sys.executable, "-c", SEND, address, *map(str, ports)], 60, check=True)


def test_the_own_domain_is_heard_neither_from_outside_nor_outside_and_the_global_one_is(lab):
    host, other, container = lab
    ports = {OWN_PORT, GLOBAL_PORT}
    ways = ((other, host, host.address), (host, other, other.address))
    for way in ways:
        assert heard(*way, *ports) == ports
    load(host, firewall_rules(GO2))
    for way in ways:
        assert heard(*way, *ports) == {GLOBAL_PORT}
    assert heard(container, host, HOST_IN_BRIDGE, *ports) == ports


def test_the_container_has_no_way_out_and_nobody_a_way_in(lab):
    host, other, container = lab
    out, into = (container, other, other.address), (other, container, CONTAINER)
    for way in (out, into):
        assert heard(*way, OWN_PORT) == {OWN_PORT}
    load(host, firewall_rules(GO2))
    for comment, (sender, _, address) in {"no way out": out, "no way in": into}.items():
        for count in (0, 1):
            counter = f'packets {count} bytes {29 * count} drop comment "{comment}"'
            assert counter in run(host, "nft list ruleset")
            send(sender, address, FREE_PORT)


def test_loading_again_changes_nothing_and_no_other_table_is_touched(lab):
    host = lab[0]
    load(host, MINE)
    before = run(host, "nft list ruleset")
    on_host = deployed(host={"network": ContainerNetwork.HOST})
    without = deployed(agent={"global_interface": None})
    for deployment in (GO2, GO2, deployed("pi1"), on_host, without, GO2):
        load(host, firewall_rules(deployment))
    rules = run(host, "nft list ruleset")
    assert before in rules
    for agent in ("go2", "pi1"):
        assert rules.count(f"table inet sfglab_{agent}") == 1
        run(host, f"nft delete table inet sfglab_{agent}")
    assert run(host, "nft list ruleset") == before
