"""The naming schema of paper A (section 4.1, Fig. 2), and ROS 2 names on DDS.

The package is in layer 0: it imports only `sfglab.errors` and the standard library.

    >>> from sfglab.names import Component, Resource, RosFqnBuilder, Scope, Stream, parse
    >>> camera = RosFqnBuilder().scope(Scope.GLOBAL).agent("go2").component(Component.CAMERA, "front")
    >>> str(camera.stream(Stream.COLOR).resource(Resource.FFMPEG).build())
    '/global/go2/camera_front/color/ffmpeg'
    >>> parse("/global/agent_heartbeat").resource
    <Resource.AGENT_HEARTBEAT: 'agent_heartbeat'>
"""

from sfglab.names.agent import (
    AGENT_VARIABLE,
    SHARED_FRAMES,
    default_agent,
    frame_owner,
    prefixed_frame,
    sanitize_agent,
    validate_agent,
)
from sfglab.names.fqn import (
    RosFqn,
    RosFqnBuilder,
    all_standard_fqns,
    parse,
)
from sfglab.names.grammar import (
    MAX_NAME_LENGTH,
    TF,
    TF_STATIC,
    DdsRole,
    FqnError,
    ResourceKind,
    dds_names,
    dds_service,
    dds_topic,
    resolve,
    ros_name_from_dds,
    router_hazards,
    validate_ros_name,
)
from sfglab.names.vocabulary import After, Component, Custom, Resource, Scope, Stream, Suffixed

__all__ = [
    "AGENT_VARIABLE",
    "MAX_NAME_LENGTH",
    "SHARED_FRAMES",
    "TF",
    "TF_STATIC",
    "After",
    "Component",
    "Custom",
    "DdsRole",
    "FqnError",
    "Resource",
    "ResourceKind",
    "RosFqn",
    "RosFqnBuilder",
    "Scope",
    "Stream",
    "Suffixed",
    "all_standard_fqns",
    "dds_names",
    "dds_service",
    "dds_topic",
    "default_agent",
    "frame_owner",
    "parse",
    "prefixed_frame",
    "resolve",
    "ros_name_from_dds",
    "router_hazards",
    "sanitize_agent",
    "validate_agent",
    "validate_ros_name",
]
