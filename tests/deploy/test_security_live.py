"""Our keystores among peers of Debian's Cyclone DDS, each on a host of its own: who hears and reaches whom."""

import os
import shutil
import subprocess
import sysconfig
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from pathlib import Path

import pytest

from sfglab.deploy.keystore import make_keystore
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.hosts import Network

pytestmark = [pytest.mark.live, pytest.mark.netns]

PLUGINS = Path("/usr/lib", sysconfig.get_config_var("MULTIARCH") or "", "libddsc0debian")
IDL = "module std_msgs { module msg { module dds_ { @final struct String_ { string data; }; }; }; };"
ODOM, NOTE = "rt/global/go2/localization/odometry", "rt/global/pi2/note"
DRIVE, ASKED = "rt/global/go2/cmd_vel", "rq/global/go2/set_modeRequest"  # the fleet file lets the Steam Deck
AC = "dds_security_ac"
ENOUGH = 40  # samples, two seconds of them


@pytest.fixture
def built(tmp_path):
    lacks = [program for program in ("gcc", "idlc") if shutil.which(program) is None]
    lacks += [str(PLUGINS)] if not PLUGINS.is_dir() else []
    if lacks:
        pytest.skip(f"needs Debian's cyclonedds-dev and gcc for DDS Security: {', '.join(lacks)} missing")
    (tmp_path / "String.idl").write_text(IDL)
    source = Path(__file__).parent / "secure"
    cheat = ["gcc", "-shared", "-fPIC", source / "cheat.c", "-o", "libcheat.so"]
    peer = ["gcc", "-I.", source / "peer.c", "String.c", "-lddsc", "-o", "peer"]
    for command in (["idlc", "String.idl"], cheat, peer):
        subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    return tmp_path


class Peer:
    """A peer on a host of its own, and what it has said how often; without an enclave it has no security."""

    def __init__(self, network, folder, name, uses, enclave=None, plugin=AC):
        environment = {**os.environ, "LD_LIBRARY_PATH": f"{PLUGINS}:{folder}"}
        if enclave:
            environment["CYCLONEDDS_URI"] = (enclave / "cyclonedds.xml").read_text().replace(AC, plugin)
            environment["ROS_SECURITY_KEYSTORE"] = str(enclave.parents[1])
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        command = [folder / "peer", name, *uses.split()]
        self.process = network.add_host(name).popen(command, env=environment, **pipes)
        self.said = Counter()
        self.thread = threading.Thread(target=lambda: self.said.update(map(str.strip, self.process.stdout)))
        self.thread.start()

    def close(self):
        self.process.stdin.close()
        self.thread.join()
        self.process.stdout.close()
        assert self.process.wait() == 0


def test_only_agents_of_the_fleet_speak_and_hear_and_only_in_their_own_names(built):
    """Each that is not to be heard is heard by a friend of its own meanwhile, so that its silence counts."""
    for keys in ("ours", "theirs"):
        make_keystore(load_fleet("data/fleets/lab.yaml"), built / keys, now=datetime.now(UTC))
    ours, theirs = built / "ours/enclaves", built / "theirs/enclaves"
    everything = f"pub {ODOM} pub {DRIVE} sub {ODOM} sub {ASKED}"
    cast = {
        "go2": (f"pub {ODOM} sub {DRIVE} sub {ASKED}", ours / "go2"),
        "steamdeck": (f"sub {ODOM} sub {NOTE} pub {DRIVE} pub {ASKED} pub {ODOM}", ours / "steamdeck"),
        "pi1": (f"pub {ODOM} sub {ASKED}", ours / "pi1"),  # may neither
        "pi2": (f"pub {NOTE} pub {ODOM} pub {DRIVE} sub {ASKED}", ours / "pi2", "cheat"),  # may the first
        "stranger1": (everything,),
        "stranger2": (f"sub {ODOM}",),
        "forger1": (everything, theirs / "go2"),
        "forger2": (f"sub {ODOM}", theirs / "steamdeck"),
    }
    heard = {("go2", f"heard {DRIVE} steamdeck"), ("go2", f"heard {ASKED} steamdeck")}
    heard |= {("steamdeck", f"heard {ODOM} go2"), ("steamdeck", f"heard {NOTE} pi2")}
    heard |= {(f"{who}{i}", f"heard {ODOM} {who}1") for who in ("stranger", "forger") for i in (1, 2)}
    with Network() as network, ExitStack() as stack:
        peers = {n: stack.enter_context(closing(Peer(network, built, n, *how))) for n, how in cast.items()}
        deadline = time.monotonic() + 60
        while any(peers[name].said[line] < ENOUGH for name, line in heard):
            assert time.monotonic() < deadline, {name: dict(peer.said) for name, peer in peers.items()}
            time.sleep(0.1)
    said = {(name, line): count for name, peer in peers.items() for line, count in peer.said.items()}
    assert {key for key in said if key[1].startswith("heard")} == heard
    refused = {("steamdeck", f"pub {ODOM}"), ("pi1", f"pub {ODOM}"), ("pi1", f"sub {ASKED}")}
    assert {(who, line[8:]) for who, line in said if line.startswith("refused")} == refused
    outside = {key: n for key, n in said.items() if key[0][-2:] in ("r1", "r2") and key[1].startswith("saw")}
    assert outside == {(f"{who}2", f"saw {t}"): 1 for who in ("stranger", "forger") for t in (ODOM, DRIVE)}
