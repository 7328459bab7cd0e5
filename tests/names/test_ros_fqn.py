"""The tuple, its builder and its parser (paper A, section 4.1 and Fig. 2)."""

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from sfglab import names
from sfglab.names import (
    After,
    Component,
    Custom,
    FqnError,
    Resource,
    ResourceKind,
    RosFqn,
    Scope,
    parse,
)

SEGMENTS = {"name", "scope", "agent", "component", "stream", "resource"}
WORDS = st.one_of(
    st.from_regex(r"[A-Za-z][A-Za-z0-9]{0,5}(_[A-Za-z0-9]{1,4}){0,2}", fullmatch=True),
    st.sampled_from(
        [
            "go2",
            "torq",
            "carr",
            "setRequest",
            "theReply",
            "camera_front",
            "camera_1",
            "lidar",
            "mast",
        ]
    ),
)
SUFFIXES = st.from_regex(r"[A-Za-z0-9]{1,4}(_[A-Za-z0-9]{1,3})?", fullmatch=True)
KINDS = st.sampled_from(ResourceKind)


@st.composite
def segments(draw, values, members=None):
    choice = draw(st.sampled_from(["standard", "suffixed", "custom"]))
    if choice == "custom":
        kind = draw(KINDS) if values is Resource else ResourceKind.TOPIC
        return Custom(draw(WORDS), kind=kind)
    value = draw(st.sampled_from(members or list(values)))
    if choice == "standard" or value in (Resource.COMPRESSED, Resource.FFMPEG):
        return value
    return value.suffixed(draw(SUFFIXES))


@st.composite
def buildable(draw):
    """Any tuple that RosFqn accepts; what it refuses is drawn again."""
    depth = draw(st.integers(0, 3))
    permitted = [resource for resource in Resource if tuple(After)[depth] in resource.after]
    parts = {
        "scope": draw(st.sampled_from(Scope)),
        "agent": draw(WORDS) if depth > 0 else None,
        "component": draw(segments(Component)) if depth > 1 else None,
        "stream": draw(segments(names.Stream)) if depth > 2 else None,
        "resource": draw(segments(Resource, permitted)),
    }
    try:
        return RosFqn(**parts)
    except FqnError:
        # Constraint or collision: keep the shape, take what is always allowed.
        parts["agent"] = parts["agent"] and "go2"
        parts["component"] = parts["component"] and Component.CAMERA.suffixed("front")
        parts["stream"] = parts["stream"] and names.Stream.INFRA.suffixed("1")
        parts["resource"] = Custom("gait", kind=draw(KINDS))
        return RosFqn(**parts)


TOKENS = st.one_of(
    WORDS,
    st.sampled_from(["", "color", "infra1", "infra_1", "image_raw", "points", "9", "a__b", "x_"]),
    st.sampled_from([resource.text for resource in Resource]),
)
NAME_LIKE = st.one_of(
    st.text(max_size=60),
    st.lists(TOKENS, max_size=6).map(lambda parts: "/" + "/".join(parts)),
    st.tuples(
        st.sampled_from(["/local/go2/", "/global/go2/", "/global/"]), st.lists(TOKENS, max_size=4)
    ).map(lambda pair: pair[0] + "/".join(pair[1])),
    buildable().map(str),
)


@given(buildable())
def test_every_buildable_name_parses_back_to_an_equal_tuple(fqn):
    assert fqn.is_global is str(fqn).startswith("/global/")
    assert parse(str(fqn), kind=fqn.kind) == fqn
    assert hash(parse(str(fqn), kind=fqn.kind)) == hash(fqn)
    if fqn.kind is ResourceKind.TOPIC or not isinstance(fqn.resource, Custom):
        assert parse(str(fqn)) == fqn


@example("/tf", None)
@example("/global", None)
@example("/global/", None)
@example("/local/a/b/c", None)
@example("/local/a/b/c/d/e", None)
@example("/global/go2/camera_1/color/image_raw", None)
@example("/global/go2/camera_front/color/ffmpeg\n", None)
@settings(max_examples=500)
@given(NAME_LIKE, st.none() | KINDS)
def test_any_text_parses_as_its_kind_and_rebuilds_the_same_or_is_an_error_that_names_a_segment(
    name, kind
):
    try:
        fqn = parse(name, kind=kind)
    except FqnError as refused:
        error = refused
        assert error.place in SEGMENTS
        assert str(error).startswith(error.place)
        assert error.allowed
    else:
        assert str(fqn) == name
        assert kind in {None, fqn.kind}


@settings(max_examples=300)
@given(buildable())
def test_a_router_pairs_the_halves_of_every_global_service_that_can_be_built(fqn):
    assert not fqn.is_global or not names.router_hazards(str(fqn), fqn.kind)


@pytest.mark.parametrize(
    ("component", "resource", "kind", "segment"),
    [
        (Custom("torq"), "calibrate", ResourceKind.SERVICE, "component"),
        (Custom("carr"), "calibrate", ResourceKind.SERVICE, "component"),
        (Component.ARM, "moveRequest", ResourceKind.SERVICE, "resource"),
        (Component.ARM, "moveReply", ResourceKind.ACTION, "resource"),
        (Component.ARM, "torq", ResourceKind.ACTION, "resource"),
    ],
)
def test_a_segment_that_a_router_breaks_is_refused_where_it_is_routed(
    component, resource, kind, segment
):
    parts = {"agent": "go2", "component": component, "resource": Custom(resource, kind=kind)}
    with pytest.raises(FqnError, match=f"^{segment}: .*router"):
        RosFqn(scope=Scope.GLOBAL, **parts)
    assert RosFqn(scope=Scope.LOCAL, **parts).dds_names[0].startswith("rq/local/")
    topic = {**parts, "resource": Custom(resource)}
    assert len(RosFqn(scope=Scope.GLOBAL, **topic).dds_names) == 1


def test_the_last_segment_of_a_service_may_end_like_a_prefix():
    fqn = RosFqn(
        scope=Scope.GLOBAL, agent="go2", resource=Custom("torq", kind=ResourceKind.SERVICE)
    )
    assert fqn.dds_names == names.dds_service("/global/go2/torq")


C, S, R = Component, names.Stream, Resource


@pytest.mark.parametrize(
    ("agent", "component", "stream", "resource", "segment"),
    [
        ("a b", None, None, R.STATUS, "agent"),
        ("", None, None, R.STATUS, "agent"),
        ("go2", Custom("camera_front"), None, R.POINTS, "component"),
        ("go2", Custom("camera_1"), None, R.POINTS, "component"),
        ("go2", Custom("lidar"), None, R.POINTS, "component"),
        ("go2", Custom("color"), None, R.IMAGE_RAW, "component"),
        ("go2", C.CAMERA, None, Custom("color"), "resource"),
        ("go2", C.CAMERA, None, Custom("image_raw_left"), "resource"),
        (None, None, None, "agent_heartbeat", "resource"),
        (None, None, None, None, "resource"),
        (None, None, None, S.COLOR, "resource"),
        (7, None, None, R.STATUS, "agent"),
        ("go2", S.IMU, None, R.IMU, "component"),
        ("go2", S.IMU.suffixed("1"), None, R.IMU, "component"),
    ],
)
def test_tuples_against_the_schema_are_refused_at_the_segment(
    agent, component, stream, resource, segment
):
    with pytest.raises(FqnError, match=f"^{segment}: "):
        RosFqn(
            scope=Scope.LOCAL, agent=agent, component=component, stream=stream, resource=resource
        )


def test_a_scope_is_no_text():
    with pytest.raises(
        FqnError, match=r"scope: given 'global', allowed: Scope\.LOCAL or Scope\.GLOBAL"
    ):
        RosFqn(scope="global", resource=Resource.AGENT_HEARTBEAT)


FIVE = "two to five segments"
OUTSIDE = "/tf /tf_static /rosout /chatter global/a /Global/x"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        *((name, "allowed") for name in ("", *OUTSIDE.split())),
        ("/global/a/b/c/d/e", FIVE),
        ("/local/go2/camera/color/image_raw/compressed", FIVE),
        (
            "/global/camera_front/color/ffmpeg",
            r"mistaken for Component\.CAMERA",
        ),  # the agent was forgotten
    ],
)
def test_names_outside_the_schema_do_not_parse(name, message):
    with pytest.raises(FqnError, match=f"^(scope|name|agent): .*{message}"):
        parse(name)


def test_every_optional_segment_needs_the_one_before_so_position_says_what_it_is():
    fqn = parse("/local/a/b/c")
    assert (fqn.agent, fqn.component, fqn.stream, fqn.resource) == (
        "a",
        Custom("b"),
        None,
        Custom("c"),
    )
    assert fqn.preceding is After.COMPONENT
    assert parse("/local/a/b").preceding is After.AGENT
    assert parse("/local/b").preceding is After.SCOPE
    assert parse("/local/a/b/c/d").preceding is After.STREAM


def test_an_error_says_where_a_resource_may_stand_and_a_standard_one_keeps_its_kind():
    with pytest.raises(
        FqnError, match="after component, stream; here it follows the agent"
    ) as caught:
        parse("/global/go2/ffmpeg")
    assert (caught.value.place, caught.value.given) == ("resource", "ffmpeg")
    assert parse("/global/go2/get_metadata").kind is ResourceKind.SERVICE
    assert parse("/global/go2/status2").kind is ResourceKind.TOPIC
    with pytest.raises(FqnError, match="as a service"):
        parse("/global/go2/get_metadata", kind=ResourceKind.TOPIC)


@pytest.mark.parametrize("kind", ResourceKind)
def test_the_length_limit_holds_for_the_whole_name(kind):
    room = names.MAX_NAME_LENGTH[kind] - len("/local/go2/")
    longest = RosFqn(scope=Scope.LOCAL, agent="go2", resource=Custom("x" * room, kind=kind))
    assert max(map(len, longest.dds_names)) <= 255
    with pytest.raises(FqnError, match=r"^name: .*at most"):
        RosFqn(scope=Scope.LOCAL, agent="go2", resource=Custom("x" * (room + 1), kind=kind))


def test_a_builder_can_be_continued_more_than_once():
    camera = (
        names.RosFqnBuilder().scope(Scope.LOCAL).agent("go2").component(Component.CAMERA, "front")
    )
    raw = camera.stream(names.Stream.INFRA, "1").resource(Resource.IMAGE_RAW).build()
    info = camera.stream(names.Stream.COLOR).resource(Resource.CAMERA_INFO).build()
    assert str(raw) == "/local/go2/camera_front/infra1/image_raw"
    assert str(info) == "/local/go2/camera_front/color/camera_info"
    assert (
        str(camera.resource(Resource.STATUS, "raw").build()) == "/local/go2/camera_front/status_raw"
    )
    assert (
        str(camera.component(Custom("mast")).resource(Custom("tilt")).build())
        == "/local/go2/mast/tilt"
    )


def test_a_builder_takes_this_hosts_agent_and_names_a_mandatory_segment_that_is_missing(
    monkeypatch,
):
    status = names.RosFqnBuilder().scope(Scope.GLOBAL).resource(Resource.STATUS)
    monkeypatch.setenv("SFG_AGENT_NAME", "spot_7")
    assert str(status.build()) == "/global/spot_7/status"
    assert str(status.without_agent().agent("go2").build()) == "/global/go2/status"
    monkeypatch.setenv("SFG_AGENT_NAME", "spot-7")
    with pytest.raises(FqnError, match="SFG_AGENT_NAME"):
        status.build()
    monkeypatch.setenv("SFG_AGENT_NAME", "spot_7")
    with pytest.raises(FqnError, match=r"^scope: nothing is given"):
        names.RosFqnBuilder().resource(Resource.STATUS).build()
    with pytest.raises(FqnError, match=r"^resource: nothing is given"):
        names.RosFqnBuilder().scope(Scope.LOCAL).build()


@pytest.mark.parametrize("value", [Custom("mast"), Component.CAMERA.suffixed("front")])
def test_a_builder_adds_a_suffix_only_to_a_bare_standard_value(value):
    with pytest.raises(FqnError, match="suffix only on a standard value"):
        names.RosFqnBuilder().component(value, "left")


def test_all_standard_names_are_as_many_as_the_flags_permit_and_survive_a_router():
    permitted = {flag: sum(flag in resource.after for resource in Resource) for flag in After}
    expected = len(Scope) * (
        permitted[After.SCOPE]
        + permitted[After.AGENT]
        + len(Component) * permitted[After.COMPONENT]
        + len(Component) * len(names.Stream) * permitted[After.STREAM]
    )
    found = {str(fqn): fqn.kind for fqn in names.all_standard_fqns("go2")}
    assert len(found) == expected
    assert not any(names.router_hazards(name, kind) for name, kind in found.items())
