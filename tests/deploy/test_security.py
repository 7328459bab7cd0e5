"""Keystores for DDS Security: who may what, what OpenSSL says of the files, what a second run leaves alone."""

import os
import re
import shutil
import subprocess
import sysconfig
import threading
import time
from collections import Counter
from contextlib import ExitStack, closing
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatchcase
from itertools import product
from pathlib import Path

import pytest
from commands import called
from esslingen import LAB

from sfglab.bus.dds.domain import DomainConfig, join
from sfglab.bus.errors import DomainError
from sfglab.deploy.errors import DeployError
from sfglab.deploy.keystore import make_keystore
from sfglab.deploy.permissions import global_rights, render_permissions
from sfglab.errors import InvalidValueError
from sfglab.fleet.fleet_file import read_fleet
from sfglab.fleet.lint import View
from sfglab.fleet.policy import Direction
from sfglab.lab.hosts import Network
from sfglab.names import ResourceKind, dds_names

NOW = datetime.now(UTC).replace(microsecond=0)
# The tags in order, as the schemas of OMG DDS Security 1.1 want them (annexes A and B).
SHAPES = {
    "permissions": "dds permissions grant subject_name validity not_before not_after"
    "( allow_rule domains id publish topics( topic)+ subscribe topics( topic)+){2} default",
    "governance": "dds domain_access_rules domain_rule domains id_range min max"
    " allow_unauthenticated_participants enable_join_access_control discovery liveliness rtps"
    " topic_access_rules topic_rule topic_expression enable_discovery_protection enable_liveliness_protection"
    " enable_read_access_control enable_write_access_control metadata data",
}


def openssl(*arguments):
    return subprocess.run(
        ["openssl", *map(str, arguments)], capture_output=True, text=True, check=False
    )


def contents(root):
    return {str(p.relative_to(root)): p.read_bytes() for p in root.rglob("*") if p.is_file()}


def published_by(fleet, agent):
    """Return the DDS topics that a fleet file has an agent publish: its topics, its replies, its requests."""
    uses = [
        (u, name)
        for u in View(fleet).uses
        if u.agent == agent
        for name in dds_names(u.name, u.kind)
    ]
    topic = ResourceKind.TOPIC
    return {
        name
        for use, name in uses
        if use.speaks == (use.kind is topic or not name.startswith("rq/"))
    }


@pytest.mark.parametrize("agent", [agent.name for agent in LAB.agents])
@pytest.mark.parametrize(
    "policy", ["table-1", "['*']", "['rt/map*', 'rt/global/*', 'rq/global/go2/x*']"]
)
def test_an_agent_publishes_what_the_policy_lets_out_under_its_name_or_as_the_file_says(
    agent, policy
):
    fleet = read_fleet(
        Path("data/fleets/lab.yaml").read_text().replace("policy: table-1", f"policy: {policy}")
    )
    agents, rights, said = (
        [a.name for a in LAB.agents],
        global_rights(fleet, agent),
        published_by(fleet, agent),
    )
    names = {name for other in agents for name in published_by(fleet, other)}
    names |= {"rt/map/x", "rt/chatter", "rt/tf", "rt/global/x"}
    prefixes = product(("rt", "rq", "rr"), ("global", "local"), [*agents, f"{agent}x"])
    names |= {f"{'/'.join(prefix)}/x/y" for prefix in prefixes}
    for name in names:
        may, hears = (
            any(fnmatchcase(name, p) for p in rights[verb]) for verb in ("publish", "subscribe")
        )
        own = name.split("/")[1:3] == ["global", agent] or name in said
        own |= name.startswith(("rt/tf", "rt/map")) and policy != "['*']"
        assert may == (own and fleet.policy.crosses(name, Direction.OUTWARD)), name
        if name.startswith("rt/"):
            assert hears == fleet.policy.crosses(name, Direction.INWARD), name
        elif name.startswith("rq/") and not name.startswith(f"rq/global/{agent}/"):
            assert not hears, name


def test_openssl_takes_what_is_signed_and_only_with_its_own_authority(tmp_path):
    one, other = tmp_path / "one", tmp_path / "other"
    for root in (one, other):
        make_keystore(LAB, root, now=NOW)
    for folder in (one / "enclaves" / agent.name for agent in LAB.agents):
        for ca, good in (
            (folder / "permissions_ca.cert.pem", True),
            (other / "public/ca.cert.pem", False),
        ):
            assert (openssl("verify", "-CAfile", ca, folder / "cert.pem").returncode == 0) == good
            for kind, shape in SHAPES.items():
                done = openssl(
                    "smime", "-verify", "-text", "-in", folder / f"{kind}.p7s", "-CAfile", ca
                )
                assert (done.returncode == 0) == good
                tags = re.sub("_protection_kind", "", " ".join(re.findall(r"<(\w+)", done.stdout)))
                assert not good or re.fullmatch(shape, tags)
        said = openssl(
            "x509", "-in", folder / "cert.pem", "-noout", "-subject", "-nameopt", "RFC2253"
        ).stdout
        text = (folder / "permissions.xml").read_text()
        assert f"<subject_name>{said.strip().removeprefix('subject=')}</subject_name>" in text
        assert re.findall("<id>(.*)</id>", text) == ["0", str(LAB.agent(folder.name).domain)]
    assert [p for p in one.rglob("*") if not p.is_symlink() and p.stat().st_mode & 0o77] == []


def test_a_second_run_adds_an_agent_and_changes_nothing_else(tmp_path):
    def states(fleet, **options):
        return [enclave.state for enclave in make_keystore(fleet, tmp_path, **options)]

    states(replace(LAB, agents=LAB.agents[:3]), now=NOW, days=10)
    before = contents(tmp_path)
    assert states(LAB, now=NOW) == ["kept"] * 3 + ["new"] * 3
    assert before.items() <= contents(tmp_path).items()
    before = contents(tmp_path)
    pi1 = replace(
        LAB.agent("pi1"), publishes=LAB.agent("steamdeck").publishes
    )  # it may drive the robot now
    moved = replace(LAB, agents=(LAB.agents[0], pi1))
    assert states(moved, now=NOW + timedelta(days=9)) == ["kept", "outdated"]
    assert contents(tmp_path) == before
    late = make_keystore(moved, tmp_path, now=NOW + timedelta(days=11), days=10**5, renew=["pi1"])
    assert [enclave.state for enclave in late] == ["expired", "renewed"]
    assert late[1].not_after == NOW + timedelta(days=3650)  # not longer than what signs
    changed = {name for name, content in contents(tmp_path).items() if before.get(name) != content}
    assert changed == {
        f"enclaves/pi1/{name}" for name in ("cert.pem", "permissions.xml", "permissions.p7s")
    }
    assert "rt/global/go2/cmd_vel" in (tmp_path / "enclaves/pi1/permissions.xml").read_text()


@pytest.mark.parametrize(
    "fault", ["private/ca.key.pem", "public/ca.cert.pem", "another key", "no keystore"]
)
def test_a_folder_that_cannot_sign_is_refused_and_left_as_it_is(fault, tmp_path):
    root, other = tmp_path / "keys", tmp_path / "other"
    for folder in (root, other):
        make_keystore(replace(LAB, agents=LAB.agents[:1]), folder, now=NOW)
    if fault == "another key":
        (root / "private/ca.key.pem").write_bytes((other / "private/ca.key.pem").read_bytes())
    elif fault != "no keystore":
        (root / fault).unlink()
    before = contents(tmp_path)
    with pytest.raises(DeployError, match=r"ca\.(key|cert)\.pem"):
        make_keystore(LAB, other / "enclaves" if fault == "no keystore" else root, now=NOW)
    assert contents(tmp_path) == before


def test_the_command_says_until_when_and_what_cannot_be_secured_is_refused(tmp_path, monkeypatch):
    command = ("fleet", "security", "data/fleets/lab.yaml", "--out", str(tmp_path), "--days", "30")
    until = f"{datetime.now(UTC) + timedelta(days=30):%Y-%m-%d}"
    assert f"go2                  new       until {until}\n" in called(*command)
    with pytest.raises(InvalidValueError, match="given 231, allowed: 0 to 230"):
        render_permissions(read_fleet("fleet: f\nagents: {a1: {domain: 231}}"), "a1", NOW, NOW)
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    monkeypatch.setenv("ROS_SECURITY_STRATEGY", "Enforce")
    with pytest.raises(DomainError, match="cannot obey"):
        join(DomainConfig(domain_id=99, interface="lo"))


PLUGINS = Path("/usr/lib", sysconfig.get_config_var("MULTIARCH") or "", "libddsc0debian")
IDL = (
    "module std_msgs { module msg { module dds_ { @final struct String_ { string data; }; }; }; };"
)
ODOM, NOTE = "rt/global/go2/localization/odometry", "rt/global/pi2/note"
DRIVE, ASKED = (
    "rt/global/go2/cmd_vel",
    "rq/global/go2/set_modeRequest",
)  # the fleet file lets the Steam Deck
AC = "dds_security_ac"
ENOUGH = 40  # samples, two seconds of them


@pytest.fixture
def built(tmp_path):
    lacks = [program for program in ("gcc", "idlc") if shutil.which(program) is None]
    lacks += [str(PLUGINS)] if not PLUGINS.is_dir() else []
    if lacks:
        pytest.skip(
            f"needs Debian's cyclonedds-dev and gcc for DDS Security: {', '.join(lacks)} missing"
        )
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
            environment["CYCLONEDDS_URI"] = (
                (enclave / "cyclonedds.xml").read_text().replace(AC, plugin)
            )
            environment["ROS_SECURITY_KEYSTORE"] = str(enclave.parents[1])
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        command = [folder / "peer", name, *uses.split()]
        self.process = network.add_host(name).popen(command, env=environment, **pipes)
        self.said = Counter()
        self.thread = threading.Thread(
            target=lambda: self.said.update(map(str.strip, self.process.stdout))
        )
        self.thread.start()

    def close(self):
        self.process.stdin.close()
        self.thread.join()
        self.process.stdout.close()
        assert self.process.wait() == 0


@pytest.mark.live
@pytest.mark.netns
def test_only_agents_of_the_fleet_speak_and_hear_and_only_in_their_own_names(built):
    """Each that is not to be heard is heard by a friend of its own meanwhile, so that its silence counts."""
    for keys in ("ours", "theirs"):
        make_keystore(LAB, built / keys, now=datetime.now(UTC))
    ours, theirs = built / "ours/enclaves", built / "theirs/enclaves"
    everything = f"pub {ODOM} pub {DRIVE} sub {ODOM} sub {ASKED}"
    cast = {
        "go2": (f"pub {ODOM} sub {DRIVE} sub {ASKED}", ours / "go2"),
        "steamdeck": (
            f"sub {ODOM} sub {NOTE} pub {DRIVE} pub {ASKED} pub {ODOM}",
            ours / "steamdeck",
        ),
        "pi1": (f"pub {ODOM} sub {ASKED}", ours / "pi1"),  # may neither
        "pi2": (
            f"pub {NOTE} pub {ODOM} pub {DRIVE} sub {ASKED}",
            ours / "pi2",
            "cheat",
        ),  # may the first
        "stranger1": (everything,),
        "stranger2": (f"sub {ODOM}",),
        "forger1": (everything, theirs / "go2"),
        "forger2": (f"sub {ODOM}", theirs / "steamdeck"),
    }
    heard = {("go2", f"heard {DRIVE} steamdeck"), ("go2", f"heard {ASKED} steamdeck")}
    heard |= {("steamdeck", f"heard {ODOM} go2"), ("steamdeck", f"heard {NOTE} pi2")}
    heard |= {
        (f"{who}{i}", f"heard {ODOM} {who}1") for who in ("stranger", "forger") for i in (1, 2)
    }
    with Network() as network, ExitStack() as stack:
        peers = {
            n: stack.enter_context(closing(Peer(network, built, n, *how)))
            for n, how in cast.items()
        }
        deadline = time.monotonic() + 60
        while any(peers[name].said[line] < ENOUGH for name, line in heard):
            assert time.monotonic() < deadline, {
                name: dict(peer.said) for name, peer in peers.items()
            }
            time.sleep(0.1)
    said = {
        (name, line): count for name, peer in peers.items() for line, count in peer.said.items()
    }
    assert {key for key in said if key[1].startswith("heard")} == heard
    refused = {("steamdeck", f"pub {ODOM}"), ("pi1", f"pub {ODOM}"), ("pi1", f"sub {ASKED}")}
    assert {(who, line[8:]) for who, line in said if line.startswith("refused")} == refused
    outside = {
        key: n
        for key, n in said.items()
        if key[0][-2:] in ("r1", "r2") and key[1].startswith("saw")
    }
    assert outside == {
        (f"{who}2", f"saw {t}"): 1 for who in ("stranger", "forger") for t in (ODOM, DRIVE)
    }
