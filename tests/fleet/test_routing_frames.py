"""Frames at a router are prefixed once, shared frames stay, and no agent moves another agent's frame."""

import logging
import re

import pytest

from sfglab.fleet.router.frames import TF_TYPE, Frames, TransformGate
from sfglab.messages import default_message, deserialize, message_type, serialize

GO2 = Frames(agent="go2", placed_by_others=frozenset({"base"}))


def tf(*pairs):
    transforms = []
    for number, (parent, child) in enumerate(pairs):
        transform = default_message("geometry_msgs/msg/TransformStamped")
        transform.header.frame_id, transform.child_frame_id = parent, child
        transform.transform.translation.x = float(number)
        transforms.append(transform)
    return serialize(message_type(TF_TYPE)(transforms=transforms))


def pairs(cdr):
    return [(t.header.frame_id, t.child_frame_id) for t in deserialize(cdr, TF_TYPE).transforms]


@pytest.mark.parametrize(("frame", "outside"), [("map", "map"), ("odom", "go2/odom")])
def test_a_prefix_is_put_in_front_once(frame, outside):
    for inside in (frame, outside, f"/{frame}"):  # tf2 takes a leading slash for nothing
        assert GO2.outward(inside) == outside


@pytest.mark.parametrize("child", ["map", "/map", "b1/base", "b1/base/x", ""])
def test_an_agent_cannot_move_a_frame_that_is_not_its_own(child):
    refusal = GO2.outward_refusal(child)
    assert re.match(rf"outward transform: given the child frame '{child}'.*'go2/'", refusal)


def test_what_one_agent_lets_out_every_other_lets_in_and_itself_what_others_may_place():
    assert not GO2.outward_refusal("camera")
    assert not Frames(agent="b1").inward_refusal("go2/camera")
    assert not GO2.inward_refusal("go2/base")
    assert re.search(r"'go2/camera'.*below 'go2/': go2/base", GO2.inward_refusal("go2/camera"))


def test_a_message_leaves_with_prefixes_otherwise_the_same_and_other_bytes_do_not_pass():
    gate = TransformGate(GO2)
    sent = tf(("map", "odom"), ("odom", "base"), ("go2/base", "go2/camera"), ("b1/base", "seen_b1"))
    out = gate.outward(sent)
    ours = [("map", "go2/odom"), ("go2/odom", "go2/base"), ("go2/base", "go2/camera")]
    assert pairs(out) == [*ours, ("b1/base", "go2/seen_b1")]
    assert [t.transform.translation.x for t in deserialize(out, TF_TYPE).transforms] == [0, 1, 2, 3]
    assert gate.outward(out) is out, "nothing changed, so nothing is made anew"
    assert TransformGate(GO2).outward(b"\0\1\0\0\xff\xff\xff\xff") is None


def test_clashes_are_left_out_and_said_once_for_each_frame(caplog):
    gate = TransformGate(GO2)
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            assert pairs(gate.outward(tf(("earth", "map"), ("odom", "base")))) == [
                ("go2/odom", "go2/base")
            ]
            assert gate.outward(tf(("earth", "map"))) is None
    (said,) = [r.message for r in caplog.records]
    assert said == (
        "outward transform: given the child frame 'map', allowed: frames without prefix and those below "
        "'go2/', but no shared ones (earth, map, world); it is dropped, and further ones of it silently"
    )
