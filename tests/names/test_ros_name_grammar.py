"""Absolute ROS names, their limits, and relative names, as the design article and rmw define them."""

from __future__ import annotations

import ast
import pickle
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import SfglabError
from sfglab.names import FqnError, ResourceKind, dds_names, max_name_length, resolve, validate_ros_name


@pytest.mark.parametrize(
    "name", ["/tf", "/chatter", "/a/b_c/D9", "/x/_action/status", "/_hidden", "/rosout", "/x_"]
)
def test_valid_names_pass_unchanged(name):
    assert validate_ros_name(name) == name


@pytest.mark.parametrize(
    "name",
    [
        "",
        "/",
        "chatter",
        "/a/",
        "//a",
        "/a//b",
        "/9a",
        "/a/9b",
        "/a__b",
        "/a b",
        "/a-b",
        "/ä",
        "/a\n",
        "/a.b",
        "~/a",
        "/~/a",
        "/{node}/a",
        "/a/\u0661",
    ],
)
def test_names_against_the_design_article_are_refused(name):
    with pytest.raises(FqnError) as caught:
        validate_ros_name(name)
    assert caught.value.place == "name"
    assert caught.value.given == name


@pytest.mark.parametrize("kind", ResourceKind)
def test_the_longest_name_fits_into_dds_and_one_more_is_refused(kind):
    limit = max_name_length(kind)
    longest = "/" + "a" * (limit - 1)
    validate_ros_name(longest, kind)
    assert max(map(len, dds_names(longest, kind))) <= 255
    with pytest.raises(FqnError, match=f"at most {limit} characters"):
        validate_ros_name(longest + "a", kind)


def test_limits_are_those_of_rmw_and_of_a_dds_topic_name():
    assert max_name_length(ResourceKind.TOPIC) == 255 - 8
    assert len("rq" + "x" * max_name_length(ResourceKind.SERVICE) + "Request") == 255
    longest_action = "x" * max_name_length(ResourceKind.ACTION)
    assert len(f"rq{longest_action}/_action/cancel_goalRequest") == 255


@pytest.mark.parametrize(
    ("name", "namespace", "expected"),
    [
        ("/chatter", "/ns", "/chatter"),
        ("chatter", "/", "/chatter"),
        ("chatter", "", "/chatter"),
        ("chatter", "/ns", "/ns/chatter"),
        ("a/b", "ns/sub", "/ns/sub/a/b"),
        ("~", "/ns", "/ns/talker"),
        ("~/x", "/", "/talker/x"),
        ("~/x/y", "/ns", "/ns/talker/x/y"),
    ],
)
def test_names_resolve_as_rclpy_resolves_them(name, namespace, expected):
    assert resolve(name, namespace, node_name="talker") == expected


@pytest.mark.parametrize(
    ("name", "namespace", "node", "segment"),
    [
        ("", "/", "talker", "name"),
        ("~x", "/", "talker", "name"),
        ("~/", "/", "talker", "name"),
        ("~//x", "/", "talker", "name"),
        ("x/", "/", "talker", "name"),
        ("9x", "/", "talker", "name"),
        ("a/~", "/", "talker", "name"),
        ("{node}", "/", "talker", "name"),
        ("x", "/ns/", "talker", "namespace"),
        ("x", "//ns", "talker", "namespace"),
        ("x", "/9", "talker", "namespace"),
        ("x", "/", "", "node"),
        ("x", "/", "a/b", "node"),
        ("x", "/", "9a", "node"),
    ],
)
def test_what_cannot_resolve_names_the_culprit(name, namespace, node, segment):
    with pytest.raises(FqnError) as caught:
        resolve(name, namespace, node_name=node)
    assert caught.value.place == segment


def test_a_name_that_outgrows_the_limit_by_its_namespace_is_refused():
    with pytest.raises(FqnError, match="247"):
        resolve("x" * 200, "/" + "n" * 60, node_name="talker")


@given(name=st.text(max_size=30), namespace=st.text(max_size=10), node=st.text(max_size=10))
def test_resolving_anything_gives_a_valid_name_or_an_fqn_error(name, namespace, node):
    try:
        resolved = resolve(name, namespace, node_name=node)
    except FqnError:
        return
    assert validate_ros_name(resolved) == resolved
    assert resolve(resolved, namespace, node_name=node) == resolved


def test_the_error_carries_its_data_and_survives_pickling():
    with pytest.raises(FqnError) as caught:
        validate_ros_name("bad name")
    error = caught.value
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own bytes
    assert isinstance(copy, SfglabError)
    assert isinstance(copy, ValueError)
    assert (copy.place, copy.given, copy.allowed) == (error.place, error.given, error.allowed)
    assert str(copy) == str(error)
    for part in ("name", "'bad name'", "allowed"):
        assert part in str(error)


def test_the_schema_stands_on_floor_zero():
    code = (
        "import sys, sfglab.names; "
        "print(sorted(m for m in sys.modules if m.startswith('sfglab') and 'names' not in m)); "
        "print(sorted({m.partition('.')[0] for m in sys.modules} - sys.stdlib_module_names - {'sfglab'}))"
    )
    result = subprocess.run(
        [sys.executable, "-I", "-S", "-c", f"import sys; sys.path[:0]={sys.path!r}; {code}"],
        capture_output=True,
        text=True,
        check=True,
    )
    own, foreign = result.stdout.splitlines()
    assert own == "['sfglab', 'sfglab.errors']"
    assert set(ast.literal_eval(foreign)) <= {"__main__"}
