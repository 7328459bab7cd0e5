"""Addresses over Zenoh: places become endpoints, and what cannot work is refused before anything starts."""

import json
import re

import pytest

from sfglab.bus.zenoh.address import ZenohAddress, endpoint
from sfglab.bus.zenoh.session import ZenohConfig
from sfglab.component import argument_of, config_from_argument
from sfglab.errors import InvalidValueError
from sfglab.fleet.hub import hub_config


@pytest.mark.parametrize(
    ("place", "secure", "expected"),
    [
        ("hub.local", False, "tcp/hub.local:7447"),
        ("10.0.0.1:7000", False, "tcp/10.0.0.1:7000"),
        ("[fe80::1%wlan0]:7000", False, "tcp/[fe80::1%wlan0]:7000"),
        (":7000", False, "tcp/[::]:7000"),
        ("", False, "tcp/[::]:7447"),
        ("tcp/hub", False, "tcp/hub:7447"),
        ("hub", True, "quic/hub:7447"),
        ("tls/hub:1", True, "tls/hub:1"),
    ],
)
def test_a_place_becomes_an_endpoint_of_tcp_or_with_certificates_of_quic(place, secure, expected):
    assert endpoint(place, secure=secure) == expected


@pytest.mark.parametrize(
    ("place", "secure", "words"),
    [
        (
            "udp/hub",
            False,
            "link of 'udp/hub': given 'udp', allowed: tcp without certificates; udp loses",
        ),
        ("udp/hub", True, "allowed: quic and tls with certificates; udp loses samples"),
        ("quic/hub", False, "given 'quic', allowed: tcp without certificates"),
        ("tcp/hub", True, "given 'tcp', allowed: quic and tls with certificates"),
        ("hub:70000", False, "place: given 'hub:70000', allowed: HOST, HOST:PORT or :PORT"),
        ("hub:0", False, "place: given 'hub:0', allowed: HOST, HOST:PORT or :PORT"),
        ("a b", False, "given 'a b', allowed: HOST"),
        ("hub#iface=x", False, "given 'hub#iface=x', allowed: HOST"),
    ],
)
def test_links_that_lose_samples_or_hide_nothing_are_refused(place, secure, words):
    with pytest.raises(InvalidValueError, match=re.escape(words)):
        endpoint(place, secure=secure)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"hubs": ("a", "b", "c")}, "hubs and peers: given 'a, b, c', allowed: one or two hubs"),
        ({"hubs": ("a",), "peers": (":1",)}, "given 'a, :1', allowed: one or two hubs, or peers"),
        ({"hubs": ("",)}, "Zenoh, place to connect to: given '', allowed: HOST or HOST:PORT"),
        ({"hubs": (":7448",)}, "place to connect to: given ':7448', allowed: HOST or HOST:PORT"),
        ({"peers": ("",)}, "place to connect to: given '', allowed: HOST or HOST:PORT"),
        ({"hubs": ("udp/a",)}, "udp loses samples"),
        ({"hubs": ("a",), "domain_id": 233}, "233"),
    ],
)
def test_an_address_has_up_to_two_hubs_or_peers(given, words):
    with pytest.raises(ValueError, match=re.escape(words)):
        ZenohAddress(**{"hubs": (), **given})


def test_agents_are_clients_of_hubs_or_peers_that_listen_and_hubs_are_routers():
    hubs = ZenohAddress(domain_id=3, hubs=("a", "b:1")).config()
    assert hubs == ZenohConfig(domain_id=3, connect=("tcp/a:7447", "tcp/b:1"))
    first = ZenohAddress(hubs=()).config()
    assert first == ZenohConfig(mode="peer", connect=(), listen=("tcp/[::]:7447",))
    peers = ZenohAddress(hubs=(), peers=("a", ":1")).config()
    assert peers == ZenohConfig(mode="peer", connect=("tcp/a:7447",), listen=("tcp/[::]:1",))
    hub = hub_config(":9", ["a"])
    assert hub == ZenohConfig(mode="router", connect=("tcp/a:7447",), listen=("tcp/[::]:9",))


def test_a_hub_joins_only_hubs_with_a_host():
    with pytest.raises(InvalidValueError, match="place to connect to: given ':7448'"):
        hub_config(hubs=[":7448"])


def test_an_address_travels_to_a_process():
    given = ZenohAddress(hubs=("a",), certificates="/etc/c", name="go2")
    assert config_from_argument(ZenohAddress, argument_of(given)) == given


def test_links_between_robots_have_no_shared_memory_no_multicast_and_a_lease_of_10_s():
    settings = json.loads(ZenohAddress(hubs=("a",)).config().json("1"))
    assert settings["transport"]["shared_memory"] == {"enabled": False}
    assert settings["scouting"]["multicast"] == {"enabled": False}
    assert settings["transport"]["link"] == {"tx": {"lease": 10_000}}


def test_certificates_are_those_of_the_agent_or_the_hub_and_both_sides_show_one(tmp_path):
    for name in ("ca.pem", "go2.pem", "go2.key"):
        (tmp_path / name).write_text("")
    address = ZenohAddress(hubs=("a",), certificates=str(tmp_path), name="go2")
    tls = json.loads(address.config().json("1"))["transport"]["link"]["tls"]
    key, own = str(tmp_path / "go2.key"), str(tmp_path / "go2.pem")
    assert tls == {
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "root_ca_certificate": str(tmp_path / "ca.pem"),
        **dict.fromkeys(("connect_certificate", "listen_certificate"), own),
        **dict.fromkeys(("connect_private_key", "listen_private_key"), key),
    }
    hub = hub_config(certificates=str(tmp_path))
    assert hub.listen == ("quic/[::]:7447", "tls/[::]:7447")
    assert hub.certificate == str(tmp_path / "hub.pem")
