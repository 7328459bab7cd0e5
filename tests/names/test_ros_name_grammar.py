"""Limits of ROS names, and errors of invalid names.

`tests/ros2/test_ros_names.py` compares validity and expansion of names with rclpy.
"""

import pickle
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.errors import SfglabError
from sfglab.names import (
    MAX_NAME_LENGTH,
    FqnError,
    ResourceKind,
    dds_names,
    resolve,
    validate_ros_name,
)


@pytest.mark.parametrize(
    ("kind", "on_dds"),
    [(ResourceKind.TOPIC, 2 + 255 - 8), (ResourceKind.SERVICE, 255), (ResourceKind.ACTION, 255)],
)
def test_the_longest_topic_is_that_of_rmw_other_names_fill_one_of_dds_and_one_more_is_refused(
    kind, on_dds
):
    limit = MAX_NAME_LENGTH[kind]
    longest = "/" + "a" * (limit - 1)
    validate_ros_name(longest, kind)
    assert max(map(len, dds_names(longest, kind))) == on_dds
    with pytest.raises(FqnError, match=f"at most {limit} characters"):
        validate_ros_name(longest + "a", kind)


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
    assert (error.place, error.given) == ("name", "bad name")
    assert str(error).startswith("name: given 'bad name', allowed: ")
    copy = pickle.loads(pickle.dumps(error))  # noqa: S301 - our own bytes
    assert isinstance(copy, SfglabError)
    assert isinstance(copy, ValueError)
    assert (copy.place, copy.given, copy.allowed) == (error.place, error.given, error.allowed)
    assert str(copy) == str(error)


def test_the_schema_stands_on_floor_zero():
    code = f"import sys; sys.path[:0] = {sys.path!r}; import sfglab.names; print(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-I", "-S", "-c", code], capture_output=True, text=True, check=True
    )
    found = {m for m in done.stdout.split() if m.partition(".")[0] not in sys.stdlib_module_names}
    assert {m for m in found if not m.startswith("sfglab.names")} == {
        "__main__",
        "sfglab",
        "sfglab.errors",
    }
