"""The graph that the figure of the naming schema draws: paper A, Fig. 2."""

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
