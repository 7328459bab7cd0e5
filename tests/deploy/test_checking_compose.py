"""Rules on Compose files: a good project keeps them all, and each way to break one is found by its rule."""

import copy
import re
import sys
from dataclasses import replace

import pytest
import yaml
from esslingen import GO2, json_values
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.deploy.compose_check import RULES, check_compose
from sfglab.deploy.compose_values import mounts, variables
from sfglab.deploy.files import BundleFile
from sfglab.deploy.verdicts import State
from sfglab.fleet.fleet_file import Accelerator, ContainerNetwork

SCHEMA = "Compose Specification"


def hardened(**more):
    return {
        "image": "localhost/f/go2:${SFGLAB_TAG:?a release}",
        "user": "10001:10001",
        "read_only": True,
        "tmpfs": ["/tmp"],
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges:true"],
        **more,
    }


def project():
    named = {"SFG_AGENT_NAME": "go2"}
    agent = hardened(networks=["agent"], environment=named, devices=["/dev/nvmap:/dev/nvmap"])
    router = hardened(
        network_mode="host", depends_on=["agent"], volumes=["./router/r.yaml:/etc/r.yaml:ro"]
    )
    return {
        "name": "sfglab-go2",
        "services": {"agent": agent, "router": router},
        "networks": {"agent": {"driver": "bridge", "internal": True}},
    }


OVERLAY = {
    "services": {
        "agent": {
            "image": "localhost/f/go2:development",
            "read_only": False,
            "cap_add": ["SYS_PTRACE"],
            "volumes": ["${SFGLAB_WORKSPACE:-./workspace}:/workspace"],
            "networks": ["agent", "outside"],
        }
    },
    "networks": {"outside": {}},
}


def verdicts(values, *, deployment=GO2, overlay=OVERLAY, **files):
    texts = {
        "compose.yaml": yaml.safe_dump(values),
        "compose.dev.yaml": yaml.safe_dump(overlay),
        **files,
    }
    return check_compose({name: BundleFile(text=text) for name, text in texts.items()}, deployment)


def failing(found, subject="compose.yaml"):
    return {v.check: v.says for v in found if v.state is State.FAILS and v.subject == subject}


def with_service(service, **changes):
    values = project()
    made = values["services"][service] | changes
    values["services"][service] = {key: value for key, value in made.items() if value is not None}
    return values


def test_a_good_project_keeps_every_rule_and_each_is_listed():
    found = verdicts(project())
    assert [v for v in found if v.state is State.FAILS] == []
    asked = {v.check for v in found if v.subject == "compose.yaml"}
    assert asked == {SCHEMA, *(rule.name for rule in RULES)}
    dev = {v.check for v in found if v.subject == "compose.dev.yaml"}
    assert dev == {SCHEMA, *(rule.name for rule in RULES if rule.overlay)}


READ = "mounts read-only or of the agent's folder"
HOST = "host network for the router alone"
TAG = "images have a tag that stays"
DEVICES = "devices of the fleet file alone"
SOCKETS = "no sockets of the machine"
NNP = "no new privileges"
SECRETS = "no secrets in variables"
RUN = {"type": "bind", "source": "/run/", "target": "/r", "read_only": True}
BROKEN = [
    (TAG, "agent", {"image": "localhost/f/go2:latest"}, "latest"),
    (TAG, "agent", {"image": "localhost:5000/f/go2"}, "a tag or a digest"),
    (TAG, "agent", {"image": "f:${SFGLAB_TAG:-1.0}"}, "SFGLAB_TAG may be unset"),
    (TAG, "agent", {"image": "f:${SFGLAB_TAG:-latest}"}, "latest"),
    (TAG, "router", {"image": None}, "services.router.image"),
    ("no capabilities", "agent", {"cap_drop": None}, "cap_drop"),
    ("no capabilities", "agent", {"cap_drop": ["NET_RAW"]}, "cap_drop"),
    ("no capabilities", "router", {"cap_add": ["NET_ADMIN"]}, "NET_ADMIN"),
    ("no capabilities", "agent", {"cap_add": ["SYS_PTRACE"]}, "SYS_PTRACE"),
    (NNP, "router", {"security_opt": None}, "no-new-privileges"),
    (NNP, "agent", {"security_opt": ["no-new-privileges:false"]}, "false"),
    (
        NNP,
        "agent",
        {"security_opt": ["no-new-privileges:true", "seccomp=unconfined"]},
        "seccomp=unconfined",
    ),
    ("read-only root", "agent", {"read_only": None}, "allowed: true"),
    ("read-only root", "router", {"read_only": False}, "services.router"),
    ("no root user", "agent", {"user": None}, "user"),
    ("no root user", "agent", {"user": "root"}, "root"),
    ("no root user", "agent", {"user": "0:10001"}, "0:10001"),
    ("no root user", "router", {"user": "10001:0"}, "10001:0"),
    ("not privileged", "agent", {"privileged": True}, "privileged"),
    (
        SOCKETS,
        "agent",
        {"volumes": ["/var/run/docker.sock:/var/run/docker.sock:ro"]},
        "docker.sock",
    ),
    (SOCKETS, "agent", {"volumes": [RUN]}, "/run"),
    (SOCKETS, "agent", {"volumes": ["/:/host:ro"]}, "whole machine"),
    ("namespaces of their own", "agent", {"pid": "host"}, "pid"),
    ("namespaces of their own", "router", {"ipc": "host"}, "ipc"),
    (HOST, "agent", {"network_mode": "host", "networks": None}, "agent.network_mode"),
    (HOST, "agent", {"network_mode": "service:router", "networks": None}, "service:router"),
    (HOST, "router", {"network_mode": "container:other"}, "container:other"),
    ("no published ports", "agent", {"ports": ["8080:80"]}, "8080"),
    (SECRETS, "agent", {"environment": {"WIFI_PASSWORD": "x"}}, "WIFI_PASSWORD"),
    (SECRETS, "router", {"environment": ["API_TOKEN=abc"]}, "API_TOKEN"),
    (SECRETS, "agent", {"build": {"context": ".", "args": {"SSH_KEY": "k"}}}, "build.args.SSH_KEY"),
    (READ, "agent", {"volumes": ["/srv/sfg:/srv"]}, "/srv/sfg"),
    (READ, "agent", {"volumes": ["./../go1:/data"]}, "./../go1"),
    (READ, "agent", {"volumes": ["${DATA:?where}:/data"]}, "can be written"),
    (READ, "agent", {"volumes": [{"type": "bind", "source": "/srv", "target": "/srv"}]}, "/srv"),
    (DEVICES, "agent", {"devices": ["/dev/mem:/dev/mem"]}, "/dev/mem"),
    (DEVICES, "agent", {"devices": [{"source": "/dev/kfd", "target": "/dev/kfd"}]}, "/dev/kfd"),
    (DEVICES, "agent", {"device_cgroup_rules": ["a *:* rwm"]}, "a *:* rwm"),
    ("every variable is set", "agent", {"command": ["${WHO}"]}, "WHO"),
    ("every variable is set", "router", {"command": ["$WHO"]}, "WHO"),
    ("what is named exists", "router", {"depends_on": ["agnet"]}, "agnet"),
    (
        "what is named exists",
        "router",
        {"depends_on": {"db": {"condition": "service_started"}}},
        "db",
    ),
    ("what is named exists", "agent", {"networks": ["outside"]}, "outside"),
    ("what is named exists", "agent", {"volumes": ["data:/data"]}, "data"),
]


@pytest.mark.parametrize(("rule", "service", "changes", "words"), BROKEN)
def test_every_mutation_is_caught_by_its_rule_in_clear_words(rule, service, changes, words):
    assert words in failing(verdicts(with_service(service, **changes)))[rule]


def test_every_rule_has_a_mutation_that_breaks_it():
    others = {
        "services agent and router alone",
        "agent's network has no way out",
    }  # see the next test
    assert {rule for rule, *_ in BROKEN} | others == {rule.name for rule in RULES}


def test_a_third_service_a_missing_one_and_a_bridge_with_a_way_out_are_found():
    values = project()
    values["services"]["database"] = values["services"].pop("router")
    values["networks"]["agent"]["internal"] = False
    found = failing(verdicts(values, overlay={"services": {}}))
    alone = found["services agent and router alone"]
    assert {"database", "router"} <= set(re.findall(r"services\.(\w+)", alone))
    assert "internal" in found["agent's network has no way out"]


def test_what_the_fleet_file_allows_is_allowed_and_variables_may_come_from_files_or_defaults():
    bridge_less = with_service("agent", network_mode="host", networks=None)
    on_host = replace(GO2, host=replace(GO2.host, network=ContainerNetwork.HOST))
    assert failing(verdicts(bridge_less, deployment=on_host)) == {}
    usb = with_service(
        "agent", devices=["/dev/bus/usb:/dev/bus/usb"], device_cgroup_rules=["c 189:* rwm"]
    )
    assert failing(verdicts(usb)) == {}
    assert DEVICES in failing(
        verdicts(usb, deployment=replace(GO2, host=replace(GO2.host, devices=())))
    )
    values = with_service("agent", command=["$${HOME}", "${A}", "${B:-b}", "$C"])
    assert failing(verdicts(values, **{"release.env": "A=1\nexport C=2\n"})) == {}


@pytest.mark.parametrize("accelerator", Accelerator)
def test_graphics_cards_are_nvidias_where_the_machine_has_one(accelerator):
    gpu = {
        "resources": {"reservations": {"devices": [{"driver": "nvidia", "capabilities": ["gpu"]}]}}
    }
    values = with_service("agent", deploy=gpu, runtime="nvidia", devices=None)
    says = failing(verdicts(values, deployment=replace(GO2, accelerator=accelerator)))
    assert (DEVICES in says) is (accelerator not in {Accelerator.CUDA, Accelerator.JETSON})


@pytest.mark.parametrize(
    ("changes", "rule"),
    [
        ({"privileged": True}, "not privileged"),
        ({"cap_add": ["SYS_ADMIN"]}, "no capabilities"),
        ({"image": "go2"}, TAG),
        ({"user": "root"}, "no root user"),
        ({"volumes": ["/var/run/docker.sock:/s"]}, SOCKETS),
        ({"networks": ["elsewhere"]}, "what is named exists"),
    ],
)
def test_development_has_a_debugger_and_no_more(changes, rule):
    overlay = copy.deepcopy(OVERLAY)
    overlay["services"]["agent"].update(changes)
    assert list(failing(verdicts(project(), overlay=overlay), "compose.dev.yaml")) == [rule]


KEYS = sorted(
    {key for _, _, changes, _ in BROKEN for key in changes} | {"deploy", "gpus", "secrets"}
)


@settings(max_examples=40)
@given(st.sampled_from(KEYS), json_values, json_values)
def test_no_value_makes_a_rule_stumble(key, value, networks):
    values = project() | {"networks": networks}
    values["services"]["agent"][key] = value
    assert {v.check for v in verdicts(values)} >= {rule.name for rule in RULES}


@pytest.mark.parametrize(
    "text",
    ["services: [", "services: {a: 1}", "[]", "services: []", "services: {a: {}, a: {}}", None],
)
def test_what_has_no_services_fails_by_the_schema_alone(text):
    found = check_compose({} if text is None else {"compose.yaml": BundleFile(text=text)}, GO2)
    assert list(failing(found)) == list(failing(found, "compose.dev.yaml")) == [SCHEMA]


def test_the_specifications_schema_finds_a_misspelt_key():
    pytest.importorskip("check_jsonschema", reason="pip install '.[deploy]'")
    says = failing(verdicts(with_service("agent", comand=["x"])))[SCHEMA]
    assert "services.agent" in says
    assert "comand" in says


def test_without_the_schema_the_check_says_what_to_install_and_our_rules_are_asked(monkeypatch):
    monkeypatch.setitem(sys.modules, "check_jsonschema.builtin_schemas", None)
    found = verdicts(with_service("agent", privileged=True, comand=["x"]))
    skipped = [v for v in found if v.state is State.SKIPPED]
    assert {v.check for v in skipped} == {SCHEMA}
    assert all("pip install '.[deploy]'" in v.says for v in skipped)
    assert list(failing(found)) == ["not privileged"]


@pytest.mark.parametrize(
    ("volume", "expected"),
    [
        ("./a:/b:ro", ("./a", True, True)),
        ("./a:/b:rw,z", ("./a", True, False)),
        ("data:/b", ("data", False, False)),
        ("/b", ("", False, False)),
        ("${W:-./w}:/b", ("./w", True, False)),
        ("${W:?set it}:/b:ro", ("${W:?set it}", True, True)),
        ({"type": "tmpfs", "target": "/t"}, ("", False, False)),
    ],
)
def test_volumes_are_read_in_every_form(volume, expected):
    mount = next(mounts({"volumes": [volume]}))
    assert (mount.source, mount.bind, mount.read_only) == expected


def test_variables_are_read_in_every_form():
    forms = "$A ${B} ${C:?x} ${D?} ${E:-e} ${F-} $${G}"
    found = {v.name: (v.must_be_set, v.has_default) for v in variables(forms)}
    none, needed, default = (False, False), (True, False), (False, True)
    assert found == {"A": none, "B": none, "C": needed, "D": needed, "E": default, "F": default}
