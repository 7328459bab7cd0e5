"""`sfglab deploy` as a user meets it: the paper's fleet, broken ones, a folder in place of a machine."""

import functools
import json
from dataclasses import replace

import pytest
from commands import called
from esslingen import FILE as FLEET
from example_machines import write_example

from sfglab.deploy.checks import CHECKS
from sfglab.deploy.release import make_release

made_once = functools.cache(make_release)


@pytest.fixture(autouse=True)
def release_is_made_once(monkeypatch):
    monkeypatch.setattr("sfglab.deploy.release.make_release", made_once)


def call(*arguments, status=0):
    return called("deploy", *map(str, arguments), status=status)


def test_a_check_that_was_not_run_fails_only_if_it_is_required(monkeypatch):
    missing = replace(CHECKS[0], program="sfglab-no-such-program")
    monkeypatch.setattr("sfglab.deploy.checks.CHECKS", (missing,))
    said = call("check", FLEET, "--agent", "pi1")
    assert "1 passed, 1 not run, 0 failed" in said
    assert call("check", FLEET, "--agent", "pi1", "--require", status=1) == said


def test_a_check_prints_errors_of_the_fleet_file_and_renders_nothing(tmp_path):
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET.read_text().replace("global: {domain: 0, interface: wlan0}\n", ""))
    said = call("check", path, status=1)
    assert "no key names the interface over which go2 reaches the other agents" in said
    assert "0 passed, 0 not run, 1 failed" in said
    (verdict,) = json.loads(call("check", path, "--json", status=1))
    assert (verdict["check"], verdict["state"]) == ("fleet file", "failed")


def test_a_fleet_is_planned_applied_and_taken_back_on_a_folder_in_place_of_a_machine(tmp_path):
    machine = ("--agent", "steamdeck", "--root", tmp_path)
    assert "new     all 26 files" in call("plan", FLEET, *machine)
    assert list(tmp_path.iterdir()) == []
    applied = call("apply", FLEET, *machine)
    assert "skipped on a folder in place of a machine: restart sfglab-steamdeck.service" in applied
    assert "nothing to do" in call("plan", FLEET, *machine)
    assert (tmp_path / "etc/systemd/system/sfglab-steamdeck.service").exists()
    (kept,) = call("releases", FLEET, *machine).split()[1:]
    other = tmp_path / "other.yaml"
    other.write_text(FLEET.read_text().replace("model: Steam Deck OLED", "model: Steam Deck LCD"))
    call("apply", other, *machine)
    compose = tmp_path / "opt/sfglab/steamdeck/.env"
    assert kept not in compose.read_text()
    call("apply", other, *machine, "--tag", kept)
    assert kept in compose.read_text()
    assert kept in " ".join(call("apply", FLEET, *machine, "--tag", "0.0-none", status=1).split())


def test_a_machine_that_cannot_be_reached_for_detection_does_not_keep_the_others_from_their_plan(
    tmp_path,
):
    path = tmp_path / "fleet.yaml"
    text = FLEET.read_text().replace(
        "deck@steamdeck.local, accelerator: vaapi", "deck@nowhere.invalid"
    )
    path.write_text(text.replace("address: sfg@pi1.local", "address: localhost"))
    said = call("plan", path, "--agent", "steamdeck", "--agent", "pi1", status=1)
    assert "deck@nowhere.invalid: ssh" in said
    assert "localhost/esslingen/pi1:" in said


def test_on_a_folder_in_place_of_a_machine_detection_looks_there(tmp_path):
    root = write_example("steam_deck", tmp_path / "deck")
    options = ("--agent", "workstation", "--accelerator", "auto", "--root", root)
    call("apply", FLEET, *options)
    assert "/dev/dri:/dev/dri" in (root / "opt/sfglab/workstation/current/compose.yaml").read_text()
