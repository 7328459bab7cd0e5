"""An agent's images: the base that fits its machine, files, our rules for them, how containers start."""

import contextlib
import json
import re
import shutil
import signal
import subprocess
from dataclasses import replace
from itertools import pairwise, product

import pytest
from esslingen import GO2, RELEASE, deployed, over_zenoh, program

from sfglab.deploy.bases import base_of
from sfglab.deploy.dockerfile import _quoted, image_files
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import PROGRAM
from sfglab.fleet.fleet_file import Accelerator, Architecture, RosDistribution


def made_for(accelerator, architecture, ros):
    host = {"accelerator": accelerator, "architecture": architecture}
    return deployed("workstation", host=host, ros=ros)


def possible():
    """Yield a deployment for every machine and every ROS that there is a base image for."""
    for one in product(Accelerator, Architecture, RosDistribution):
        made = made_for(*one)
        with contextlib.suppress(DeployError):
            base_of(made)
            yield made


def dockerfile(made):
    return image_files(made)["Dockerfile"].text


def test_every_machine_has_an_image_with_a_fixed_tag_and_the_ubuntu_of_its_ros():
    bases = {}
    for made in possible():
        base = base_of(made)
        machine = (made.accelerator.value, made.host.architecture.value)
        bases.setdefault(machine, {})[made.common.ros.value] = base.distribution.value
        assert re.fullmatch(r".*:\S*\d.*", base.image)
    of_ros = {"humble": "jammy", "jazzy": "noble"}
    plain, ubuntu = {"none": "bookworm"} | of_ros, {"none": "noble"} | of_ros
    assert bases == {
        ("jetson", "arm64"): {"none": "jammy", "humble": "jammy"},
        ("cuda", "amd64"): ubuntu,
        ("rocm", "amd64"): ubuntu,
        **dict.fromkeys(product(("vaapi", "v4l2", "none"), ("amd64", "arm64")), plain),
    }


@pytest.mark.parametrize(
    ("machine", "words"),
    [
        ("jetson arm64 jazzy", "allowed at deployment.ros with this accelerator: none, humble"),
        ("cuda arm64 none", "allowed with this accelerator: amd64"),
        ("jetson amd64 none", "architecture: given 'amd64'.*allowed with this accelerator: arm64"),
    ],
)
def test_what_no_maker_offers_is_refused(machine, words):
    accelerator, architecture, ros = machine.split()
    parts = (Accelerator(accelerator), Architecture(architecture), RosDistribution(ros))
    with pytest.raises(DeployError, match=words):
        base_of(made_for(*parts))


def test_a_workspace_without_ros_is_refused():
    made = deployed(host={"workspace": "ws"}, ros=RosDistribution.NONE)
    with pytest.raises(DeployError, match=r"host\.workspace: given 'ws'.*allowed.*humble, jazzy"):
        image_files(made)


def test_three_layers_follow_each_other_no_image_runs_as_root_and_only_arm64_compiles_cyclone():
    workspace = deployed(host={"workspace": "ws"})
    for made in (*possible(), workspace):
        files = image_files(made)
        text = files["Dockerfile"].text
        below = re.findall(r"^FROM (\S+) AS (\S+)$", text, re.MULTILINE)
        layers = ("${BASE_IMAGE}", "base", "adapter", "application", "development")
        assert set(pairwise(layers)) <= set(below)
        for layer in text.partition(" AS application\n")[2].split("\nFROM "):
            assert re.findall("^USER (.*)", layer, re.MULTILINE)[-1] in {"10001:10001", "sfglab"}
        assert not re.search(r"^(ADD|COPY \.)|\| *(sudo )?(ba)?sh\b", text, re.MULTILINE)
        arm = made.host.architecture is Architecture.ARM64
        assert (" AS cyclonedds\n" in text) is arm
        assert ("cyclonedds==" in files["image/requirements.lock"].text) is not arm
        assert ("image/cyclonedds.lock" in files) is arm
        assert ("!workspace/src" in files[".dockerignore"].text) is (made is workspace)


def test_without_ros_nothing_of_it_is_in_the_images_and_a_workspace_is_built_apart():
    text = dockerfile(deployed("workstation", ros=RosDistribution.NONE))
    assert not re.search("packages.ros.org|/opt/ros", text)
    text = dockerfile(deployed("workstation", host={"workspace": "ws"}))
    assert text.index("AS workspace") < text.index("colcon build") < text.index("AS application")
    assert "COPY --from=workspace /opt/workspace /opt/workspace" in text


def test_a_new_wheel_changes_only_what_comes_after_all_else():
    new = replace(GO2, release=replace(RELEASE, wheel_sha256="cd" * 32))
    old, other = dockerfile(GO2).splitlines(), dockerfile(new).splitlines()
    first, label = (
        n for n, lines in enumerate(zip(old, other, strict=True)) if len(set(lines)) > 1
    )
    assert "io.sfglab.wheel.sha256=" in old[label]
    *_, before, installation = (line for line in old[:first] if line.startswith(("RUN ", "COPY ")))
    assert before.endswith("/etc/sfglab/fleet.yaml")
    assert installation.startswith("RUN ")


def test_only_the_images_of_a_fleet_over_zenoh_contain_zenoh():
    for made in possible():
        for wanted, fleet in ((False, made), (True, over_zenoh(made))):
            lock = image_files(fleet)["image/requirements.lock"].text
            assert ("eclipse-zenoh==" in lock) is ("xxhash==" in lock) is wanted


def test_any_text_can_be_a_label():
    text = "quotes \" and ', $HOME, back\\slash\nline\u2028"
    quoted = _quoted(text)
    assert "\n" not in quoted
    assert json.loads(quoted.replace("\\$", "$")) == text
    assert quoted.count("$") == quoted.count("\\$") == 1


@pytest.fixture
def start(tmp_path):
    """Start the entrypoint as a container does, with a stand-in for sfglab."""

    def start(sfglab, launch, *arguments):
        host = {"launch": ("sh", "-c", launch)}
        file = image_files(deployed("workstation", host=host, ros=RosDistribution.NONE))[
            "image/entrypoint.sh"
        ]
        assert file.mode == PROGRAM
        stand_in = program(tmp_path / "sfglab", sfglab)
        script = tmp_path / "entrypoint.sh"
        script.write_text(file.text.replace("/opt/venv/bin/sfglab", str(stand_in)))
        shell = shutil.which("dash") or "sh"
        command = [shell, script, *arguments]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)

    return start


def ended(process):
    """Return a container's status, and what it has printed until its end."""
    said, _ = process.communicate(timeout=20)
    return process.returncode, said


@pytest.mark.parametrize(
    ("sfglab", "launch", "status"),
    [
        ("exit 3", "exec sleep 60", 3),
        ("exec sleep 60", "exit 4", 4),
        ("exec sleep 60", "exit 0", 0),
        ("exit 0", "exec sleep 60", 0),
    ],
)
def test_whoever_ends_first_ends_the_container_with_its_status(start, sfglab, launch, status):
    assert ended(start(sfglab, launch, "agent", "up"))[0] == status


def test_a_signal_reaches_both_and_the_agent_says_how_it_ended(start):
    hear = "trap 'echo {0} ended; exit {1}' TERM; echo {0} ready; while :; do sleep 0.02; done"
    process = start(hear.format("agent", 0), hear.format("launch", 7), "agent", "up")
    ready = {process.stdout.readline(), process.stdout.readline()}
    assert ready == {"agent ready\n", "launch ready\n"}
    process.send_signal(signal.SIGTERM)
    status, said = ended(process)
    assert set(said.splitlines()) == {"agent ended", "launch ended"}
    assert status == 0


def test_a_signal_that_is_lost_twice_is_sent_again(start):
    third = (
        "trap 'n=$((n + 1)); [ $n -lt 3 ] || exit 5' TERM; echo ready; while :; do sleep 0.02; done"
    )
    process = start(f"n=0; {third}", "exec sleep 60", "agent", "up")
    assert process.stdout.readline() == "ready\n"
    process.send_signal(signal.SIGTERM)
    assert ended(process)[0] == 5


def test_the_users_software_is_started_beside_an_agent_alone(start):
    process = start('echo "sfglab $*"', "echo launched; exec sleep 60", "router", "--agent", "go2")
    assert ended(process) == (0, "sfglab router --agent go2\n")
