"""`sfglab deploy` as a user meets it: the paper's fleet, broken ones, a folder in place of a machine."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from sfglab.cli import app
from sfglab.errors import SfglabError
from sfglab.lab.checks.fleet_files import BROKEN, break_fleet
from sfglab.lab.example_machines import EXAMPLES, write_example

ROOT = Path(__file__).parents[2]
FLEET = ROOT / "data" / "fleets" / "esslingen.yaml"


def call(*arguments: object):
    return CliRunner().invoke(app, ["deploy", *map(str, arguments)])


@pytest.mark.parametrize("command", ["detect", "plan", "render", "check", "apply", "releases"])
def test_every_command_helps_with_an_example(command):
    done = call(command, "--help")
    assert done.exit_code == 0
    assert f"sfglab deploy {command}" in done.output


def test_detection_says_what_was_found_why_and_which_codecs_open():
    done = call("detect")
    assert done.exit_code == 0
    assert "libx264" in done.output
    assert all(name in done.output for name in ("jetson", "cuda", "rocm", "vaapi", "v4l2"))


@pytest.mark.slow
def test_the_papers_fleet_passes_its_check():
    kinds = ("go2", "pi1", "steamdeck", "workstation")  # the other Raspberry Pis differ in name and domain
    done = call("check", FLEET, *(part for name in kinds for part in ("--agent", name)))
    assert done.exit_code == 0, done.output
    assert ", 0 failed" in done.output


@pytest.mark.parametrize("broken", [BROKEN[0], BROKEN[1]], ids=lambda broken: broken.fault)
def test_a_broken_fleet_is_refused_in_words_that_name_the_fault(broken, tmp_path):
    """One that cannot be read and one that cannot be deployed; the experiment has them all."""
    path = tmp_path / "fleet.yaml"
    path.write_text(break_fleet(FLEET.read_text(), broken))
    done = call("check", path)
    assert done.exit_code == 1
    assert isinstance(done.exception, SfglabError | SystemExit)
    words = " ".join(f"{done.output} {done.exception}".split())  # lines are wrapped
    assert [word for word in broken.words if word not in words] == []


def test_a_fleet_is_planned_applied_and_taken_back_on_a_folder_in_place_of_a_machine(tmp_path):
    machine = ("--agent", "steamdeck", "--root", tmp_path)
    planned = call("plan", FLEET, *machine)
    assert planned.exit_code == 0
    assert "new     all 26 files" in planned.output
    assert call("apply", FLEET, *machine, "--dry-run").exit_code == 0
    assert list(tmp_path.iterdir()) == []
    applied = call("apply", FLEET, *machine)
    assert applied.exit_code == 0, applied.output
    assert "skipped on a folder in place of a machine: restart sfglab-steamdeck.service" in applied.output
    assert "nothing to do" in call("plan", FLEET, *machine).output
    assert (tmp_path / "etc/systemd/system/sfglab-steamdeck.service").exists()
    (kept,) = call("releases", FLEET, *machine).output.split()[1:]
    other = tmp_path / "other.yaml"
    other.write_text(FLEET.read_text().replace("model: Steam Deck OLED", "model: Steam Deck LCD"))
    assert call("apply", other, *machine).exit_code == 0
    compose = tmp_path / "opt/sfglab/steamdeck/.env"
    assert kept not in compose.read_text()
    assert call("apply", other, *machine, "--tag", kept).exit_code == 0
    assert kept in compose.read_text()
    refused = call("apply", FLEET, *machine, "--tag", "0.0-none")
    assert refused.exit_code == 1
    assert kept in " ".join(refused.output.split())


def test_files_are_rendered_into_a_folder_for_each_agent(tmp_path):
    done = call("render", FLEET, "-o", tmp_path, "--agent", "go2", "--agent", "pi1")
    assert done.exit_code == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["go2", "pi1"]
    assert (tmp_path / "go2" / "manifest.json").exists()
    assert len(list((tmp_path / "go2" / "image").glob("*.whl"))) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--agent", "go3"), "did you mean 'go2'?"),
        (("--agent", "workstation", "--accelerator", "cuba"), "did you mean 'cuda'?"),
    ],
)
def test_an_unknown_name_is_one_sentence_with_the_likely_one(options, words, tmp_path):
    done = call("render", FLEET, "-o", tmp_path, *options)
    assert isinstance(done.exception, SfglabError)
    assert words in str(done.exception)


def test_a_machine_that_cannot_be_reached_for_detection_does_not_keep_the_others_from_their_plan(tmp_path):
    path = tmp_path / "fleet.yaml"
    text = FLEET.read_text().replace("deck@steamdeck.local, accelerator: vaapi", "deck@nowhere.invalid")
    path.write_text(text.replace("address: sfg@pi1.local", "address: localhost"))
    done = call("plan", path, "--agent", "steamdeck", "--agent", "pi1")
    assert done.exit_code == 1
    assert "deck@nowhere.invalid: ssh" in done.output
    assert "localhost/esslingen/pi1:" in done.output


def test_on_a_folder_in_place_of_a_machine_detection_looks_there(tmp_path):
    root = write_example(EXAMPLES["steam_deck"], tmp_path / "deck")
    options = ("--agent", "workstation", "--accelerator", "auto", "--root", root)
    assert call("apply", FLEET, *options).exit_code == 0
    assert "/dev/dri:/dev/dri" in (root / "opt/sfglab/workstation/compose.yaml").read_text()
