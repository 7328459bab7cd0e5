"""Border linter: every kind of finding, which agent receives what, and estimated discovery."""

from pathlib import Path

import pytest

from sfglab.fleet.fleet_file import load_fleet, read_fleet
from sfglab.fleet.lint import Severity, lint, lint_file, render
from sfglab.fleet.lint.discovery import ROS_ENDPOINTS
from sfglab.names import ResourceKind

ROOT = Path(__file__).parents[2]
LAB = ROOT / "data" / "fleets" / "lab.yaml"
BROKEN = Path(__file__).parent / "fleets" / "broken.yaml"


def report_of(agents, policy=""):
    return lint(read_fleet(f"fleet: f\n{policy}\nagents:\n{agents}"))


def codes(report, severity=None):
    return {f.code for f in report.findings if severity in (None, f.severity)}


def one(report, code):
    (found,) = (f for f in report.findings if f.code == code)
    return found


def agents(*inner):
    """Return agents a1, a2 and so on, of which each does as it says."""
    return "\n".join(f"  a{i}: {{domain: {i}, {text}}}" for i, text in enumerate(inner, start=1))


def test_the_labs_fleet_has_no_error_and_no_warning():
    report = lint(load_fleet(LAB))
    assert report.exit_code == 0
    assert codes(report, Severity.ERROR) == codes(report, Severity.WARNING) == set()


def test_every_mistake_of_the_broken_fleet_is_found_at_its_line_the_worst_first_with_a_remedy():
    lines = BROKEN.read_text().splitlines()
    report = lint(load_fleet(BROKEN))
    found = {(f.place.line, f.code) for f in report.findings}
    marked = set()
    for number, line in enumerate(lines[1:], start=2):
        for code in line.partition("#")[2].replace(",", " ").split():
            assert (number, code) in found
            marked.add(code)
    assert len(marked) >= 19
    assert report.exit_code == 1
    ranks = [list(Severity).index(f.severity) for f in report.findings]
    assert ranks == sorted(ranks)
    for f in report.findings:
        assert f.place.line > 0
        assert all((f.place.key, f.what, f.why, f.remedy or f.severity is Severity.INFO))


def tree(frames, *, prefix=True, shared="map"):
    return f"tf: {{prefix_frames: {str(prefix).lower()}, shared_frames: [{shared}], frames: [{frames}]}}"


def edge(child, parent, *, static=False):
    return f"{{child: {child}, parent: {parent}, static: {str(static).lower()}}}"


def bare(child, parent):
    return tree(edge(child, parent), prefix=False)


BASE = tree(edge("base", "map"))
ALONE = tree(edge("base", "map"), shared="")
PLACING = tree(edge("map", "world"), shared="map, world")
HALVES = tree(edge("base", "odom") + ", " + edge("arm", "torso"))
PLACED = tree(edge("base", "odom")).replace("tf: {", "tf: {placed_by_others: [odom], ")
STREAM = "{topic: /local/a1/camera/color/ffmpeg, type: x/msg/Y, codec: h264, width: 1, height: 1, rate_hz: 1}"
AT_ODDS = (
    "publishes: [{name: /global/a1/pose, type: x/msg/A, qos: sensor_data}]",
    "subscribes: [{name: /global/a1/pose, type: x/msg/B, qos: latched}]",
)


@pytest.mark.parametrize(
    ("code", "severity", "uses", "said"),
    [
        *(
            ("does-not-cross", "error", (f"publishes: [{name}]", f"subscribes: [{name}]"), better)
            for name, better in (
                ("/tf2", "/global/a1/tf2$"),
                ("/local/a1/x", "/global/a1/x$"),
                ("/localization/pose", "/global/a1/localization/pose$"),
                ("/local/a1_arm/cmd", "/global/a1/a1_arm/cmd$"),
            )
        ),
        ("qos-mismatch", "error", AT_ODDS, "TRANSIENT_LOCAL"),
        ("frame-clash", "error", (bare("base", "map"), bare("base", "map")), "prefix_frames: true"),
        (
            "frame-clash",
            "error",
            (bare("base", "map"), bare("base", "odom")),
            "below map, odom",
        ),
        ("frame-clash", "error", (PLACING, PLACING), "out of shared_frames"),
        ("frame-clash", "error", (tree(edge("a1/base", "map")), bare("a1/base", "map")), "a1/base"),
        ("frame-own-roots", "error", (HALVES,), "odom, a1/torso"),
        ("frame-no-common-root", "warning", (ALONE, ALONE), "a1/map, a2/map"),
        ("frame-no-common-root", "warning", (BASE, ALONE), "a2/map, map"),
        ("frame-no-common-root", "warning", (PLACED, bare("a1/markers", "map")), "roots"),
    ],
)
def test_a_mistake_is_found_with_its_place_and_what_follows(code, severity, uses, said):
    finding = one(report_of(agents(*uses)), code)
    assert finding.severity.value == severity
    assert said in f"{finding.place.key}: {finding.what}; {finding.why}; {finding.remedy}$"


@pytest.mark.parametrize(
    ("code", "uses"),
    [
        ("does-not-cross", 2 * ("publishes: [/chatter], subscribes: [/chatter]",)),
        ("does-not-cross", ("calls: [/global/a2/set_mode]", "serves: [/global/a2/set_mode]")),
        ("two-servers", 2 * ("serves: [/local/a1/reset]",)),
        ("type-mismatch", tuple(text.replace("/global/", "/local/") for text in AT_ODDS)),
        ("qos-mismatch", tuple(text.replace("/global/", "/local/") for text in AT_ODDS)),
        ("static-not-latched", ("subscribes: [{name: /tf_static, qos: latched}]",)),
        ("frame-clash", (BASE, BASE)),
        ("frame-no-common-root", (BASE, BASE)),
        (
            "frame-clash",
            (tree(edge("a1/base", "map")), BASE),
        ),  # a prefix by hand is not added again
    ],
)
def test_what_is_no_mistake_is_not_found(code, uses):
    assert code not in codes(report_of(agents(*uses)))


NAMED = "global: {domain: 0, interface: wlan0}"
DDS_ROUTER = "deployment: {router: dds-router, router_image: 'r%s'}"


@pytest.mark.parametrize(
    ("found", "head", "uses"),
    [
        (
            "machine-twice",
            NAMED,
            ("host: {address: a@m}", "host: {address: b@m, accelerator: cuda}"),
        ),
        ("interface-unnamed", "", ("host: {}",)),
        ("domain-everywhere", NAMED, ("host: {network: host}",)),
        ("", NAMED, ("host: {network: host, address: a@m}, local_interface: lo",)),
        ("router-image-unused", "deployment: {router_image: 'r:1'}", ("",)),
        ("router-image-missing", "deployment: {router: dds-router}", ("",)),
        ("router-image-moves", DDS_ROUTER % "", ("",)),
        ("router-image-moves", DDS_ROUTER % ":latest", ("",)),
        # Without a host, no interface is asked for.
        ("", DDS_ROUTER % f"@sha256:{64 * 'a'}", ("",)),
        # No frames clash where transforms do not cross.
        ("does-not-cross", "policy: [rt/global/*]", 2 * (bare("base", "map"),)),
    ],
)
def test_hosts_a_router_and_a_policy_that_do_not_fit_together_are_errors(found, head, uses):
    assert codes(report_of(agents(*uses), head), Severity.ERROR) == set(found.split())


@pytest.mark.parametrize("half", ["rq/global/*", "rr/global/*"])
def test_a_policy_with_half_of_services_is_found_in_its_rules_and_in_every_service(half):
    calls = "calls: [/global/a1/reset], action_clients: [/global/a1/follow_path]"
    uses = agents("serves: [/global/a1/reset]", calls)
    report = report_of(uses, f"policy: [rt/global/*, {half}]")
    assert one(report, "half-open-rule").place.key == "policy[1]"
    whats = " ".join(f.what for f in report.findings if f.code == "half-open")
    assert "service /global/a1/reset is half open: 1 of its 2" in whats
    assert "action /global/a1/follow_path is half open: 5 of its 8" in whats


def test_who_hears_what_names_agents_and_the_rule_but_none_without_lifecycle():
    hearings = {(h.kind, h.name): h for h in lint(load_fleet(LAB)).hearings}
    camera = hearings[ResourceKind.TOPIC, "/global/go2/camera_front/color/ffmpeg"]
    assert (camera.speakers, camera.hearers) == (("go2",), ("steamdeck", "workstation"))
    assert (camera.crosses, camera.rules) == (True, ("rt/global/*",))
    metadata = hearings[ResourceKind.SERVICE, "/global/pi1/get_metadata"]
    assert metadata.speakers == ("pi1",)
    assert metadata.rules == ("rq/global/*", "rr/global/*")
    assert not any(name.startswith("/local/") for _, name in hearings)
    bare = report_of("  a1: {domain: 1}\n  a2: {domain: 2, lifecycle: false}")
    assert not any("a2" in hearing.name for hearing in bare.hearings)


def test_the_text_shows_everything_and_a_file_that_is_no_fleet_gives_one_line(tmp_path):
    text, code = lint_file(BROKEN)
    assert code == 1
    assert text == render(lint(load_fleet(BROKEN)))
    for title in ("senders and receivers", "discovery between hosts", "broken: "):
        assert title in text
    assert "broken.yaml:" in text
    path = tmp_path / "x.yaml"
    path.write_text("fleet: x\nagnets: {}\n")
    text, code = lint_file(path)
    assert (code, text.count("\n")) == (2, 1)
    assert "did you misspell it as 'agnets'?" in text


def test_discovery_is_estimated_over_dds_alone():
    two = "\n".join(["fleet: f", "agents:", agents("", "")])
    over_dds, over_zenoh = (
        lint(read_fleet(f"{two}\nglobal: {given}")) for given in ("{}", "{hubs: [10.0.0.1]}")
    )
    title = "discovery between hosts"
    assert title in render(over_dds)
    assert over_zenoh.discovery is None
    assert title not in render(over_zenoh)
    assert over_zenoh.hearings == over_dds.hearings


def fleet_of(count, inner="", processes=20):
    return report_of(agents(*count * [f"processes: {processes}, lifecycle: false, {inner}"]))


def test_with_one_domain_all_are_told_of_all_and_through_routers_only_what_is_wanted_across():
    standard = fleet_of(2).discovery.standard
    assert standard.participants == 40
    assert standard.endpoints == 40 * ROS_ENDPOINTS
    assert standard.pairs == 2 * 20 * 20
    assert standard.announced == 2 * 20 * (20 * ROS_ENDPOINTS)
    talk = "publishes: [/chatter, /global/shared/map], subscribes: [/chatter, /global/shared/map]"
    report = fleet_of(3, talk)
    assert report.discovery.shown == {"a1": 2, "a2": 2, "a3": 2}
    assert report.discovery.routed.participants == 3
    assert report.discovery.routed.pairs == 6
    assert report.discovery.routed.announced == 3 * 2 * 2
    assert report.discovery.routed == fleet_of(3, talk, processes=1).discovery.routed


@pytest.mark.parametrize(
    ("uses", "shown"),
    [
        (2 * ["publishes: [/global/shared/map]"], {"a1": 0, "a2": 0}),
        (
            [
                "publishes: [{name: /tf_static, qos: latched, count: 3}, {name: /tf, count: 3}]",
                "subscribes: [{name: /tf_static, qos: latched}, /tf]",
            ],
            {"a1": 3 + 1, "a2": 2},
        ),
        (["serves: [/global/a1/reset]", "calls: [/global/a1/reset]"], {"a1": 2, "a2": 2}),
    ],
    ids=["nobody wants it", "each latched publisher", "a service is two topics"],
)
def test_a_router_shows_what_others_want(uses, shown):
    report = report_of(agents(*(f"lifecycle: false, {use}" for use in uses)))
    assert report.discovery.shown == shown
