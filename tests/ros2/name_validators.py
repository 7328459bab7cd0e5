"""ROS 2's own validators: a JSON list of (name, namespace, node) in, for each what rclpy makes of it out."""

import json
import sys

from rclpy.exceptions import (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidTopicNameException,
)
from rclpy.expand_topic_name import expand_topic_name
from rclpy.validate_full_topic_name import validate_full_topic_name
from rclpy.validate_namespace import validate_namespace
from rclpy.validate_node_name import validate_node_name
from rclpy.validate_topic_name import validate_topic_name

REFUSALS = (
    InvalidNamespaceException,
    InvalidNodeNameException,
    InvalidTopicNameException,
    ValueError,
)


def said(act):
    """Return the result of a validator, or None if it refuses."""
    try:
        return act()
    except REFUSALS:
        return None


def expanded(name, namespace, node):
    """Return a name as a node expands it (`Node.__init__`, `Node.resolve_topic_name`)."""
    namespace = namespace if namespace.startswith("/") else f"/{namespace}"
    validate_node_name(node)
    validate_namespace(namespace)
    validate_topic_name(name)
    full = expand_topic_name(name, node, namespace)
    validate_full_topic_name(full)
    return full


for case in json.load(sys.stdin):
    full = bool(said(lambda: validate_full_topic_name(case[0])))  # noqa: B023  # called at once
    print(json.dumps([full, said(lambda: expanded(*case))]))  # noqa: B023, T201
