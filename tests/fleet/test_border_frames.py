"""Transform frames behind routers: clashes, roots, circles, prefixes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.fleet_file import AgentSpec, FrameSpec, FrameTree, read_fleet
from sfglab.fleet.lint import lint
from sfglab.fleet.lint.frames import edges_of, roots_of


def tree(frames: str, *, prefix: bool = True, shared: str = "map") -> str:
    return f"tf: {{prefix_frames: {str(prefix).lower()}, shared_frames: [{shared}], frames: [{frames}]}}"


def edge(child: str, parent: str, *, static: bool = False) -> str:
    return f"{{child: {child}, parent: {parent}, static: {str(static).lower()}, rate_hz: 10}}"


def found(*trees: str, policy: str = ""):
    text = f"fleet: f\n{policy}\nagents:\n"
    text += "".join(f"  a{i}: {{domain: {i}, {tree}}}\n" for i, tree in enumerate(trees, start=1))
    return {f.code: f for f in lint(read_fleet(text)).findings if f.code.startswith("frame")}


def bare(child: str, parent: str) -> str:
    return tree(edge(child, parent), prefix=False)


BASE = tree(edge("base", "map"))
ALONE = tree(edge("base", "map"), shared="")
PLACING = tree(edge("map", "world"), shared="map, world")
ROBOT = tree(edge("base", "odom"))
HALVES = tree(edge("base", "odom") + ", " + edge("arm", "torso"))
PLACED = ROBOT.replace("tf: {", "tf: {placed_by_others: [odom], ")


@pytest.mark.parametrize(
    ("trees", "code", "severity", "said"),
    [
        ((bare("base", "map"), bare("base", "map")), "frame-clash", "error", "prefix_frames: true"),
        ((bare("base", "map"), bare("base", "odom")), "frame-clash", "error", "with two parents: map, odom"),
        ((PLACING, PLACING), "frame-clash", "error", "out of shared_frames"),
        ((tree(edge("a1/base", "map")), bare("a1/base", "map")), "frame-clash", "error", "a1/base"),
        ((BASE, BASE), "frames-kept-apart", "info", "keep 1 frame names of several agents apart: base"),
        ((tree(edge("base", "map") + ", " + edge("base", "odom")),), "frame-two-parents", "error", "a1/base"),
        ((HALVES,), "frame-own-roots", "error", "odom, a1/torso"),
        ((tree(edge("b", "c") + ", " + edge("c", "b")),), "frame-circle", "error", "a1/b, a1/c"),
        ((ALONE, ALONE), "frame-no-common-root", "warning", "a1/map, a2/map"),
        ((BASE, ALONE), "frame-no-common-root", "warning", "map is shared by some agents only"),
        ((PLACED, bare("a1/odom", "map")), "frame-of-another", "info", "a1/odom"),
        # As in paper A, Fig. 6.
        ((PLACED, bare("a1/markers", "map")), "frame-of-another", "warning", "a1/markers"),
        ((PLACED, bare("a1/markers", "map")), "frame-no-common-root", "warning", "roots"),
        ((ROBOT, bare("a1/odom", "map")), "frame-kept-out", "error", "a1: tf: placed_by_others: [odom]"),
        ((ROBOT, tree(edge("a1/odom", "map"))), "frame-kept-in", "error", "a1/odom"),
        ((tree(edge("map", "earth"), shared="map, earth"),), "frame-kept-in", "error", "map"),
    ],
)
def test_a_mistake_is_found(trees, code, severity, said):
    finding = found(*trees)[code]
    assert finding.severity.value == severity
    assert said in f"{finding.what}; {finding.remedy}"


@pytest.mark.parametrize(
    ("trees", "code"),
    [
        ((BASE, BASE), "frame-clash"),
        ((BASE, BASE), "frame-no-common-root"),
        ((tree(edge("a1/base", "map")), BASE), "frame-clash"),  # a prefix by hand is not added again
    ],
)
def test_what_is_no_mistake_is_not_found(trees, code):
    assert code not in found(*trees)


def test_nothing_clashes_where_transforms_do_not_cross():
    assert found(bare("base", "map"), bare("base", "map"), policy="policy: [rt/global/*]") == {}


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
