"""The agent's name: `SFG_AGENT_NAME`, else the sanitised host name (paper A, section 4.1)."""

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab import names
from sfglab.names import AGENT_VARIABLE, FqnError, default_agent, sanitize_agent, validate_agent


@pytest.mark.parametrize(
    ("hostname", "agent"),
    [
        ("Go2-Jetson.local", "go2_jetson"),
        ("go2", "go2"),
        ("GO2--JETSON--", "go2_jetson"),
        ("7up", "agent_7up"),
        ("robot.lab.example.org", "robot"),
        ("spot_01", "spot_01"),
        ("müller-bot", "m_ller_bot"),
    ],
)
def test_host_names_become_lower_case_words(hostname, agent):
    assert sanitize_agent(hostname) == agent


@pytest.mark.parametrize(
    "hostname", ["", ".", "---", "äöü", ".local", "Camera-Front.local", "torq", "base-station"]
)
def test_a_host_name_that_leaves_no_agent_says_how_to_choose_another(hostname):
    with pytest.raises(FqnError, match=f"^agent: given .*set {AGENT_VARIABLE}") as caught:
        sanitize_agent(hostname)
    assert repr(hostname) in str(caught.value)


@given(st.text(max_size=30))
def test_sanitising_gives_a_valid_agent_or_an_fqn_error_and_is_idempotent(hostname):
    try:
        agent = sanitize_agent(hostname)
    except FqnError as error:
        assert error.place == "agent"  # noqa: PT017  # either outcome is right
    else:
        assert sanitize_agent(agent) == validate_agent(agent) == agent


def test_the_variable_goes_before_the_host_name_and_both_are_the_environments_by_default(
    monkeypatch,
):
    assert default_agent({AGENT_VARIABLE: "Spot1"}, hostname="go2") == "Spot1"
    assert default_agent({}, hostname="Go2-Jetson.local") == "go2_jetson"
    monkeypatch.setenv(AGENT_VARIABLE, "from_env")
    assert default_agent() == "from_env"
    monkeypatch.delenv(AGENT_VARIABLE)
    monkeypatch.setattr(socket, "gethostname", lambda: "Host-7.local")
    assert default_agent() == "host_7"


@pytest.mark.parametrize(
    "given_name", ["", "go2-jetson", "Go2 Jetson", "9", "lidar", "a__b", "torq"]
)
def test_an_invalid_variable_is_an_error_and_never_changed(given_name):
    with pytest.raises(FqnError, match=f"comes from {AGENT_VARIABLE}") as caught:
        default_agent({AGENT_VARIABLE: given_name}, hostname="go2")
    assert (caught.value.place, caught.value.given) == ("agent", given_name)


OTHER_SEGMENTS = "local global lidar camera_front camera1 camera_1 color imu agent_heartbeat status"


@pytest.mark.parametrize("agent", OTHER_SEGMENTS.split())
def test_an_agent_that_reads_as_another_segment_is_refused(agent):
    with pytest.raises(FqnError, match=r"^agent: .*mistaken"):
        validate_agent(agent)


@pytest.mark.parametrize("agent", ["torq", "carr", "rq", "xRequest", "theReplyBot"])
def test_an_agent_that_a_router_breaks_is_refused_in_every_name(agent):
    assert names.router_hazards(f"/global/{agent}/get_metadata")
    with pytest.raises(FqnError, match="router"):
        names.RosFqn(
            scope=names.Scope.LOCAL, agent=agent, resource=names.Resource.AGENT_DISCOVERY_EVENT
        )


def test_ordinary_agents_are_allowed():
    for agent in ("go2", "Go2", "spot_front", "agent_1", "left_robot", "rqt", "request", "torque"):
        assert validate_agent(agent) == agent


@pytest.mark.parametrize(
    ("frame", "agent", "shared", "called"),
    [
        ("base", "go2", names.SHARED_FRAMES, "go2/base"),
        ("/base", "go2", names.SHARED_FRAMES, "go2/base"),
        ("map", "go2", names.SHARED_FRAMES, "map"),
        ("other/base", "go2", names.SHARED_FRAMES, "other/base"),
        ("base", "", names.SHARED_FRAMES, "base"),
        ("hall", "go2", ["hall"], "hall"),
        ("map", "go2", [], "go2/map"),
    ],
)
def test_a_frame_is_called_by_its_agent_unless_it_is_shared_or_has_a_prefix(
    frame, agent, shared, called
):
    assert names.prefixed_frame(frame, agent, shared=frozenset(shared)) == called
    assert names.frame_owner(called) == called.rpartition("/")[0]
    assert names.prefixed_frame("map", "go2") == "map"
