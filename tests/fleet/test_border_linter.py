"""The border linter: one test per mistake, and who hears what."""

from __future__ import annotations

from pathlib import Path

import pytest

from sfglab.fleet.fleet_file import load_fleet, read_fleet
from sfglab.fleet.lint import CHECKS, Severity, View, lint, lint_file, render
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


def agents(**inner: str) -> str:
    return "\n".join(
        f"  {name}: {{domain: {i}, {text}}}" for i, (name, text) in enumerate(inner.items(), start=1)
    )


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


def test_every_finding_says_place_what_why_and_errors_a_remedy():
    for f in lint(load_fleet(BROKEN)).findings:
        assert f.place.line > 0
        assert f.place.key
        assert f.what
        assert f.why
        if f.severity is not Severity.INFO:
            assert f.remedy


def test_findings_come_worst_first():
    severities = [f.severity for f in lint(load_fleet(BROKEN)).findings]
    assert severities == sorted(severities, key=list(Severity).index)


def test_agents_of_one_domain_and_of_the_global_one_are_errors():
    report = report_of("  a1: {domain: 5}\n  a2: {domain: 5}\n  a3: {domain: 0}\n  a4: {domain: 102}")
    assert one(report, "domain-shared").what == "a2 and a1 both use domain 5"
    assert one(report, "domain-global").severity is Severity.ERROR
    assert one(report, "domain-high").severity is Severity.WARNING


@pytest.mark.parametrize("name", ["/chatter", "/local/a1/x", "/globally/a1/x", "/tf2", "/local/global/a1/x"])
def test_a_topic_that_another_agent_waits_for_and_that_does_not_cross_is_an_error(name):
    report = report_of(agents(a1=f"publishes: [{name}]", a2=f"subscribes: [{name}]"))
    finding = one(report, "does-not-cross")
    assert finding.severity is Severity.ERROR
    assert finding.place.key == "agents.a2.subscribes[0]"
    assert "/global/a1/" in finding.remedy


def test_a_local_topic_with_a_publisher_in_the_same_agent_is_fine():
    both = "publishes: [/chatter], subscribes: [/chatter]"
    assert "does-not-cross" not in codes(report_of(agents(a1=both, a2=both)))


def test_a_name_that_nearly_begins_with_global_is_a_warning_with_the_right_name():
    report = report_of(agents(a1="publishes: [/global_x/a1/state]"))
    assert one(report, "nearly-global").remedy.endswith("/global/a1/state")


def test_a_crossing_name_outside_the_schema_is_a_warning_a_staying_one_is_not():
    report = report_of(agents(a1="publishes: [/global/a1/odd__name_x, /scan]".replace("__", "_")))
    assert codes(report, Severity.WARNING) == set()
    assert one(report, "local-outside-schema").severity is Severity.INFO
    report = report_of(agents(a1="publishes: [/global/a1/lidar/points/b/c/d]"))
    assert one(report, "not-in-schema").severity is Severity.WARNING


def test_a_subscriber_that_nobody_speaks_to_and_an_agent_that_there_is_not_are_warned_of():
    report = report_of(agents(pi1="lifecycle: true", pi2="subscribes: [/global/pi3/battery_state]"))
    assert one(report, "nobody-speaks").place.key == "agents.pi2.subscribes[0]"
    assert "did you mean" in one(report, "unknown-agent").what


def test_two_publishers_of_one_agents_topic_are_warned_of():
    report = report_of(agents(a1="publishes: [/global/a1/pose]", a2="publishes: [/global/a1/pose]"))
    assert one(report, "two-publishers").what == "a2 publishes /global/a1/pose, as a1 itself does"
    command = agents(a1="subscribes: [/global/a1/cmd_vel]", a2="publishes: [/global/a1/cmd_vel]")
    assert "two-publishers" not in codes(report_of(command))


def test_a_call_without_server_and_a_server_out_of_reach_are_errors():
    report = report_of(agents(a1="calls: [/global/a2/reset]", a2="serves: [/local/a2/set_mode]"))
    assert one(report, "no-server").severity is Severity.ERROR
    report = report_of(agents(a1="calls: [/local/a2/set_mode]", a2="serves: [/local/a2/set_mode]"))
    assert one(report, "does-not-cross").place.key == "agents.a1.calls[0]"
    fine = agents(a1="calls: [/global/a2/set_mode]", a2="serves: [/global/a2/set_mode]")
    assert codes(report_of(fine), Severity.ERROR) == set()


def test_two_agents_that_serve_one_crossing_name_are_an_error():
    report = report_of(agents(a1="serves: [/global/a1/reset]", a2="serves: [/global/a1/reset]"))
    assert one(report, "two-servers").severity is Severity.ERROR
    report = report_of(agents(a1="serves: [/local/a1/reset]", a2="serves: [/local/a1/reset]"))
    assert "two-servers" not in codes(report)


@pytest.mark.parametrize("missing", ["rq/global/*", "rr/global/*"])
def test_a_policy_with_half_of_services_is_found_in_its_rules_and_in_every_service(missing):
    rules = [r for r in ("rt/global/*", "rq/global/*", "rr/global/*") if r != missing]
    policy = f"policy: [{', '.join(rules)}]"
    uses = agents(
        a1="serves: [/global/a1/reset]",
        a2="calls: [/global/a1/reset], action_clients: [/global/a1/follow_path]",
    )
    report = report_of(uses, policy)
    assert one(report, "half-open-rule").place.key == f"policy[{len(rules) - 1}]"
    whats = " ".join(f.what for f in report.findings if f.code == "half-open")
    assert "service /global/a1/reset is half open: 1 of its 2" in whats
    assert "action /global/a1/follow_path is half open: 5 of its 8" in whats


def test_services_that_cross_one_way_only_are_half_open():
    policy = "policy: [rt/tf, {pattern: rq/global/*, directions: [outward]}, rr/global/*]"
    assert "half-open-rule" in codes(report_of(agents(a1="serves: [/global/a1/reset]"), policy))


def test_names_that_a_dds_router_breaks_are_errors_where_they_cross():
    report = report_of(agents(a1="serves: [/global/a1/arm/setRequest, /local/a1/setReply]"))
    finding = one(report, "router-hazard")
    assert "'setRequest'" in finding.what


def test_types_and_qos_of_those_who_hear_each_other_must_match():
    uses = agents(
        a1="publishes: [{name: /global/a1/pose, type: x/msg/A, qos: sensor_data}]",
        a2="subscribes: [{name: /global/a1/pose, type: x/msg/B, qos: latched}]",
    )
    report = report_of(uses)
    assert one(report, "type-mismatch").place.key == "agents.a2.subscribes[0]"
    assert "RELIABLE" in one(report, "qos-mismatch").why
    assert "TRANSIENT_LOCAL" in one(report, "qos-mismatch").why
    apart = uses.replace("/global/", "/local/")
    assert not {"type-mismatch", "qos-mismatch"} & codes(report_of(apart))


@pytest.mark.parametrize("side", ["publishes", "subscribes"])
def test_static_transforms_that_are_not_latched_are_an_error_on_either_side(side):
    report = report_of(agents(a1=f"{side}: [{{name: /tf_static, qos: default}}]"))
    assert one(report, "static-not-latched").severity is Severity.ERROR
    assert "static-not-latched" not in codes(
        report_of(agents(a1=f"{side}: [{{name: /tf_static, qos: latched}}]"))
    )


def test_a_sensor_that_cannot_be_announced_is_an_error():
    stream = (
        "{topic: /local/a1/camera/color/ffmpeg, type: x/msg/Y, codec: h264, width: 1, height: 1, rate_hz: 1}"
    )
    report = report_of(agents(a1=f"sensors: [{{name: camera, streams: [{stream}]}}]"))
    assert "stay inside" in one(report, "description").what


def test_who_hears_what_names_agents_and_the_rule():
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


def test_an_agent_without_lifecycle_is_neither_asked_nor_heard():
    view = View(read_fleet("fleet: f\nagents: {a1: {domain: 1}, a2: {domain: 2, lifecycle: false}}"))
    assert not [use for use in view.uses if use.agent == "a2"]
    assert (ResourceKind.SERVICE, "/global/a2/get_metadata") not in view.meetings


def test_the_text_shows_everything_and_its_exit_code():
    text, code = lint_file(BROKEN)
    assert code == 1
    assert text == render(lint(load_fleet(BROKEN)))
    for title in ("who hears what", "discovery between hosts", "across each border", "broken: "):
        assert title in text
    assert "broken.yaml:" in text


def test_a_file_that_is_no_fleet_gives_one_line_and_exit_code_2(tmp_path):
    path = tmp_path / "x.yaml"
    path.write_text("fleet: x\nagnets: {}\n")
    text, code = lint_file(path)
    assert (code, text.count("\n")) == (2, 1)
    assert "did you mean 'agents'?" in text


def test_every_check_is_listed_once():
    assert len(set(CHECKS)) == len(CHECKS)
