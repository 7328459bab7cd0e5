"""Transform frames behind routers: clashes, roots, circles, prefixes."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.fleet_file import AgentSpec, FrameSpec, FrameTree, read_fleet
from sfglab.fleet.lint import Severity, lint
from sfglab.fleet.lint.frames import edges_of, roots_of


def tree(frames: str, *, prefix: bool = True, shared: str = "map") -> str:
    return f"tf: {{prefix_frames: {str(prefix).lower()}, shared_frames: [{shared}], frames: [{frames}]}}"


def edge(child: str, parent: str, *, static: bool = False) -> str:
    return f"{{child: {child}, parent: {parent}, static: {str(static).lower()}, rate_hz: 10}}"


def found(policy: str = "", **trees: str):
    text = f"fleet: f\n{policy}\nagents:\n"
    text += "".join(f"  {n}: {{domain: {i}, {t}}}\n" for i, (n, t) in enumerate(trees.items(), start=1))
    return {f.code: f for f in lint(read_fleet(text)).findings if f.code.startswith("frame")}


def test_the_same_frame_of_two_agents_clashes_without_prefixes_and_not_with_them():
    bare = tree(edge("base", "map"), prefix=False)
    clash = found(a1=bare, a2=bare)["frame-clash"]
    assert clash.severity is Severity.ERROR
    assert "prefix_frames: true" in clash.remedy
    prefixed = tree(edge("base", "map"))
    codes = found(a1=prefixed, a2=prefixed)
    assert "frame-clash" not in codes
    assert codes["frames-kept-apart"].what == "prefixes keep 1 frame names of several agents apart: base"


def test_a_clash_with_different_parents_names_both():
    codes = found(a1=tree(edge("base", "map"), prefix=False), a2=tree(edge("base", "odom"), prefix=False))
    assert "with two parents: map, odom" in codes["frame-clash"].what


def test_a_shared_frame_that_two_agents_place_clashes_although_both_prefix():
    placing = tree(edge("map", "world"), shared="map, world")
    clash = found(a1=placing, a2=placing)["frame-clash"]
    assert "out of shared_frames" in clash.remedy


def test_nothing_clashes_where_transforms_do_not_cross():
    bare = tree(edge("base", "map"), prefix=False)
    assert found("policy: [rt/global/*]", a1=bare, a2=bare) == {}


def test_two_parents_within_an_agent_are_an_error():
    codes = found(a1=tree(edge("base", "map") + ", " + edge("base", "odom")))
    assert codes["frame-two-parents"].severity is Severity.ERROR


def test_a_tree_in_two_parts_and_a_circle_are_errors():
    assert (
        "odom, a1/torso"
        in found(a1=tree(edge("base", "odom") + ", " + edge("arm", "torso")))["frame-own-roots"].what
    )
    circle = found(a1=tree(edge("b", "c") + ", " + edge("c", "b")))["frame-circle"]
    assert "a1/b, a1/c" in circle.what


def test_agents_without_a_common_root_are_warned_of_and_a_shared_frame_joins_them():
    alone = tree(edge("base", "map"), shared="")
    warning = found(a1=alone, a2=alone)["frame-no-common-root"]
    assert warning.severity is Severity.WARNING
    assert "a1/map, a2/map" in warning.what
    joined = tree(edge("base", "map"))
    assert "frame-no-common-root" not in found(a1=joined, a2=joined)


def test_a_frame_that_only_some_agents_share_is_named_as_the_cause():
    codes = found(a1=tree(edge("base", "map")), a2=tree(edge("base", "map"), shared=""))
    assert "map is shared by some agents only" in codes["frame-no-common-root"].what


def test_motion_capture_may_place_the_root_of_another_agent_and_a_misspelt_one_is_warned_of():
    robot = tree(edge("base", "odom")).replace("tf: {", "tf: {placed_by_others: [odom], ")
    right = found(go2=robot, tracker=tree(edge("go2/odom", "map"), prefix=False))
    assert right["frame-of-another"].severity is Severity.INFO
    wrong = found(go2=robot, tracker=tree(edge("go2/markers", "map"), prefix=False))  # paper A, Fig. 6
    assert wrong["frame-of-another"].severity is Severity.WARNING
    assert "frame-no-common-root" in wrong


def test_a_transform_that_the_own_router_keeps_in_or_the_others_keeps_out_is_an_error():
    robot = tree(edge("base", "odom"))
    out = found(go2=robot, tracker=tree(edge("go2/odom", "map"), prefix=False))["frame-kept-out"]
    assert out.remedy == "go2: tf: placed_by_others: [odom]"
    kept = found(go2=robot, tracker=tree(edge("go2/odom", "map")))["frame-kept-in"]
    assert kept.severity is Severity.ERROR
    assert "frame-kept-in" in found(a1=tree(edge("map", "earth"), shared="map, earth"))


def test_a_prefix_written_by_hand_is_not_added_again():
    assert "frame-clash" not in found(go2=tree(edge("go2/base", "map")), pi=tree(edge("base", "map")))
    assert "frame-clash" in found(
        go2=tree(edge("go2/base", "map")), pi=tree(edge("go2/base", "map"), prefix=False)
    )


names = st.sampled_from("abcdefgh")


@given(st.lists(st.tuples(names, names), max_size=8))
def test_every_frame_has_the_root_that_following_parents_finds_or_hangs_in_a_circle(pairs):
    frames = tuple(FrameSpec(child=c, parent=p, static=True) for c, p in pairs)
    spec = AgentSpec(name="r1", domain=1, tf=FrameTree(frames=frames, prefix_frames=False))
    edges = edges_of(spec)
    parents = {e.child: e.parent for e in edges}
    roots = roots_of(edges)
    for frame in {*parents, *parents.values()}:
        above = frame
        for _ in range(len(parents) + 1):
            above = parents.get(above, above)
        if above in parents:
            assert frame not in roots
        else:
            assert roots[frame] == above
