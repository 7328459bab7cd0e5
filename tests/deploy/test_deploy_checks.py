"""Checks by other programs: each finds a fault in its file, and one that is missing is named."""

import sys
from dataclasses import replace

import pytest
from esslingen import FLEET, GO2, deployed, needs
from esslingen import program as shell_program

from sfglab.deploy.bundle import Member, bundle_of
from sfglab.deploy.checks import CHECKS, State, check_bundles, check_fleet, render_verdicts
from sfglab.deploy.errors import MissingProgramError
from sfglab.deploy.programs import find_program
from sfglab.fleet.fleet_file import RosDistribution

BUNDLE = bundle_of(GO2, b"wheel")
BY_NAME = {check.name: check for check in CHECKS}


def changed(path, old, new):
    """Return the go2's files with a text in one of them replaced."""
    member = BUNDLE.members[path]
    text = member.data.decode()
    assert old in text
    member = Member(data=text.replace(old, new).encode(), mode=member.mode)
    return replace(BUNDLE, members=BUNDLE.members | {path: member})


def result(monkeypatch, name, *bundles):
    monkeypatch.setattr("sfglab.deploy.checks.CHECKS", (BY_NAME[name],))
    (verdict,) = check_bundles(bundles)
    return verdict


UNIT = "systemd/sfglab-go2.service"
CONTAINER = ".devcontainer/devcontainer.json"


@pytest.mark.parametrize(
    ("name", "path", "old", "new", "says"),
    [
        pytest.param(name, *fault, marks=needs(BY_NAME[name].program))
        for name, *fault in [
            ("Compose files", "compose.yaml", "read_only", "readonly", "'readonly'"),
            ("dev container files", CONTAINER, '"service"', '"servce"', "'servce'"),
            ("dev container files", CONTAINER, '"sfglab"', '"root"', "remoteUser"),
            ("dev container files", CONTAINER, "redhat.vscode-yaml", "yaml", "'yaml'"),
            ("Dockerfiles", "Dockerfile", "USER 10001:10001", "CMD a\nCMD b", "DL3025"),
            ("shell scripts", "hooks/10-time.sh", "apply() {", "apply() {\n    rm $1", "SC2086"),
            ("service units", UNIT, "ProtectHome=yes", "ProtectHome=maybe", "go2.service:34"),
        ]
    ],
)
def test_a_fault_is_found_by_the_program_of_its_file(monkeypatch, name, path, old, new, says):
    verdict = result(monkeypatch, name, changed(path, old, new))
    assert verdict.state is State.FAILED
    assert says in verdict.detail


@pytest.mark.slow
def test_every_kind_of_file_passes_the_programs_that_are_installed():
    workspace = replace(GO2.host, workspace="ws", packages=("libusb-1.0-0",))
    odd = ("ros2", "launch", "my robot", "it's.py", "$HOME")
    made = [
        replace(GO2, host=workspace),
        deployed("pi1", ros=RosDistribution.NONE),
        replace(deployed("steamdeck"), host=replace(GO2.host, launch=odd)),
        deployed("workstation"),
    ]
    bundles = []
    for number, deployment in enumerate(made):
        bundles.append(replace(bundle_of(deployment, b"wheel"), agent=f"agent{number}"))
    verdicts = list(check_bundles(bundles))
    assert [verdict for verdict in verdicts if verdict.state is State.FAILED] == []
    assert {verdict.check for verdict in verdicts} == set(BY_NAME)


@needs("hadolint")
def test_equal_files_of_agents_are_read_once(monkeypatch):
    twin = replace(BUNDLE, agent="twin")
    assert result(monkeypatch, "Dockerfiles", BUNDLE, twin).files == 1
    other = replace(changed("Dockerfile", "AS base", "AS base\nRUN true"), agent="other")
    verdict = result(monkeypatch, "Dockerfiles", BUNDLE, other)
    assert (verdict.files, verdict.state) == (2, State.PASSED)


@needs("systemd-analyze")
def test_a_program_that_this_host_lacks_is_no_fault_of_a_unit(monkeypatch):
    unit = changed(UNIT, "ExecStart=docker", "ExecStart=no-such-docker")
    assert result(monkeypatch, "service units", unit).state is State.PASSED


@pytest.fixture
def programs(monkeypatch, tmp_path):
    """Return the folder of the only programs that are installed."""
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    return tmp_path


def test_a_missing_program_is_named_with_the_way_to_install_it(monkeypatch, programs):
    verdict = result(monkeypatch, "Dockerfiles", BUNDLE)
    assert verdict.state is State.NOT_RUN
    assert verdict.detail == "hadolint is not installed: pip install '.[deploy]'"


def test_docker_without_its_compose_plug_in_is_not_run(monkeypatch, programs):
    shell_program(programs / "docker", 'echo "unknown command: $*" >&2; exit 1')
    verdict = result(monkeypatch, "Compose projects", BUNDLE)
    assert verdict.state is State.NOT_RUN
    assert "docker compose is not installed: install Docker with" in verdict.detail


def test_compose_reads_each_project_with_the_variables_of_the_hooks(monkeypatch, programs):
    reads = 'test "$2" = version || { echo "$*, $SFGLAB_TAG" >&2; test -f "$3" && test "$3" != go2/compose.yaml; }'
    shell_program(programs / "docker", reads)
    other = replace(changed("compose.yaml", "go2", "other"), agent="other")
    verdict = result(monkeypatch, "Compose projects", BUNDLE, other)
    assert verdict.state is State.FAILED
    assert verdict.detail == "compose --file go2/compose.yaml config --quiet, checked"


def test_a_program_that_fails_without_a_word_fails_its_check(monkeypatch, programs):
    shell_program(programs / "hadolint", "exit 4")
    verdict = result(monkeypatch, "Dockerfiles", BUNDLE)
    assert verdict.state is State.FAILED
    assert verdict.detail == "hadolint ended with status 4 and no message"


def test_a_program_that_does_not_finish_fails_its_check(monkeypatch, programs):
    monkeypatch.setattr("sfglab.deploy.checks._LIMIT_S", 0.2)
    shell_program(programs / "hadolint", "exec sleep 60")
    assert "hadolint did not finish" in result(monkeypatch, "Dockerfiles", BUNDLE).detail


def test_errors_of_the_fleet_file_fail():
    assert check_fleet(FLEET).state is State.PASSED
    agents = tuple(replace(agent, domain=1) for agent in FLEET.agents)
    verdict = check_fleet(replace(FLEET, agents=agents))
    assert verdict.state is State.FAILED
    assert "domain-shared" in verdict.detail


def test_a_table_has_each_check_the_output_of_its_program_and_counts(monkeypatch, programs):
    shell_program(programs / "hadolint", "echo Dockerfile:1 DL3007; exit 1")
    verdict = result(monkeypatch, "Dockerfiles", BUNDLE)
    assert render_verdicts([verdict, check_fleet(FLEET)]).splitlines() == [
        "result  check        program            files",
        "failed  Dockerfiles  hadolint           1",
        "    Dockerfile:1 DL3007",
        "passed  fleet file   sfglab fleet lint  1",
        "1 passed, 0 not run, 1 failed",
    ]


def test_a_program_is_found_beside_python_first_then_on_the_path(monkeypatch, tmp_path):
    for folder in ("beside", "path"):
        shell_program(tmp_path / folder / "tool")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "beside" / "python"))
    monkeypatch.setenv("PATH", str(tmp_path / "path"))
    assert find_program("tool") == str(tmp_path / "beside" / "tool")
    (tmp_path / "beside" / "tool").unlink()
    assert find_program("tool") == str(tmp_path / "path" / "tool")
    (tmp_path / "path" / "tool").unlink()
    with pytest.raises(MissingProgramError, match="apt install tool"):
        find_program("tool", "apt install tool")
