from __future__ import annotations

import pytest

from sfglab.messages import TypeNameError, dds_type_name, message_types, ros_type_name


@pytest.mark.parametrize(
    ("ros", "dds"),
    [
        ("std_msgs/msg/String", "std_msgs::msg::dds_::String_"),
        ("sensor_msgs/msg/PointCloud2", "sensor_msgs::msg::dds_::PointCloud2_"),
        ("std_srvs/srv/SetBool_Request", "std_srvs::srv::dds_::SetBool_Request_"),
        ("nav2_msgs/action/Spin_SendGoal_Response", "nav2_msgs::action::dds_::Spin_SendGoal_Response_"),
    ],
)
def test_names_are_mapped_as_rosidl_does_both_ways(ros, dds):
    assert dds_type_name(ros) == dds
    assert ros_type_name(dds) == ros


def test_every_type_of_the_store_comes_back_from_its_dds_name():
    for name in message_types():
        assert ros_type_name(dds_type_name(name)) == name


@pytest.mark.parametrize(
    "name", ["std_msgs/String", "String", "", "std_msgs/msg/String_", "a/b/msg/C", "9a/msg/B"]
)
def test_other_forms_are_no_ros_names(name):
    with pytest.raises(TypeNameError, match="package/msg/Name"):
        dds_type_name(name)


@pytest.mark.parametrize("name", ["std_msgs::msg::String", "DDS::Time", "std_msgs::msg::dds_::String", "bool"])
def test_types_of_other_dds_applications_are_no_ros_types(name):
    with pytest.raises(TypeNameError, match="dds_"):
        ros_type_name(name)
