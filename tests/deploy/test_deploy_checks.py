"""Checks by other programs: each finds a fault in its file, and one that is missing is named."""

import sys
from dataclasses import replace

import pytest
from esslingen import FLEET, GO2, deployed, needs
from esslingen import program as shell_program

from sfglab.deploy.bundle import bundle_of
from sfglab.deploy.checks import CHECKS, State, check_bundles, check_fleet, render_verdicts
from sfglab.deploy.files import text_file
from sfglab.fleet.fleet_file import RosDistribution

BUNDLE = bundle_of(GO2, b"wheel")
BY_NAME = {check.name: check for check in CHECKS}


def changed(path, *pairs):
    """Return the go2's files with texts in one of them replaced."""
    text = BUNDLE.members[path].text
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new)
    return replace(BUNDLE, members=BUNDLE.members | {path: text_file(text)})


def result(monkeypatch, name, *bundles):
    monkeypatch.setattr("sfglab.deploy.checks.CHECKS", (BY_NAME[name],))
    (verdict,) = check_bundles(bundles)
    return verdict


UNIT = "systemd/sfglab-go2.service"
CONTAINER = ".devcontainer/devcontainer.json"
BENT = (('"service"', '"servce"'), ('"sfglab"', '"root"'), ("redhat.vscode-yaml", "yaml"))


@pytest.mark.parametrize(
    ("name", "path", "pairs", "says"),
    [
        pytest.param(name, *fault, marks=needs(BY_NAME[name].program))
        for name, *fault in [
            ("Compose files", "compose.yaml", [("read_only", "readonly")], ["'readonly'"]),
            ("dev container files", CONTAINER, BENT, ["'servce'", "remoteUser", "'yaml'"]),
            ("Dockerfiles", "Dockerfile", [("USER 10001:10001", "CMD a\nCMD b")], ["DL3025"]),
            ("shell scripts", "hooks/10-time.sh", [("apply() {", "a() {\nrm $1")], ["SC2086"]),
            ("service units", UNIT, [("Home=yes", "Home=maybe")], ["go2.service:34"]),
        ]
    ],
)
def test_a_fault_is_found_by_the_program_of_its_file(monkeypatch, name, path, pairs, says):
    verdict = result(monkeypatch, name, changed(path, *pairs))
    assert verdict.state is State.FAILED
    for text in says:
        assert text in verdict.detail


@pytest.mark.slow
def test_every_kind_of_file_passes_the_programs_that_are_installed():
    odd = ("ros2", "launch", "my robot", "it's.py", "$HOME")
    host = {"workspace": "ws", "packages": ("libusb-1.0-0",), "launch": odd}
    full = bundle_of(deployed(host=host), b"wheel")
    plain = bundle_of(deployed("pi1", ros=RosDistribution.NONE), b"wheel")
    verdicts = {verdict.check: verdict for verdict in check_bundles([full, plain])}
    assert set(verdicts) == set(BY_NAME)
    for verdict in verdicts.values():
        assert verdict.state is not State.FAILED, verdict.detail


@needs("systemd-analyze")
def test_a_program_that_this_host_lacks_is_no_fault_of_a_unit(monkeypatch):
    unit = changed(UNIT, ("ExecStart=docker", "ExecStart=no-such-docker"))
    assert result(monkeypatch, "service units", unit).state is State.PASSED


@pytest.fixture
def programs(monkeypatch, tmp_path):
    """Return the folder of the only programs that are installed."""
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    return tmp_path


def test_a_program_or_plug_in_that_is_missing_is_named_with_the_way_to_install_it(
    monkeypatch, programs
):
    verdict = result(monkeypatch, "Dockerfiles", BUNDLE)
    assert verdict.state is State.NOT_RUN
    assert verdict.detail == "hadolint is not installed; to mend this: pip install '.[deploy]'"
    shell_program(programs / "docker", 'echo "unknown command: $*" >&2; exit 1')
    verdict = result(monkeypatch, "Compose projects", BUNDLE)
    assert verdict.state is State.NOT_RUN
    assert "docker compose is not installed; to mend this: install Docker with" in verdict.detail


def test_compose_reads_each_project_with_the_variables_of_the_hooks(monkeypatch, programs):
    reads = 'test "$2" = version || { echo "$*, $SFGLAB_TAG" >&2; test -f "$3" && test "$3" != go2/compose.yaml; }'
    shell_program(programs / "docker", reads)
    verdict = result(monkeypatch, "Compose projects", BUNDLE, replace(BUNDLE, agent="other"))
    assert (verdict.state, verdict.files) == (State.FAILED, 2)
    assert verdict.detail == "compose --file go2/compose.yaml config --quiet, checked"


@pytest.mark.parametrize(
    ("program", "detail"),
    [
        ("#!/bin/sh\nexit 4", "hadolint ended with status 4 and no message"),
        ("#!/bin/sh\nexec sleep 60", "hadolint did not finish"),
        ("#!/nowhere", "hadolint did not finish"),
    ],
)
def test_a_program_without_a_message_an_end_or_a_start_fails_its_check(
    monkeypatch, programs, program, detail
):
    monkeypatch.setattr("sfglab.deploy.checks._LIMIT_S", 0.3)
    shell_program(programs / "hadolint").write_text(program)
    verdict = result(monkeypatch, "Dockerfiles", BUNDLE)
    assert verdict.state is State.FAILED
    assert detail in verdict.detail


def test_a_check_without_files_fails(monkeypatch, programs):
    shell_program(programs / "hadolint")
    verdict = result(monkeypatch, "Dockerfiles", replace(BUNDLE, members={}))
    assert (verdict.state, verdict.detail) == (State.FAILED, "no agent has a file Dockerfile")


def test_a_table_has_each_check_its_different_files_the_output_of_its_program_and_counts(
    monkeypatch, programs
):
    shell_program(programs / "hadolint", "echo $#; exit $(($# - 2))")
    twin = replace(BUNDLE, agent="twin")
    other = replace(changed("Dockerfile", ("AS base", "AS base\nRUN true")), agent="other")
    verdicts = [result(monkeypatch, "Dockerfiles", BUNDLE, twin), check_fleet(FLEET)]
    verdicts.append(result(monkeypatch, "Dockerfiles", BUNDLE, twin, other))
    assert render_verdicts(verdicts).splitlines() == [
        "result  check        program            files",
        "passed  Dockerfiles  hadolint           1",
        "passed  fleet file   sfglab fleet lint  1",
        "failed  Dockerfiles  hadolint           2",
        "    3",
        "2 passed, 0 not run, 1 failed",
    ]
