"""Absolute ROS names, their limits, and relative names, as the design article and rmw define them."""

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


WRONG = "/ chatter /a/ //a /a//b /9a /a/9b /a__b /a-b /ä /a.b ~/a /~/a /{node}/a"


@pytest.mark.parametrize("name", ["", "/a b", "/a\n", "/a/\u0661", *WRONG.split()])
def test_names_against_the_design_article_are_refused(name):
    with pytest.raises(FqnError) as caught:
        validate_ros_name(name)
    assert (caught.value.place, caught.value.given) == ("name", name)


@pytest.mark.parametrize(
    ("kind", "on_dds"),
    [(ResourceKind.TOPIC, 2 + 255 - 8), (ResourceKind.SERVICE, 255), (ResourceKind.ACTION, 255)],
)
def test_the_longest_topic_is_that_of_rmw_other_names_fill_one_of_dds_and_one_more_is_refused(kind, on_dds):
    limit = max_name_length(kind)
    longest = "/" + "a" * (limit - 1)
    validate_ros_name(longest, kind)
    assert max(map(len, dds_names(longest, kind))) == on_dds
    with pytest.raises(FqnError, match=f"at most {limit} characters"):
        validate_ros_name(longest + "a", kind)


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
    ("segment", "wrong"),
    [
        ("name", ["", "~x", "~/", "~//x", "x/", "9x", "a/~", "{node}"]),
        ("namespace", ["/ns/", "//ns", "/9"]),
        ("node", ["", "a/b", "9a"]),
    ],
)
def test_what_cannot_resolve_names_the_culprit(segment, wrong):
    for given_text in wrong:
        parts = {"name": "x", "namespace": "/", "node": "talker"} | {segment: given_text}
        with pytest.raises(FqnError, match=f"^{segment}: "):
            resolve(parts["name"], parts["namespace"], node_name=parts["node"])


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
    command = [sys.executable, "-I", "-S", "-c", f"import sys; sys.path[:0]={sys.path!r}; {code}"]
    result = subprocess.run(command, capture_output=True, text=True, check=True)
    own, foreign = result.stdout.splitlines()
    assert own == "['sfglab', 'sfglab.errors']"
    assert set(ast.literal_eval(foreign)) <= {"__main__"}
