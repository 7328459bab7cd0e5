"""A name that is typed is read by the schema and carried by the policy; the picture shows what those say."""

import pytest

from sfglab.fleet.policy import TABLE_1, Direction, ForwardRule, Policy
from sfglab.lab.experiments import naming
from sfglab.lab.figures import drawn
from sfglab.names import ResourceKind, dds_names, parse

pytest.importorskip("anywidget")
OUTWARD = Policy(rules=(ForwardRule(pattern="rt/odom", directions=frozenset({Direction.OUTWARD})),))
NAMES = {
    "/global/go2/get_metadata": ("service", "a name of the schema; it crosses."),
    "/local/go2/agent_discovery_event": ("topic", "a name of the schema; it stays."),
    "/tf": ("topic", "no name of the schema: scope: given 'tf', allowed: local or global; it crosses."),
    "/global/go2/arm/grasp": ("topic", "a name of the schema; it crosses."),
}


def said(picture):
    figure = drawn(picture._size, picture._draw)
    texts = [text for axes in figure.axes for text in axes.texts]
    decided = {text.get_text() for text in texts if text.get_weight() == "bold"}
    return (
        " ".join(figure.get_suptitle().split()),
        {text.get_text().replace(chr(10), "") for text in texts},
        decided,
    )


@pytest.mark.parametrize("name", NAMES)
def test_a_typed_name_shows_its_parts_its_way_and_the_rules_that_decide(name):
    picture = naming.NamePicture()
    picture.field.value = name
    title, texts, decided = said(picture)
    assert title == "The {1} {0} is {2}".format(name, *NAMES[name])
    wire = dds_names(name, picture.kind)
    assert {*wire, *(text for _, text in (picture.fqn.segments if picture.fqn else ()))} <= texts
    ruled = {
        rule.pattern for rule in TABLE_1 for dds in wire if Policy(rules=(rule,)).crosses(dds, Direction.INWARD)
    }
    assert decided == ruled


def test_a_way_that_is_open_outward_only_is_said_and_kinds_are_chosen():
    picture = naming.NamePicture("/odom", OUTWARD)
    assert said(picture)[0].endswith("it crosses outward, stays inward.")
    picture.choice.value = ResourceKind.ACTION
    assert picture.kind is ResourceKind.ACTION
    assert said(picture)[0].endswith("it stays.")


def test_a_press_puts_the_next_value_that_the_schema_allows_and_its_refusals_are_said():
    picture = naming.NamePicture("/global/go2/camera_front/color/ffmpeg")
    for label in ("scope", "component", "stream", "resource"):
        before = parse(picture.name)
        picture.press(label)
        assert not picture.said
        after = parse(picture.name)
        assert [one for one, _ in after.segments if getattr(after, one) != getattr(before, one)] == [label]
    picture.press("agent")
    assert "it has no standard values" in picture.said
    picture.field.value = "/global/go2/get_metadata"
    picture.press("stream")
    assert "component: nothing is given" in picture.said
    picture.field.value = "/global//go2"
    assert "absolute name" in picture.said
    assert picture.name == "/global/go2/get_metadata"
