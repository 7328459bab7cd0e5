"""What frames are called across agents, for routers and for those who read frames alike."""

from __future__ import annotations

import pytest

from sfglab.fleet.routing import frames as routing
from sfglab.names import SHARED_FRAMES, frame_owner, prefixed_frame


@pytest.mark.parametrize(
    ("frame", "agent", "called"),
    [
        ("base", "go2", "go2/base"),
        ("/base", "go2", "go2/base"),
        ("map", "go2", "map"),
        ("other/base", "go2", "other/base"),
        ("base", "", "base"),
    ],
)
def test_a_frame_is_called_by_its_agent_unless_it_is_shared_or_has_a_prefix(frame, agent, called):
    assert prefixed_frame(frame, agent) == called
    assert frame_owner(called) == called.rpartition("/")[0]


def test_what_is_shared_can_be_chosen():
    assert prefixed_frame("hall", "go2", shared=frozenset({"hall"})) == "hall"
    assert prefixed_frame("map", "go2", shared=frozenset()) == "go2/map"


def test_routers_follow_the_one_rule():
    assert routing.Frames(agent="go2").shared == set(SHARED_FRAMES)
    for frame in ("base", "/odom", "map", "x/base"):
        assert routing.Frames(agent="go2").outward(frame) == prefixed_frame(frame, "go2")
