"""Test hosts leave nothing behind, however they end."""

import json
import os
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil
import pytest
from waiting import program

from sfglab.lab.hosts import Network
from sfglab.lab.hosts.host import members

pytestmark = pytest.mark.netns
TIMEOUT_S = 60
PYTHON = [sys.executable, "-I", "-S", "-c"]

# A guest that ignores every polite signal, with a daemon that has left its session.
STUBBORN = """
import os, signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
signal.signal(signal.SIGINT, signal.SIG_IGN)
if os.fork() == 0:
    os.setsid()
    if os.fork():
        os._exit(0)
    print(os.getpid(), flush=True)
time.sleep(1000)
"""
CREATOR = """
import json, subprocess, sys, time
from sfglab.lab.hosts import Network
from sfglab.rtps import Medium
with Network(grace_s=0.2) as net:
    hosts = [net.add_host("edge"), net.add_host("station")]
    guests = [h.popen([sys.executable, "-I", "-S", "-c", sys.argv[1]], stdout=subprocess.PIPE, text=True)
              for h in hosts]
    daemons = [int(guest.stdout.readline()) for guest in guests]
    net.set_radio(Medium())
    hub = net._running._process.pid
    print(json.dumps({"hub": hub, "holders": [h._holder for h in hosts],
        "inodes": [h.inode for h in hosts], "guests": [g.pid for g in guests], "daemons": daemons}), flush=True)
    time.sleep(1000)
"""


def descriptors() -> set[str]:
    return {file.name for file in Path("/proc/self/fd").iterdir()}


@pytest.mark.parametrize(
    ("number", "victims"),
    [
        (signal.SIGKILL, ["creator"]),
        (signal.SIGKILL, ["hub", "creator"]),
        (signal.SIGTERM, ["creator"]),
        (signal.SIGINT, ["creator"]),
    ],
)
def test_a_killed_creator_takes_everything_with_it(number, victims):
    command = [sys.executable, "-c", CREATOR, STUBBORN]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as creator:
        made = json.loads(creator.stdout.readline())
        inside = [*made["holders"], *made["guests"], *made["daemons"]]
        assert set(members(made["inodes"])) == set(inside)
        # While they are held, no other's namespace is given their inodes.
        held = [os.open(f"/proc/{pid}/ns/net", os.O_RDONLY) for pid in made["holders"]]
        processes = [psutil.Process(pid) for pid in (made["hub"], *inside)]
        for victim in victims:
            os.kill(made.get(victim, creator.pid), number)
        _, alive = psutil.wait_procs(processes, TIMEOUT_S)
        assert alive == []
        assert creator.wait(TIMEOUT_S) != 0
    assert members(made["inodes"]) == []
    for descriptor in held:
        os.close(descriptor)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, SystemExit])
def test_an_exception_inside_the_block_cleans_up_and_passes(error):
    before = descriptors()
    with pytest.raises(error), Network() as net:  # noqa: PT012 - the block is what is tested
        host = net.add_host("edge")
        guest = host.popen(["sh", "-c", "echo; exec sleep 1000"], stdout=subprocess.PIPE)
        guest.stdout.readline()
        raise error
    guest.stdout.close()
    assert guest.returncode == -signal.SIGTERM, "an obedient guest is asked"
    assert members([host.inode]) == []
    assert descriptors() <= before


def test_an_interrupted_farewell_still_ends_everything(monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("sfglab.lab.hosts.network.end_members", interrupted)
    with pytest.raises(KeyboardInterrupt), Network() as net:  # noqa: PT012 - raised by leaving the block
        guest = net.add_host("edge").popen([*PYTHON, STUBBORN], stdout=subprocess.PIPE)
        assert guest.stdout.readline()
        inode = net.hosts["edge"].inode
    guest.stdout.close()
    assert guest.returncode == -signal.SIGKILL
    assert members([inode]) == []


def test_processes_elsewhere_are_left_alone():
    with Network(grace_s=0.2) as other, program("sleep", "1000") as outside:
        neighbour = other.add_host("edge").popen(["sleep", "1000"])
        with Network(grace_s=0.2) as net:
            net.add_host("edge").popen(["sleep", "1000"])
        assert neighbour.poll() is None
        assert outside.poll() is None


def in_a_thread(do):
    """Return what a thread returned that has ended."""
    with ThreadPoolExecutor(1) as threads:
        return threads.submit(do).result()


def test_networks_and_processes_outlive_the_threads_that_made_them():
    net = in_a_thread(Network(grace_s=0.2).__enter__)
    try:
        command = [*PYTHON, "print(1, flush=True); input(); print(2)"]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        guest = in_a_thread(lambda: net.add_host("edge").popen(command, **pipes))
        assert guest.stdout.readline() == b"1\n"
        assert guest.communicate(b"\n", timeout=TIMEOUT_S)[0] == b"2\n"
    finally:
        net.__exit__(None, None, None)


def test_a_forked_child_does_not_keep_the_network_open():
    code = """
import os, signal, sys
from sfglab.lab.hosts import Network
with Network() as net:
    net.add_host("edge")
    if os.fork() == 0:
        signal.pause()
    signal.alarm(30)
print("closed", flush=True)
os.killpg(0, signal.SIGKILL)
"""
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, capture_output=True, timeout=TIMEOUT_S, start_new_session=True, check=False
    )
    assert done.stdout == b"closed\n"
