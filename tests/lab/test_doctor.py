"""The doctor tries things, says what follows, survives a broken check, and gives no path or name away."""

import re
import socket
import sys

import pytest

from sfglab.lab import doctor
from sfglab.lab.doctor import Level, diagnose, render
from sfglab.lab.hosts import HostsUnavailableError, Network

examined = doctor._examine


@pytest.mark.live
def test_every_topic_has_a_finding_with_a_consequence_and_names_no_path_of_the_machine_nor_its_name():
    findings = diagnose()
    assert [finding.topic for finding in findings] == list(doctor._CHECKS)
    assert all(finding.said and finding.consequence for finding in findings)
    text = render(findings)
    assert all(
        f"] {f.topic}\n    found: {f.said}\n    so:    {f.consequence}" in text for f in findings
    )
    assert not re.findall(r"(?<!\w)/(?!dev/shm|proc/|sys/)\w+/\w+", text)
    assert not re.search(rf"\b{re.escape(socket.gethostname())}\b", text)


def test_a_machine_without_namespaces_gets_one_clear_error_and_is_told_what_is_done_instead(
    monkeypatch,
):
    # Stands for the refusing kernel: the script that makes namespaces fails as it does under seccomp.
    refusal = "import sys; sys.exit('unshare: Operation not permitted')"
    monkeypatch.setattr("sfglab.lab.hosts.channel.ENTER", (sys.executable, "-c", refusal))
    with (
        pytest.raises(HostsUnavailableError, match=r"unshare: Operation not permitted.*Try one of"),
        Network(),
    ):
        pass
    assert (Network.available().ok, Network.available().how) == (False, "none")
    finding = examined("network namespaces")
    assert finding.level is Level.MISSING
    assert "Operation not permitted" in finding.said
    assert "simulated" in finding.consequence


@pytest.mark.parametrize(
    ("topic", "place", "value", "word"),
    [
        ("UDP receive buffer", "sfglab.lab.doctor._RECEIVE_BUFFER_BYTES", 1 << 30, "rmem_max"),
        ("cores, memory, load", "os.getloadavg", lambda: (64.0, 64.0, 64.0), "noisy"),
    ],
)
def test_a_small_receive_buffer_and_a_busy_machine_are_called_limited(
    monkeypatch, topic, place, value, word
):
    monkeypatch.setattr(place, value)
    finding = examined(topic)
    assert finding.level is Level.LIMITED
    assert word in finding.consequence


def test_dds_that_hangs_or_crashes_is_missing_and_said_why(monkeypatch):
    monkeypatch.setattr(doctor, "_DDS_PROBE", "raise SystemExit('no such interface')")
    assert examined("DDS").said == "no such interface"
    says = "import os, signal; os.write(2, b'deaf'); signal.pause()"
    monkeypatch.setattr(doctor, "_DDS_PROBE", says)
    monkeypatch.setattr(doctor, "_DDS_TIMEOUT_S", 1.0)
    finding = examined("DDS")
    assert finding.level is Level.MISSING
    assert finding.said == "it did not end within 1 s"


def test_missing_codecs_and_a_missing_ros_are_told_apart(monkeypatch):
    monkeypatch.setitem(sys.modules, "sfglab.codecs", None)
    assert examined("H.264").level is Level.MISSING
    monkeypatch.setattr("sfglab.lab.ros2.distributions", dict)
    assert examined("ROS 2 (optional)").level is Level.LIMITED


def test_a_failed_check_becomes_a_finding_and_the_rest_goes_on(monkeypatch):
    def broken():
        raise ZeroDivisionError("at /some/where/deep/file.py")

    checks = {"odd": (broken, "nothing"), "even": (lambda: (Level.OK, "yes", "good"), "")}
    monkeypatch.setattr(doctor, "_CHECKS", checks)
    odd, even = diagnose()
    assert (odd.said, odd.consequence) == ("at file.py", "nothing")
    assert odd.level is Level.MISSING
    assert even.level is Level.OK
