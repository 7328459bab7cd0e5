"""Real ROS 2 beside the tests: a node of rclpy in an interpreter of its own, for each distribution."""

import json
import os
import shutil
import subprocess
from dataclasses import asdict, replace
from fcntl import LOCK_EX, flock
from hashlib import sha256
from importlib import resources
from pathlib import Path

import features
import pytest
from beside import started
from commands import called

from sfglab.bus.ros.services import PYTHON_VARIABLE
from sfglab.lab import ros2
from sfglab.lab.hosts import Network
from sfglab.messages import definition
from sfglab.messages.store import type_store

#: A node that publishes, receives and reports its graph.
PEER = Path(__file__).with_name("topic_peer.py")

type_store()  # as it is without a distribution: `distribution` would else choose it for all tests after it


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Tell the experiment `ros2`, where it runs the tests, which feature a test shows and how it ended."""
    report = yield
    if "SFGLAB_FEATURES" in os.environ and (report.when == "call" or not report.passed):
        with Path(os.environ["SFGLAB_FEATURES"]).open("a", encoding="utf-8") as told:
            for row in features.rows_of(item.obj, [item.callspec.params["distribution"]]):
                ended = replace(row, outcome=report.outcome, duration_s=round(report.duration, 2))
                place = {"place": [item.path.name, item.reportinfo()[1]]}
                told.write(json.dumps(place | asdict(ended)) + "\n")
    return report


@pytest.fixture(params=ros2.TESTED)
def distribution(request, monkeypatch):
    """A distribution's name, in our environment too: it says what ROS 2 puts on the wire."""
    monkeypatch.setenv("ROS_DISTRO", request.param)
    for name in (
        "ROS_LOCALHOST_ONLY",
        "ROS_AUTOMATIC_DISCOVERY_RANGE",
        "ROS_STATIC_PEERS",
        "CYCLONEDDS_URI",
    ):
        monkeypatch.delenv(name, raising=False)
    return request.param


@pytest.fixture
def peer(distribution, domain_id):
    """A function that starts a real node, in the test's domain or on a test host; it ends with the block."""

    def start(name="peer", host=None, program=PEER, **environment):
        values = {"ROS_DOMAIN_ID": domain_id, **environment}
        if host:  # hosts of a test share /dev/shm: Fast DDS would pass the link by
            values.setdefault("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
        return started(
            name, ros2.distributions()[distribution].argv(str(program), name, **values), host
        )

    return start


@pytest.fixture
def python(distribution, monkeypatch):
    """ROS 2's interpreter, which our processes know."""
    found = str(ros2.distributions()[distribution].python)
    monkeypatch.setenv(PYTHON_VARIABLE, found)
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")  # hosts of a test share /dev/shm
    return found


def _package_of_transforms(folder):
    """Write tf2_msgs, for which there is no wheel, into a folder, and return the package's."""
    package = folder / "tf2_msgs"
    shutil.copytree(resources.files("sfglab.messages") / "interfaces" / "tf2_msgs", package)
    for name in ("TFMessage", "TF2Error"):
        file = package / "msg" / f"{name}.msg"
        file.parent.mkdir(exist_ok=True)
        file.write_text(definition(f"tf2_msgs/msg/{name}").partition("=" * 80)[0])
    return package


@pytest.fixture(scope="module")
def network(request):
    """Test hosts that a module's `DOMAINS` name."""
    with Network(grace_s=0.2) as made:
        for name in request.module.DOMAINS:
            made.add_host(name)
        yield made


@pytest.fixture
def own_types(distribution, tmp_path):
    """The ``PYTHONPATH`` on which rclpy finds tf2_msgs and our own interfaces; made when it is missing."""
    found = ros2.distributions()[distribution]
    called("interfaces", str(tmp_path))
    packages = [_package_of_transforms(tmp_path), tmp_path / "sfglab_interfaces"]
    files = [
        Path(__file__).with_name("typesupport.py"),
        *sorted(f for p in packages for f in p.rglob("*.*")),
    ]
    digest = sha256(b"".join(file.read_bytes() for file in files if file.is_file())).hexdigest()[
        :16
    ]
    made = found.python.parents[1] / "sfglab_types"
    made.mkdir(exist_ok=True)
    with (made / "lock").open("w") as lock:
        flock(lock, LOCK_EX)
        if not (made / digest / "ready").exists():
            shutil.rmtree(made / digest, ignore_errors=True)
            argv = found.argv(str(files[0]), str(made / digest), *map(str, packages))
            done = subprocess.run(argv, capture_output=True, text=True, check=False)
            assert done.returncode == 0, done.stderr
            (made / digest / "ready").touch()
    return str(made / digest / "python")
