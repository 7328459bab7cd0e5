"""The border linter: one test per mistake, and who hears what."""

from pathlib import Path

import pytest

from sfglab.fleet.fleet_file import load_fleet, read_fleet
from sfglab.fleet.lint import Severity, View, lint, lint_file, render
from sfglab.names import ResourceKind

ROOT = Path(__file__).parents[2]
LAB = ROOT / "data" / "fleets" / "lab.yaml"
BROKEN = Path(__file__).parent / "fleets" / "broken.yaml"


def report_of(agents: str, policy: str = ""):
    return lint(read_fleet(f"fleet: f\n{policy}\nagents:\n{agents}"))


def codes(report, severity: Severity | None = None) -> set[str]:
    return {f.code for f in report.findings if severity in (None, f.severity)}


def one(report, code: str):
    found = [f for f in report.findings if f.code == code]
    assert len(found) == 1, [f.what for f in report.findings]
    return found[0]


def agents(*inner: str) -> str:
    """Return agents a1, a2 and so on, of which each does as it says."""
    return "\n".join(f"  a{i}: {{domain: {i}, {text}}}" for i, text in enumerate(inner, start=1))


def test_the_labs_fleet_has_no_error_and_no_warning():
    report = lint(load_fleet(LAB))
    assert report.exit_code == 0
    assert codes(report, Severity.ERROR) == codes(report, Severity.WARNING) == set()


def test_every_mistake_of_the_broken_fleet_is_found_at_its_line():
    lines = BROKEN.read_text().splitlines()
    marked = {
        (number, code.strip())
        for number, line in enumerate(lines, start=1)
        for code in line.partition("#")[2].split(",")
        if number > 1 and code
    }
    report = lint(load_fleet(BROKEN))
    found = {(f.place.line, f.code) for f in report.findings}
    assert marked <= found
    assert len({code for _, code in marked}) >= 20
    assert report.exit_code == 1


def test_findings_come_worst_first_and_say_place_what_why_and_errors_a_remedy():
    findings = lint(load_fleet(BROKEN)).findings
    assert list(findings) == sorted(findings, key=lambda f: list(Severity).index(f.severity))
    for f in findings:
        assert f.place.line > 0
        assert f.place.key
        assert f.what
        assert f.why
        if f.severity is not Severity.INFO:
            assert f.remedy


def test_agents_of_one_domain_are_errors_and_services_that_cross_one_way_half_open():
    report = report_of("  a1: {domain: 5}\n  a2: {domain: 5}\n  a3: {domain: 0}\n  a4: {domain: 102}")
    assert one(report, "domain-shared").what == "a2 and a1 both use domain 5"
    assert one(report, "domain-global").severity is Severity.ERROR
    assert one(report, "domain-high").severity is Severity.WARNING
    policy = "policy: [rt/tf, {pattern: rq/global/*, directions: [outward]}, rr/global/*]"
    assert "half-open-rule" in codes(report_of(agents("serves: [/global/a1/reset]"), policy))


STREAM = "{topic: /local/a1/camera/color/ffmpeg, type: x/msg/Y, codec: h264, width: 1, height: 1, rate_hz: 1}"
POSE = "publishes: [/global/a1/pose]"
AT_ODDS = (
    "publishes: [{name: /global/a1/pose, type: x/msg/A, qos: sensor_data}]",
    "subscribes: [{name: /global/a1/pose, type: x/msg/B, qos: latched}]",
)


@pytest.mark.parametrize(
    ("code", "severity", "uses", "said"),
    [
        *(
            ("does-not-cross", "error", (f"publishes: [{name}]", f"subscribes: [{name}]"), said)
            for name in ("/chatter", "/local/a1/x", "/globally/a1/x", "/tf2", "/local/global/a1/x")
            for said in ("a2.subscribes[0]:", "/global/a1/")
        ),
        ("nearly-global", "warning", ("publishes: [/global_x/a1/state]",), "/global/a1/state$"),
        ("local-outside-schema", "info", ("publishes: [/global/a1/odd_name_x, /scan]",), "/scan"),
        ("not-in-schema", "warning", ("publishes: [/global/a1/lidar/points/b/c/d]",), "crosses"),
        ("nobody-speaks", "warning", ("", "subscribes: [/global/a11/pose]"), "a2.subscribes[0]:"),
        ("unknown-agent", "warning", ("", "subscribes: [/global/a11/pose]"), "did you mean"),
        ("two-publishers", "warning", (POSE, POSE), "a2 publishes /global/a1/pose, as a1 itself does"),
        ("no-server", "error", ("calls: [/global/a2/reset]", "serves: [/local/a2/set_mode]"), "agents.a1"),
        ("does-not-cross", "error", ("calls: [/local/a2/x]", "serves: [/local/a2/x]"), "a1.calls[0]:"),
        ("two-servers", "error", ("serves: [/global/a1/reset]", "serves: [/global/a1/reset]"), "first"),
        ("router-hazard", "error", ("serves: [/global/a1/setRequest, /local/a1/setReply]",), "'setRequest'"),
        ("type-mismatch", "error", AT_ODDS, "a2.subscribes[0]:"),
        ("qos-mismatch", "error", AT_ODDS, "RELIABLE"),
        ("qos-mismatch", "error", AT_ODDS, "TRANSIENT_LOCAL"),
        ("static-not-latched", "error", ("publishes: [{name: /tf_static, qos: default}]",), "latched"),
        ("static-not-latched", "error", ("subscribes: [{name: /tf_static, qos: default}]",), "latched"),
        ("description", "error", (f"sensors: [{{name: camera, streams: [{STREAM}]}}]",), "stay inside"),
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
        ("not-in-schema", ("publishes: [/global/a1/odd_name_x, /scan]",)),
        ("nearly-global", ("publishes: [/global/a1/odd_name_x, /scan]",)),
        ("two-publishers", ("subscribes: [/global/a1/cmd_vel]", "publishes: [/global/a1/cmd_vel]")),
        ("no-server", ("calls: [/global/a2/set_mode]", "serves: [/global/a2/set_mode]")),
        ("does-not-cross", ("calls: [/global/a2/set_mode]", "serves: [/global/a2/set_mode]")),
        ("two-servers", 2 * ("serves: [/local/a1/reset]",)),
        ("type-mismatch", tuple(text.replace("/global/", "/local/") for text in AT_ODDS)),
        ("qos-mismatch", tuple(text.replace("/global/", "/local/") for text in AT_ODDS)),
        ("static-not-latched", ("publishes: [{name: /tf_static, qos: latched}]",)),
        ("static-not-latched", ("subscribes: [{name: /tf_static, qos: latched}]",)),
    ],
)
def test_what_is_no_mistake_is_not_found(code, uses):
    assert code not in codes(report_of(agents(*uses)))


@pytest.mark.parametrize("missing", ["rq/global/*", "rr/global/*"])
def test_a_policy_with_half_of_services_is_found_in_its_rules_and_in_every_service(missing):
    rules = [r for r in ("rt/global/*", "rq/global/*", "rr/global/*") if r != missing]
    policy = f"policy: [{', '.join(rules)}]"
    uses = agents(
        "serves: [/global/a1/reset]", "calls: [/global/a1/reset], action_clients: [/global/a1/follow_path]"
    )
    report = report_of(uses, policy)
    assert one(report, "half-open-rule").place.key == f"policy[{len(rules) - 1}]"
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
    assert set(metadata.hearers) == {"go2", "pi2", "pi3", "steamdeck", "workstation"}
    assert metadata.rules == ("rq/global/*", "rr/global/*")
    assert hearings[ResourceKind.TOPIC, "/tf"].rules == ("rt/tf",)
    assert not any(name.startswith("/local/") for _, name in hearings)
    view = View(read_fleet("fleet: f\nagents: {a1: {domain: 1}, a2: {domain: 2, lifecycle: false}}"))
    assert not [use for use in view.uses if use.agent == "a2"]
    assert (ResourceKind.SERVICE, "/global/a2/get_metadata") not in view.meetings


def test_the_text_shows_everything_and_a_file_that_is_no_fleet_gives_one_line(tmp_path):
    text, code = lint_file(BROKEN)
    assert code == 1
    assert text == render(lint(load_fleet(BROKEN)))
    for title in ("who hears what", "discovery between hosts", "across each border", "broken: "):
        assert title in text
    assert "broken.yaml:" in text
    path = tmp_path / "x.yaml"
    path.write_text("fleet: x\nagnets: {}\n")
    text, code = lint_file(path)
    assert (code, text.count("\n")) == (2, 1)
    assert "did you mean 'agents'?" in text
