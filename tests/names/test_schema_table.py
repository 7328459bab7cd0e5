"""The schema as data: the graph of Fig. 2, and all names of standard values."""

from __future__ import annotations

import pytest

import sfglab.names
from sfglab.names import (
    After,
    Component,
    FqnError,
    Resource,
    Scope,
    Stream,
    all_standard_fqns,
    parse,
    router_hazards,
    schema_table,
)


def test_the_graph_is_a_chain_with_an_exit_into_the_resource_from_every_segment():
    table = schema_table()
    assert [node.name for node in table.nodes] == ["scope", "agent", "component", "stream", "resource"]
    assert [node.name for node in table.nodes if node.mandatory] == ["scope", "resource"]
    assert [node.name for node in table.nodes if node.extensible] == ["component", "stream", "resource"]
    assert [(edge.source, edge.target, edge.after) for edge in table.edges] == [
        ("scope", "agent", None),
        ("agent", "component", None),
        ("component", "stream", None),
        ("scope", "resource", After.SCOPE),
        ("agent", "resource", After.AGENT),
        ("component", "resource", After.COMPONENT),
        ("stream", "resource", After.STREAM),
    ]


def test_the_nodes_list_the_standard_values():
    values = {node.name: node.values for node in schema_table().nodes}
    assert values["scope"] == ("local", "global")
    assert values["agent"] == ()
    assert "locomotion_controller" in values["component"]
    assert "lidar" in values["component"]
    assert len(values["resource"]) == len(Resource)


def test_an_edge_permits_exactly_the_resources_that_carry_its_flag():
    for edge in schema_table().edges:
        if edge.after is not None:
            assert set(edge.resources) == {resource for resource in Resource if edge.after & resource.after}
            assert edge.resources


def test_all_standard_names_are_distinct_parse_back_and_survive_a_router():
    fqns = list(all_standard_fqns("go2"))
    names = [str(fqn) for fqn in fqns]
    assert len(set(names)) == len(names)
    for fqn, name in zip(fqns, names, strict=True):
        assert parse(name) == fqn
        assert not router_hazards(name, fqn.kind)


def test_all_standard_names_are_as_many_as_the_flags_permit():
    permitted = {edge.after: len(edge.resources) for edge in schema_table().edges if edge.after}
    expected = len(Scope) * (
        permitted[After.SCOPE]
        + permitted[After.AGENT]
        + len(Component) * permitted[After.COMPONENT]
        + len(Component) * len(Stream) * permitted[After.STREAM]
    )
    names = {str(fqn) for fqn in all_standard_fqns("go2")}
    assert len(names) == expected
    assert {"/global/agent_heartbeat", "/global/go2/get_metadata", "/local/go2/agent_discovery_event"} <= names


def test_an_agent_that_is_not_allowed_makes_no_names():
    with pytest.raises(FqnError):
        list(all_standard_fqns("lidar"))


def test_the_facade_lists_what_it_exports_in_order():
    exported = sfglab.names.__all__
    assert all(hasattr(sfglab.names, name) for name in exported)
    assert len(set(exported)) == len(exported)
