"""The graph that the figure of the naming schema draws: paper A, Fig. 2."""

from matplotlib.figure import Figure

from sfglab import names
from sfglab.lab.experiments import naming
from sfglab.names import After, Resource


def test_the_graph_is_a_chain_with_an_exit_into_the_resource_from_every_segment():
    assert naming.SEGMENTS == ("scope", "agent", "component", "stream", "resource")
    assert {"scope", "resource"} == naming.MANDATORY
    assert {"component", "stream", "resource"} == naming.EXTENSIBLE
    ways = naming.permitted()
    assert tuple(ways) == naming.SEGMENTS[:-1]
    for source, flag in zip(ways, After, strict=True):
        assert source == flag.name.lower()
        assert ways[source]
        assert set(ways[source]) == {resource for resource in Resource if flag & resource.after}


def test_the_figure_shows_every_segment_with_its_values_and_every_exit_with_its_resources():
    axes = Figure().subplots()
    naming.draw_schema(axes)
    texts = [text.get_text() for text in axes.texts]
    boxes = {text.get_text(): text.get_bbox_patch() for text in axes.texts}
    for segment in naming.SEGMENTS:
        is_dashed = boxes[f"<{segment}>"].get_linestyle() not in ("-", "solid")
        assert is_dashed is (segment not in naming.MANDATORY)
    for kind in (names.Scope, names.Component, names.Stream, Resource):
        assert any(text.startswith(f"{len(kind)} values") for text in texts)
    assert sum("suffix" in text for text in texts) == len(naming.EXTENSIBLE)
    for source, resources in naming.permitted().items():
        assert f"after {source}: {len(resources)} resources" in texts
