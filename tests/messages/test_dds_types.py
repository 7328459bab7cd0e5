import os

import numpy as np
import pytest
from cyclonedds._clayer import ddspy_take, ddspy_write
from cyclonedds.core import (
    InstanceState,
    Policy,
    Qos,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration
from random_messages import random_message

from sfglab import messages
from sfglab.messages.dds import idl_struct, service_idl_struct
from sfglab.messages.store import register

DOMAIN = 231
LOOPBACK = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces></General>"
    f"<Discovery><Tag>{os.getpid()}</Tag></Discovery></Domain></CycloneDDS>"
)
ANY = SampleState.Any | ViewState.Any | InstanceState.Any
KEPT = []
"""Topics, as the bus keeps them: Cyclone DDS 11.0.1 may read the freed memory of a type that goes
(ddsi_type_resolved_locked) while the next is made."""
RELIABLE = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.History.KeepAll)


@pytest.fixture(scope="module", name="participant")
def _participant():
    domain = Domain(DOMAIN, LOOPBACK)
    yield DomainParticipant(DOMAIN)
    del domain


def through_dds(participant, struct, cdr):
    """Write bytes raw, take them raw from a reader of the same process."""
    topic = Topic(participant, f"rt/{struct.__name__}", struct)
    KEPT.append(topic)
    reader = DataReader(participant, topic, RELIABLE)
    writer = DataWriter(participant, topic, RELIABLE)
    condition = ReadCondition(reader, ANY)
    waitset = WaitSet(participant)
    waitset.attach(condition)
    assert ddspy_write(writer._ref, cdr) == 0
    assert waitset.wait(duration(seconds=5)) == 1
    [(data, info)] = ddspy_take(reader._ref, ANY, 10)
    assert info.valid_data
    return bytes(data)


def test_every_type_has_a_dds_type_of_its_name():
    for name in messages.message_types():
        struct = idl_struct(name)
        assert struct.__idl__.idl_transformed_typename == messages.dds_type_name(name)
        assert messages.ros_type_name(messages.dds_type_name(name)) == name
        assert idl_struct(name) is struct


@pytest.mark.live
def test_bytes_of_every_type_pass_through_dds_unchanged(participant):
    rng = np.random.default_rng(11)
    for name in messages.message_types():
        cdr = messages.serialize(random_message(rng, name))
        assert through_dds(participant, idl_struct(name), cdr) == cdr, name
    image = messages.default_message("sensor_msgs/msg/Image")
    image.data = np.arange(640 * 360 * 3, dtype=np.uint32).astype(np.uint8)
    cdr = messages.serialize(image)
    assert through_dds(participant, idl_struct(type(image)), cdr) == cdr


@pytest.mark.live
def test_a_framed_reply_and_field_names_of_python_pass_through_dds_unchanged(participant):
    name = "sfglab_interfaces/srv/GetMetadata"
    _, reply = service_idl_struct(name)
    cdr = messages.serialize(random_message(np.random.default_rng(2), f"{name}_Response"))
    frame = messages.ServiceFrame(7, 8, cdr)
    assert (
        messages.unframe_service(through_dds(participant, reply, messages.frame_service(frame)))
        == frame
    )
    odd = register(
        "test_pkg/msg/OddNames", "int32 serialize\nint32 def\nstring<=4 short\nuint8[<=3] few\n"
    )
    cdr = messages.serialize(odd(serialize=1, def_=2, short="abcd", few=np.array([1, 2], np.uint8)))
    assert through_dds(participant, idl_struct(odd), cdr) == cdr


def test_service_types_begin_with_the_header_of_rmw_cyclonedds():
    request, reply = service_idl_struct("sfglab_interfaces/srv/GetMetadata")
    assert list(request.__annotations__)[:2] == ["rmw_client_guid", "rmw_sequence"]
    assert list(reply.__annotations__) == [
        "rmw_client_guid",
        "rmw_sequence",
        "success",
        "message",
        "metadata",
    ]
    assert (
        reply.__idl__.idl_transformed_typename
        == "sfglab_interfaces::srv::dds_::GetMetadata_Response_"
    )
    asked, _ = service_idl_struct("sfglab_interfaces/action/FollowTrajectory_SendGoal")
    wrapper = "sfglab_interfaces::action::dds_::FollowTrajectory_SendGoal_Request_"
    assert asked.__idl__.idl_transformed_typename == wrapper


def test_unknown_types_have_no_struct():
    with pytest.raises(messages.UnknownTypeError):
        idl_struct("std_msgs/msg/Strin")
    with pytest.raises(messages.UnknownTypeError):
        service_idl_struct("sfglab_interfaces/msg/AgentMetadata")
