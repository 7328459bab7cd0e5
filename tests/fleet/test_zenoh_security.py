"""Agents over hubs with mutual TLS and access control: a fleet works as without them, and impostors are refused."""

import json
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
from contextlib import asynccontextmanager, contextmanager
from dataclasses import replace
from datetime import UTC, date, datetime
from functools import partial
from pathlib import Path

import pytest
import zenoh
from cryptography import x509
from test_agents_zenoh import Hub
from test_agents_zenoh import fleet as fleet_of_processes
from waiting import until

from sfglab.bus import Node
from sfglab.bus.zenoh.backend import ZenohBackend
from sfglab.bus.zenoh.security import ACCESS, AUTHORITY, certificate_fault
from sfglab.bus.zenoh.session import ZenohConfig
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet.access_control import HUB, access_control
from sfglab.fleet.certificates import write_certificates
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.fleet_file import load_fleet, read_fleet
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.node import StatusProvider
from sfglab.messages import default_message, message_type
from sfglab.qos import LATCHED

pytestmark = pytest.mark.zenoh

STRING, FRAMES = "std_msgs/msg/String", "tf2_msgs/msg/TFMessage"
String = message_type(STRING)
LAB = Path(__file__).parents[2] / "data" / "fleets" / "lab.yaml"
HOST = "127.0.0.1"
TWO = "fleet: test\nagents:\n  one: {domain: 1}\n  two: {domain: 2}\n"
THREE = TWO + "  three: {domain: 3}\n"
KEPT = replace(LATCHED, depth=10)


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """Certificates of the fleet, and those of strangers who use the same names."""
    folder = tmp_path_factory.mktemp("keys")
    for owner in ("fleet", "strangers"):
        write_certificates(read_fleet(TWO), folder / owner, [[HOST]])
    return folder


@pytest.fixture(params=["tls", "quic"])
def place(request, free_port):
    return f"{request.param}/{HOST}:{free_port}"


@contextmanager
def opened(config):
    """Open a session as a node does, but without its thread."""
    name = f"{threading.get_ident():x}{id(config):x}"[-31:].lstrip("0")
    with zenoh.open(zenoh.Config.from_json5(config.json(name))) as session:
        yield session


def hub_at(keys, place, connect=()):
    certificate = str(keys / "fleet" / "hub.pem")
    return ZenohConfig(mode="router", connect=connect, listen=(place,), certificate=certificate)


@pytest.fixture
def hub(keys, place):
    with opened(hub_at(keys, place)) as session:
        yield session


def config_of(keys, place, name, **more):
    return ZenohConfig(connect=(place,), certificate=str(keys / "fleet" / f"{name}.pem"), **more)


@asynccontextmanager
async def agent(name, domain_id, config):
    """A node in an agent's domain of DDS, behind a router to the hub."""
    far_end = {"join": partial(ZenohBackend, config), "namespace": f"/{name}"}
    async with (
        Node(name, domain_id=domain_id, interface="lo") as node,
        Node("router", domain_id=domain_id, interface="lo") as near,
        Node("router", **far_end) as far,
    ):
        router = Router(near, far, RouterSettings(agent=name, idle_timeout_s=0.1))
        async with beside(router.run()):
            yield node


@pytest.fixture
def fleet(keys, place, hub, free_domains):
    """Two agents at a hub."""

    @asynccontextmanager
    async def opened():
        one, two = free_domains(2)
        here, there = (config_of(keys, place, name) for name in ("one", "two"))
        async with agent("one", one, here) as first, agent("two", two, there) as second:
            yield first, second

    return opened


@pytest.mark.live
async def test_samples_latched_samples_and_transforms_cross(fleet):
    def transform(child):
        one = default_message("geometry_msgs/msg/TransformStamped", child_frame_id=child)
        one.header.frame_id = "base"
        return default_message(FRAMES, transforms=[one])

    heard, late, frames = [], [], set()

    def on_frames(message):
        frames.update(each.child_frame_id for each in message.transforms)

    async with fleet() as (here, there):
        there.create_subscription(STRING, "/global/one/t", lambda m: heard.append(m.data), 100)
        there.create_subscription(FRAMES, "/tf", on_frames, 100)
        here.create_publisher(STRING, "/global/one/latched", KEPT).publish(String(data="kept"))
        here.create_publisher(FRAMES, "/tf_static", KEPT).publish(transform("lidar"))
        publisher = here.create_publisher(STRING, "/global/one/t", 100)
        moving = here.create_publisher(FRAMES, "/tf", 100)

        def publish():
            publisher.publish(String(data="now"))
            moving.publish(transform("arm"))

        await until(lambda: heard and frames, publish, every_s=0.1)
        there.create_subscription(
            STRING, "/global/one/latched", lambda m: late.append(m.data), KEPT
        )
        there.create_subscription(FRAMES, "/tf_static", on_frames, KEPT)
        await until(lambda: late and len(frames) == 2)
    assert (late, frames) == (["kept"], {"one/arm", "one/lidar"})


@pytest.mark.live
async def test_services_cross_both_ways(fleet, calls_cross):
    async with fleet() as nodes:
        await calls_cross(*nodes)


@pytest.mark.live
@pytest.mark.parametrize("published", [True, False], ids=["published", "queried"])
async def test_agents_discover_each_other(fleet, published):
    met = set()
    async with fleet() as nodes:
        bodies = []
        for node in nodes:
            status = StatusSettings(agent=node.name, publish_description=published)
            settings = DiscoverySettings(agent=node.name, use_published_descriptions=published)
            seen = partial(lambda name, event: met.add((name, event.agent, event.event)), node.name)
            discoverer = AgentDiscoverer(node, settings, on_event=seen)
            bodies += [StatusProvider(node, status).run(), discoverer.run()]
        async with beside(*bodies):
            await until(lambda: len(met) == 2)
    assert met == {("one", "two", "DISCOVERED"), ("two", "one", "DISCOVERED")}


def without(config, *names):
    """Return a session's configuration without settings of TLS."""
    settings = json.loads(config.json("b"))
    for name in names:
        del settings["transport"]["link"]["tls"][name]
    return zenoh.Config.from_json5(json.dumps(settings))


def test_an_agent_without_a_certificate_or_of_another_authority_is_refused(keys, place, hub):
    good = config_of(keys, place, "one")
    bare = without(good, "connect_certificate", "connect_private_key")
    strange = json.loads(good.json("c"))
    for role in ("certificate", "private_key"):
        tls = strange["transport"]["link"]["tls"]
        tls[f"connect_{role}"] = tls[f"connect_{role}"].replace("/fleet/", "/strangers/")
    for config in (bare, zenoh.Config.from_json5(json.dumps(strange))):
        with pytest.raises(zenoh.ZError):
            zenoh.open(config)
    with opened(good) as session:
        assert list(session.info.routers_zid()) == [hub.zid()]


async def test_an_agent_refuses_a_hub_of_another_authority_and_one_with_another_name(
    keys, place, hub
):
    stranger = ZenohConfig(connect=(place,), certificate=str(keys / "strangers" / "one.pem"))
    elsewhere = config_of(keys, place.replace(HOST, "localhost"), "one")
    for config in (stranger, elsewhere):
        with pytest.raises(zenoh.ZError), opened(config):
            pass
    with opened(replace(elsewhere, mode="peer")) as peer:  # which accepts any name
        await until(lambda: list(peer.info.routers_zid()) == [hub.zid()])


def heard(session, *keys):
    """Return the set of kinds and keys of what others send, which grows."""
    found = set()

    def take(sample):
        found.add((str(sample.kind).rpartition(".")[2], str(sample.key_expr)))

    for key in keys:
        session.declare_subscriber(key, take, allowed_origin=zenoh.Locality.REMOTE)
    return found


def seen(session, *keys):
    """Return the set of tokens, which grows."""
    found = set()
    for key in keys:
        session.liveliness().declare_subscriber(key, lambda sample: found.add(str(sample.key_expr)))
    return found


TOKEN = "@ros2_lv/0/a/0/1/{}/%/{}/router/{}/T/H/q".format
# Keys that agent "one" may and may not send, announce and serve.
OWN = ("0/global/one/t/T/H", "0/tf/T/H", "0/global/agent_heartbeat/T/H", "0/tf_static/T/H/@adv/x")
FOREIGN = ("0/global/two/t/T/H", "0/local/t/T/H", "1/global/one/t/T/H", "0/global/two/t/T/H/@adv/x")
OWN_TOKENS = (TOKEN("MP", "%one", "%global%one%t"), TOKEN("SC", "%one", "%global%two%s"), OWN[3])
FOREIGN_TOKENS = (TOKEN("MP", "%two", "%global%two%t"), TOKEN("SS", "%two", "%tf"), FOREIGN[3])


async def test_what_an_agent_sends_in_another_agents_name_does_not_arrive(keys, place, hub):
    with opened(config_of(keys, place, "two")) as two, opened(config_of(keys, place, "one")) as one:
        at_hub = heard(hub, "**", "**/@adv/**")
        at_other = heard(two, "0/global/**", "0/tf/*/*")
        tokens = seen(hub, "@ros2_lv/**", "**/@adv/**")

        def send():
            for key in (*FOREIGN, *OWN):
                one.put(key, b"payload")
                one.delete(key)

        held = [one.liveliness().declare_token(key) for key in (*FOREIGN_TOKENS, *OWN_TOKENS)]
        for key in (FOREIGN[0], OWN[0]):
            one.declare_queryable(key, lambda query: query.reply(query.key_expr, b"answer"))
        await until(lambda: len(at_hub) >= 4 and len(at_other) >= 3 and len(tokens) >= 3, send)
        replies = [reply for key in (FOREIGN[0], OWN[0]) for reply in two.get(key, timeout=20.0)]
        del held
    assert at_hub == {("PUT", key) for key in OWN}
    assert at_other == {("PUT", key) for key in OWN[:3]}
    assert tokens == set(OWN_TOKENS)
    assert [str(reply.ok.key_expr) for reply in replies] == [OWN[0]]


async def test_an_agent_receives_only_what_the_policy_lets_in(keys, place, hub):
    with opened(config_of(keys, place, "one")) as one:
        got, tokens = heard(one, "**", "0/**", "0/local/**", "0/global/**"), seen(one, "**")

        def send():
            for key in ("0/local/t/T/H", "0/global/two/t/T/H"):
                hub.put(key, b"")

        held = hub.liveliness().declare_token("0/local/t")
        await until(lambda: got, send)
        send()
        assert list(one.liveliness().get("**", timeout=20.0)) == []
        del held
    assert (got, tokens) == ({("PUT", "0/global/two/t/T/H")}, set())


async def test_hubs_forward_to_each_other(keys, place, hub):
    with socket.create_server((HOST, 0)) as free:
        second = f"{place.rpartition(':')[0]}:{free.getsockname()[1]}"
    with (
        opened(hub_at(keys, second, (place,))),
        opened(config_of(keys, place, "one")) as one,
        opened(config_of(keys, second, "two")) as two,
    ):
        got = heard(two, "0/global/**")

        def send():
            for name in ("two", "one"):
                one.put(f"0/global/{name}/t/T/H", b"")

        await until(lambda: got, send)
    assert got == {("PUT", "0/global/one/t/T/H")}


@pytest.mark.parametrize(
    "text", ["{", "[1]", '{"mode": "peer"}', '{"access_control": {}, "connect": {"endpoints": []}}']
)
def test_a_hub_refuses_to_run_without_its_access_control(keys, tmp_path, text):
    folder = shutil.copytree(keys / "fleet", tmp_path / "fleet")
    (folder / ACCESS).write_text(text)
    words = rf"access-control.json5: given {re.escape(repr(text)[:30])}"
    with pytest.raises(InvalidValueError, match=words):
        hub_at(tmp_path, f"tls/{HOST}").json("a")


FAULTS = {
    "": (None, None),
    "certificate has expired": ("one.pem", "expired"),
    "KEY_VALUES_MISMATCH": ("one.key", "key of another"),
    "unable to get local issuer certificate": ("ca.pem", "other authority"),
    "NO_CERTIFICATE_OR_CRL_FOUND": ("ca.pem", "damaged"),
    "PEM lib": ("one.pem", "damaged"),
    "No such file or directory": ("one.key", "missing"),
}


@pytest.mark.parametrize("words", FAULTS)
def test_a_certificate_that_others_refuse_has_a_reason(keys, tmp_path, monkeypatch, words):
    folder = shutil.copytree(keys / "fleet", tmp_path / "fleet")
    match FAULTS[words]:
        case _, "expired":
            monkeypatch.setattr("sfglab.fleet.certificates.DAYS", 0)
            write_certificates(read_fleet(TWO), tmp_path / "new", [[HOST]])
            folder = tmp_path / "new"
        case name, "key of another":
            shutil.copy(folder / "two.key", folder / name)
        case name, "other authority":
            shutil.copy(keys / "strangers" / name, folder / name)
        case name, "damaged":
            (folder / name).write_text("x")
        case name, "missing":
            (folder / name).unlink()
    fault = certificate_fault(folder / "one.pem")
    assert words in fault
    assert bool(words) is bool(fault)


async def test_a_node_reports_a_certificate_that_others_refuse(keys, tmp_path, place, caplog):
    folder = shutil.copytree(keys / "fleet", tmp_path / "fleet")
    shutil.copy(folder / "two.key", folder / "one.key")
    config = ZenohConfig(connect=(place,), certificate=str(folder / "one.pem"))
    async with Node("a", join=partial(ZenohBackend, config)):
        await until(lambda: caplog.records)
    said = caplog.records[0].getMessage()
    assert said.startswith(f"{folder}/one.pem: others refuse this certificate: ")


async def test_peers_have_the_same_access_control(keys, place):
    anywhere = (place.rpartition(":")[0] + ":0",)
    one_config = replace(config_of(keys, place, "one", mode="peer"), connect=(), listen=(place,))
    two_config = config_of(keys, place, "two", mode="peer", listen=anywhere)
    with opened(one_config) as one, opened(two_config) as two:
        at_one, at_two = heard(one, "0/global/**"), heard(two, "0/global/**")

        def send():
            for sender in (one, two):
                for name in ("one", "two"):
                    sender.put(f"0/global/{name}/t/T/H", b"")

        await until(lambda: at_one and at_two, send)
        send()
    assert at_one == {("PUT", "0/global/two/t/T/H")}
    assert at_two == {("PUT", "0/global/one/t/T/H")}


def may(settings, agent, message, key):
    """Return whether an agent may send a message; Zenoh compares key expressions as here."""
    control = settings["access_control"]
    granted = {
        id_ for each in control["policies"] if agent in each["subjects"] for id_ in each["rules"]
    }
    rules = [
        rule for rule in control["rules"] if rule["id"] in granted and rule["flows"] == ["ingress"]
    ]
    allowed = [k for rule in rules if message in rule["messages"] for k in rule["key_exprs"]]
    return any(zenoh.KeyExpr(each).includes(zenoh.KeyExpr(key)) for each in allowed)


CMD_VEL, GOAL = "0/global/go2/cmd_vel/T/H", "0/global/go2/navigate_to_pose/_action/send_goal/T/H"


@pytest.mark.parametrize(
    ("message", "key", "agents"),
    [
        ("put", "0/global/go2/camera_front/color/ffmpeg/T/H", {"go2"}),
        ("put", CMD_VEL, {"go2", "steamdeck"}),  # as the fleet file lists it
        ("put", "0/global/invented/t/T/H", set()),
        ("put", "0/global/agent_heartbeat/T/H", "all"),
        ("put", "0/chatter/T/H", set()),
        ("declare_queryable", GOAL, {"go2"}),
        ("query", GOAL, "all"),
        ("query", "0/global/*/get_metadata/T/H", "all"),
        ("query", "0/tf_static/T/H/@adv/pub/*/**", "all"),
        ("declare_subscriber", "0/tf/T/*", "all"),
        ("declare_subscriber", "0/**", set()),
        ("liveliness_token", TOKEN("MP", "%steamdeck", "%global%go2%cmd_vel"), {"steamdeck"}),
        ("reply", "0/global/pi1/get_metadata/T/H", {"pi1"}),
        ("declare_liveliness_subscriber", "@ros2_lv/0/*/*/*/MP/*/*/*/%tf/**", "all"),
    ],
)
def test_rights_in_the_papers_fleet(message, key, agents):
    fleet = load_fleet(LAB)
    names = {agent.name for agent in fleet.agents}
    found = {name for name in names if may(access_control(fleet), name, message, key)}
    assert found == (names if agents == "all" else agents)


def policy(*rules):
    return f"{TWO}policy: [{', '.join(rules)}]\n"


def test_rights_follow_the_rules_of_the_policy():
    one_way = "{pattern: rt/global/*/state, directions: [outward]}"
    rules = (one_way, "rt/global/one/map", "rt/global/gate", "rt/site/*", "rq/global/*")
    settings = access_control(read_fleet(policy(*rules)))
    state, deep = "0/global/one/state/T/H", "0/global/one/arm/state/T/H"
    assert may(settings, "one", "put", state)
    assert may(settings, "one", "put", deep)
    assert not may(settings, "one", "put", "0/global/one/pose/T/H")
    assert not may(settings, "two", "declare_subscriber", state)
    assert may(settings, "two", "declare_subscriber", "0/global/one/map/T/H")
    assert not may(settings, "two", "put", "0/global/one/map/T/H")
    assert not may(settings, "two", "put", "0/global/gate/T/H")  # listed for no agent
    assert may(settings, "two", "put", "0/site/gate/T/H")
    assert not may(settings, "one", "query", "0/global/two/s/T/H")  # replies do not cross
    with opened_router(settings):
        pass  # Zenoh accepts the rules


@contextmanager
def opened_router(settings):
    config = json.loads(ZenohConfig(mode="router", connect=()).json("d")) | settings
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))) as session:
        yield session


@pytest.mark.parametrize("pattern", ["rt/*", "*", "rt/glob*", "rt/global/o*", "rt/t?", "rt/a/*b"])
def test_a_policy_that_key_expressions_cannot_express_is_refused(pattern):
    with pytest.raises(InvalidValueError, match=r"policy\[1\]: given .*allowed: a name"):
        access_control(read_fleet(policy("rt/tf", f"{pattern!r}")))


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_keys_are_private_and_nothing_is_replaced_but_the_access_control(tmp_path):
    first = write_certificates(read_fleet(TWO), tmp_path, [[HOST, "hub.local"]])
    before = contents(tmp_path)
    again = write_certificates(read_fleet(THREE), tmp_path, [[HOST, "hub.local"], ["10.0.0.2"]])
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
    assert [name for name, mode in modes.items() if mode == 0o600] == [
        name for name in modes if name.endswith(".key")
    ]
    after = contents(tmp_path)
    assert {name for name, data in before.items() if after[name] != data} == {ACCESS}
    new = {f"{name}.{end}" for name in ("three", "hub2") for end in ("pem", "key")}
    assert after.keys() - before.keys() == new
    names = [AUTHORITY, "hub.pem", "one.pem", "two.pem"]
    assert [row[:2] for row in first] == [*((name, "new") for name in names), (ACCESS, "written")]
    assert [row[:2] for row in again] == [
        (AUTHORITY, "kept"),
        ("hub.pem", "kept"),
        ("hub2.pem", "new"),
        ("one.pem", "kept"),
        ("two.pem", "kept"),
        ("three.pem", "new"),
        (ACCESS, "written"),
    ]
    years, days = (date.fromisoformat(row[2]) - datetime.now(UTC).date() for row in first[:2])
    assert (years.days, days.days) == (3650, 825)


def test_a_hubs_certificate_has_its_names_and_the_common_name_of_hubs(tmp_path):
    write_certificates(read_fleet(TWO), tmp_path, [[HOST, "hub.local", "fe80::1"]])
    hub = x509.load_pem_x509_certificate((tmp_path / "hub.pem").read_bytes())
    names = hub.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["hub.local"]
    assert [str(one) for one in names.get_values_for_type(x509.IPAddress)] == [HOST, "fe80::1"]
    assert hub.subject.rfc4514_string() == f"CN={HUB}"


@pytest.mark.parametrize(
    ("spoil", "says"),
    {
        "rm ca.key": r"ca.key: no such file or directory, needed: the key of",
        "rm ca.*": r"one.pem: given 'another certificate', allowed: one of this authority",
        "rm ca.pem": r"ca.key: given 'a key', allowed: none without a certificate",
        "rm one.pem": r"one.key: given 'a key', allowed: none without a certificate",
        "echo > one.pem": r"PEM",
        "echo > ca.key": r"PEM",
    }.items(),
)
def test_a_folder_that_does_not_fit(tmp_path, spoil, says):
    write_certificates(read_fleet(TWO), tmp_path)
    subprocess.run(["sh", "-c", spoil], cwd=tmp_path, check=True)
    before = contents(tmp_path)
    with pytest.raises(ValueError, match=says):
        write_certificates(read_fleet(THREE), tmp_path)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("names", [["a b"], [""], ["../x"], ["tls/hub:7447"], [HOST, "hub.local"]])
def test_names_of_a_hub_that_are_not_allowed_or_not_those_of_its_certificate(keys, names):
    before = contents(keys / "fleet")
    with pytest.raises(InvalidValueError, match=r"without a port|with these names"):
        write_certificates(read_fleet(TWO), keys / "fleet", [names])
    assert contents(keys / "fleet") == before


@pytest.mark.parametrize("name", ["ca", "hub"])
def test_an_agent_cannot_have_the_files_of_the_authority_or_a_hub(tmp_path, name):
    fleet = read_fleet(f"fleet: test\nagents: {{{name}: {{domain: 1}}}}\n")
    with pytest.raises(InvalidValueError, match=f"agent: given '{name}', allowed: a name that"):
        write_certificates(fleet, tmp_path, [[HOST]])
    assert list(tmp_path.iterdir()) == []


def test_hubs_come_from_the_fleet_file(tmp_path):
    hubs = "hubs: ['10.0.0.1', 'tls/[fe80::1]:7448'], certificates: /etc/keys"
    (tmp_path / "fleet.yaml").write_text(f"{TWO}global: {{{hubs}}}\n")
    argv = [sys.executable, "-m", "sfglab", "fleet", "certificates", "fleet.yaml", "-o", "keys"]
    done = subprocess.run(argv, cwd=tmp_path, check=True, capture_output=True, text=True)
    assert re.search(r"^ *hub2.pem +new +20..-..-..$", done.stdout, re.MULTILINE), done.stdout
    hub = x509.load_pem_x509_certificate((tmp_path / "keys" / "hub2.pem").read_bytes())
    names = hub.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert [str(one.value) for one in names] == ["fe80::1"]


@pytest.mark.parametrize("name", [AUTHORITY, "one.pem", "one.key", ACCESS])
def test_a_session_needs_the_files_of_its_certificate(keys, tmp_path, name):
    folder = shutil.copytree(keys / "fleet", tmp_path / "copy")
    (folder / name).unlink()
    mode = "router" if name == ACCESS else "client"
    with pytest.raises(InvalidValueError, match=rf"{name}: no such file"):
        ZenohConfig(mode=mode, connect=("tls/a:1",), certificate=f"{folder}/one.pem").json("e")


@pytest.mark.parametrize("mode", ["client", "router"])
def test_a_link_without_tls_is_refused(keys, free_port, mode):
    place = (f"tcp/{HOST}:{free_port}",)
    certificate = f"{keys}/fleet/one.pem"
    config = ZenohConfig(mode=mode, connect=(), listen=place, certificate=certificate)
    if mode == "client":
        config = replace(config, connect=place, listen=())
    with pytest.raises(zenoh.ZError), opened(config):
        pass


@pytest.mark.live
@pytest.mark.slow
async def test_hub_and_agents_from_the_command_line_discover_each_other(keys, place, free_domains):
    security = ("--certificates", str(keys / "fleet"))
    hub = Hub(place)
    hub.argv = (*hub.argv, *security)
    await hub.start()
    try:
        async with fleet_of_processes(free_domains(2), place, *security) as (one, two):
            await until(lambda: one.known == {"two": "DISCOVERED"})
            await until(lambda: two.known == {"one": "DISCOVERED"})
    finally:
        await hub.end(signal.SIGINT)
