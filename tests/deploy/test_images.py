"""An agent's images: the base that fits its machine, files, our rules for them, how containers start."""

import contextlib
import json
import re
import shutil
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path

import pytest
from esslingen import RELEASE, deployed, program

from sfglab.deploy.bases import base_of
from sfglab.deploy.deployment import Deployment
from sfglab.deploy.dockerfile import _quoted, image_files
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import PROGRAM
from sfglab.fleet.fleet_file import Accelerator, Architecture, RosDistribution


def deployment(agent: str = "workstation", **host) -> Deployment:
    made = deployed(agent)
    return replace(made, host=replace(made.host, **host))


def with_ros(made: Deployment, ros: RosDistribution) -> Deployment:
    return replace(made, fleet=deployed(ros=ros).fleet)


def made_for(accelerator: Accelerator, architecture: Architecture, ros: RosDistribution):
    return with_ros(replace(deployment(architecture=architecture), accelerator=accelerator), ros)


def possible() -> Iterator[Deployment]:
    """Yield a deployment for every machine and every ROS that there is a base image for."""
    for one in product(Accelerator, Architecture, RosDistribution):
        made = made_for(*one)
        with contextlib.suppress(DeployError):
            base_of(made)
            yield made


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
        ("jetson arm64 jazzy", "allowed at deployment.ros with it: none, humble"),
        ("cuda arm64 none", "allowed with it: amd64"),
        ("jetson amd64 none", "architecture: given 'amd64'.*allowed with it: arm64"),
    ],
)
def test_what_no_maker_offers_is_refused(machine, words):
    accelerator, architecture, ros = machine.split()
    parts = (Accelerator(accelerator), Architecture(architecture), RosDistribution(ros))
    with pytest.raises(DeployError, match=words):
        base_of(made_for(*parts))


def test_a_workspace_without_ros_is_refused():
    made = with_ros(deployment(workspace="ws"), RosDistribution.NONE)
    with pytest.raises(DeployError, match=r"host\.workspace: given 'ws'.*allowed.*humble, jazzy"):
        image_files(made)


def test_three_layers_follow_each_other_no_image_runs_as_root_and_only_arm64_compiles_cyclone():
    workspace = deployment("go2", workspace="ws", packages=("usb",), launch=("ros2", "run"))
    for made in (*possible(), workspace):
        files = image_files(made)
        text = files["Dockerfile"].text
        below = {
            name: image for image, name in re.findall(r"^FROM (\S+) AS (\S+)$", text, re.MULTILINE)
        }
        names = ("base", "adapter", "application", "development")
        assert [below[name] for name in names] == ["${BASE_IMAGE}", *names[:3]]
        for layer in text.partition(" AS application\n")[2].split("\nFROM "):
            assert re.findall("^USER (.*)", layer, re.MULTILINE)[-1] in {"10001:10001", "sfglab"}
        assert not re.search(r"^(ADD|COPY \.)|\| *(sudo )?(ba)?sh\b", text, re.MULTILINE)
        arm = made.host.architecture is Architecture.ARM64
        assert ("cyclonedds" in below) is arm
        assert ("cyclonedds==" in files["image/requirements.lock"].text) is not arm
        assert ("image/cyclonedds.lock" in files) is arm
        assert ("!workspace/src" in files[".dockerignore"].text) is (made is workspace)


def test_without_ros_nothing_of_it_is_in_the_images_and_a_workspace_is_built_apart():
    text = image_files(with_ros(deployment(), RosDistribution.NONE))["Dockerfile"].text
    assert not re.search("packages.ros.org|/opt/ros", text)
    text = image_files(deployment(workspace="ws"))["Dockerfile"].text
    assert text.index("AS workspace") < text.index("colcon build") < text.index("AS application")
    assert "COPY --from=workspace /opt/workspace /opt/workspace" in text


def test_a_new_wheel_changes_only_what_comes_after_all_else():
    made = deployment()
    new = replace(made, release=replace(RELEASE, wheel_sha256="cd" * 32))
    old, other = (image_files(each)["Dockerfile"].text.splitlines() for each in (made, new))
    changed = [n for n, (one, two) in enumerate(zip(old, other, strict=True)) if one != two]
    assert len(changed) == 2  # in the installation, and in a label
    before = [line for line in old[: changed[0]] if line.startswith(("RUN ", "COPY "))]
    assert before[-2].endswith(
        "/etc/sfglab/fleet.yaml"
    )  # the last is the installation of the wheel
    assert before[-1].startswith("RUN ")


def test_any_text_can_be_a_label():
    text = "quotes \" and ', $HOME, back\\slash\nline\u2028"
    quoted = _quoted(text)
    assert "\n" not in quoted
    assert json.loads(quoted.replace("\\$", "$")) == text
    assert quoted.count("$") == quoted.count("\\$") == 1


class Container:
    """The entrypoint as a container starts it, with a stand-in for sfglab."""

    def __init__(self, folder: Path, sfglab: str, launch: str) -> None:
        started = program(folder / "sfglab", sfglab)
        made = with_ros(deployment(launch=("sh", "-c", launch)), RosDistribution.NONE)
        file = image_files(made)["image/entrypoint.sh"]
        assert file.mode == PROGRAM
        self.script = folder / "entrypoint.sh"
        self.script.write_text(file.text.replace("/opt/venv/bin/sfglab", str(started)))

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        shell = shutil.which("dash") or "sh"
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return subprocess.Popen([shell, self.script, *arguments], **pipes, start_new_session=True)

    def run(self, *arguments: str) -> tuple[int, str]:
        with self.start(*arguments) as process:
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
def test_whoever_ends_first_ends_the_container_with_its_status(tmp_path, sfglab, launch, status):
    assert Container(tmp_path, sfglab, launch).run("agent", "up")[0] == status


def test_a_signal_reaches_both_and_the_agent_says_how_it_ended(tmp_path):
    hear = "trap 'echo {0} ended; exit {1}' TERM; echo {0} ready; while :; do sleep 0.02; done"
    container = Container(tmp_path, hear.format("agent", 0), hear.format("launch", 7))
    with container.start("agent", "up") as process:
        assert process.stdout is not None
        ready = {process.stdout.readline(), process.stdout.readline()}
        process.send_signal(signal.SIGTERM)
        said, _ = process.communicate(timeout=20)
    assert ready == {"agent ready\n", "launch ready\n"}
    assert set(said.splitlines()) == {"agent ended", "launch ended"}
    assert process.returncode == 0


def test_the_users_software_is_started_beside_an_agent_alone(tmp_path):
    container = Container(tmp_path, 'echo "sfglab $*"', "echo launched; exec sleep 60")
    assert container.run("router", "--agent", "go2") == (0, "sfglab router --agent go2\n")
