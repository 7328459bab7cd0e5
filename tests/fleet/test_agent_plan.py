"""Components of an agent, from a fleet file or options, and the lines that it prints."""

from dataclasses import replace

import pytest

from sfglab.bus.address import BusAddress
from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.component import config_from_argument
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fleet.agent import plan as plans
from sfglab.fleet.agent.app import Narrator
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.discovery.config import DiscoveryConfig
from sfglab.fleet.fleet_file import read_fleet
from sfglab.fleet.gop_config import GopCacheConfig
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.config import StatusConfig

CONFIG = plans.config_of("go2", None, local=(7, "lo"), remote=(None, "eth0"))
FLEET = read_fleet("""
fleet: pair
global: {domain: 3, interface: wlan0}
policy: [{pattern: "rt/global/*", directions: [outward]}]
agents:
  go2:
    domain: 1
    local_interface: lo
    tf: {prefix_frames: false, shared_frames: [hall], placed_by_others: [base]}
    sensors:
      - name: camera_front
        model: D435
        streams:
          - topic: /global/go2/camera_front/color/ffmpeg
            type: ffmpeg_image_transport_msgs/msg/FFMPEGPacket
            codec: h264
            width: 640
            height: 360
            rate_hz: 30
  bare: {domain: 2, lifecycle: false}
""")


def arguments(config):
    return {component.name: component.argv[-1] for component in plans.plan(config)}


@pytest.mark.parametrize(
    ("agent", "domain", "words"),
    [
        ("global", 7, "global"),
        ("go2", 233, "domain: given 233, allowed: 0 to 232"),
        ("go2", 0, "given 0, allowed: two different"),
        (
            "go2",
            None,
            "its own domain: nothing is given, needed: --domain or ROS_DOMAIN_ID, from 1 to 232, or a",
        ),
    ],
)
def test_what_could_not_be_run_is_refused_before_anything_is_started(agent, domain, words):
    with pytest.raises(SfglabError, match=words):
        plans.plan(plans.config_of(agent, None, local=(domain, None)))


def test_components_can_be_left_out():
    assert list(arguments(plans.without(CONFIG, ["decoder"]))) == ["router", "status", "discoverer"]
    with pytest.raises(
        InvalidValueError,
        match="agent go2, component to leave out: given 'decodre', allowed: router, ",
    ):
        plans.without(CONFIG, ["decodre"])


def test_a_fleet_file_says_everything():
    config = plans.config_of("go2", FLEET)
    given = arguments(config)
    assert tuple(given) == plans.COMPONENTS
    router = config_from_argument(RouterConfig, given["router"])
    expected = RouterConfig(
        agent="go2",
        local=BusAddress(domain_id=1, interface="lo"),
        remote=BusAddress(domain_id=3, interface="wlan0"),
        rules=FLEET.policy.rules,
        advertise_unused_topics=True,
        prefix_frames=False,
        shared_frames=("hall",),
        placed_by_others=("base",),
    )
    assert router == config.router == expected
    status = config_from_argument(StatusConfig, given["status"])
    (sensor,) = status.settings.description.sensors
    assert (sensor.name, sensor.streams[0].rate_hz) == ("camera_front", 30)
    keeper = config_from_argument(GopCacheConfig, given["keeper"])
    assert keeper.streams == (sensor.streams[0].topic,)
    discoverer = config_from_argument(DiscoveryConfig, given["discoverer"])
    assert status.settings.agent == discoverer.settings.agent == "go2"
    assert status.settings.publish_description
    assert discoverer.settings.use_published_descriptions
    decoder = config_from_argument(DecoderConfig, given["decoder"])
    assert decoder.discovery_topic == "/local/go2/agent_discovery_event"
    # All components stay in the agent's own domain, the decoder with both sides.
    addresses = {status.address, discoverer.address, keeper.address, decoder.remote, decoder.local}
    assert addresses == {router.local}


def test_descriptions_are_queried_if_the_file_says_so_and_without_lifecycle_there_are_none():
    given = arguments(plans.config_of("go2", replace(FLEET, descriptions="queried")))
    status = config_from_argument(StatusConfig, given["status"]).settings
    discoverer = config_from_argument(DiscoveryConfig, given["discoverer"]).settings
    assert not status.publish_description
    assert not discoverer.use_published_descriptions
    bare = arguments(plans.config_of("bare", FLEET))
    assert {"status", "discoverer"} & bare.keys() == set()


def test_options_go_before_the_fleet_file():
    router = plans.config_of("go2", FLEET, local=(9, None), remote=(None, "eth1")).router
    assert router.local == BusAddress(domain_id=9, interface="lo")
    assert router.remote == BusAddress(domain_id=3, interface="eth1")


ZENOH = replace(FLEET, zenoh=ZenohAddress(domain_id=3, hubs=("hub",), certificates="/c"))


@pytest.mark.parametrize(
    ("fleet", "options", "expected"),
    [
        (None, {"middleware": "zenoh"}, ZenohAddress(hubs=(), name="go2")),
        (None, {"hubs": ("a",)}, ZenohAddress(hubs=("a",), name="go2")),
        (
            FLEET,
            {"middleware": "zenoh", "hubs": ("a",)},
            ZenohAddress(domain_id=3, hubs=("a",), name="go2"),
        ),
        (ZENOH, {}, replace(ZENOH.zenoh, name="go2")),
        (
            ZENOH,
            {"hubs": ("b",), "remote": (5, None)},
            replace(ZENOH.zenoh, domain_id=5, hubs=("b",), name="go2"),
        ),
        (ZENOH, {"middleware": "dds"}, BusAddress(domain_id=3, interface="wlan0")),
    ],
)
def test_agents_meet_over_dds_or_zenoh_as_options_or_the_file_say(fleet, options, expected):
    config = plans.config_of("go2", fleet, **{"local": (7, "lo"), **options})
    given = arguments(config)
    assert config_from_argument(RouterConfig, given["router"]).remote == expected
    over_zenoh = isinstance(expected, ZenohAddress)
    # Tokens of all endpoints and heartbeats of starting agents would grow with the square of the fleet.
    assert config.router.advertise_unused_topics is not over_zenoh
    startup_s = config_from_argument(StatusConfig, given["status"]).settings.schedule.startup_s
    assert startup_s == (0 if over_zenoh else 10)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"hubs": ("a", "b")}, "hubs with --global dds: given 'a, b', allowed: none"),
        ({"peers": (":1",)}, "peers with --global dds: given ':1', allowed: none"),
        ({"certificates": "/c"}, "certificates with --global dds: given '/c', allowed: none"),
    ],
)
def test_options_of_zenoh_are_refused_over_dds(options, words):
    with pytest.raises(InvalidValueError, match=words):
        plans.config_of("go2", ZENOH, local=(7, "lo"), middleware="dds", **options)


def test_an_agents_own_domain_may_have_the_number_of_zenohs():
    plans.config_of("go2", None, local=(7, "lo"), remote=(7, None), middleware="zenoh", hubs=("a",))


def path(topic, direction="inward", **ends):
    return {"topic": topic, "direction": direction, "readers": 1, "writers": 1, **ends}


def reported(component, **report):
    return {"is": "report", "component": component, "report": report}


def changed(state, *, crashes=0, why="", retry_s=None):
    report = {"is": "component", "component": "router", "state": state, "pid": 7}
    return report | {"crashes": crashes, "why": why, "retry_s": retry_s}


@pytest.mark.parametrize(
    ("report", "words"),
    [
        (changed("starting"), ""),
        (changed("running", crashes=2), "ready again after 2 crashes"),
        (
            changed("backing_off", why="x", retry_s=0.2),
            "crashed (x); it is started again in 0.2 s",
        ),
        (
            changed("replacing", why="it took long"),
            "it took long; it is ended and started again",
        ),
        ({"is": "line", "component": "router", "line": "WARNING: x"}, "WARNING: x"),
        (reported("status", **{"is": "refused"}), ""),
    ],
)
def test_a_person_reads_what_matters(report, words):
    lines = [f"{report['component']}: {words}"] if words else []
    assert Narrator(CONFIG).lines(report) == lines
    assert Narrator(CONFIG).lines({"is": "ready"}) == ["agent go2: ready, end it with Ctrl-C"]


def test_a_person_reads_of_paths_that_open_and_close_by_ros_names_and_of_streams_that_change():
    narrator = Narrator(CONFIG)
    heartbeat = path("rt/global/agent_heartbeat")
    service = [
        path("rq/global/pi1/set_modeRequest", "outward"),
        path("rr/global/pi1/set_modeReply"),
    ]
    query = path("rq/global/pi1/get_metadataRequest")
    incomplete = [path("rt/tf", readers=0), path("rt/chatter", writers=0)]
    paths = [heartbeat, *service, query, *incomplete]
    first = reported("router", **{"is": "status", "paths": paths})
    assert narrator.lines(first) == [
        "router: /global/agent_heartbeat inward opened",
        "router: /global/pi1/set_mode outward opened",
    ]
    assert narrator.lines(first) == []
    last = reported("router", **{"is": "status", "paths": [heartbeat]})
    assert narrator.lines(last) == ["router: /global/pi1/set_mode outward closed"]
    status = {"is": "status", "local_topic": "/local/pi1/camera/color/image_raw"}
    running = reported("decoder", **status, state="RUNNING", subscribers=1)
    assert narrator.lines(running) == [
        "decoder: /local/pi1/camera/color/image_raw running, 1 subscriber"
    ]
    assert narrator.lines(running) == []
