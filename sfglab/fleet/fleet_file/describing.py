"""From a fleet file to what an agent's components are told: its description and its router's configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.fleet.router.node import RouterConfig
from sfglab.fleet.status.description import AgentDescription, SensorDescription, StreamDescription

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file.model import AgentSpec, Fleet, StreamSpec


def router_config_of(fleet: Fleet, agent: str) -> RouterConfig:
    """Return what the fleet file says of an agent's router.

    Raises:
        UnknownAgentError: The fleet has no such agent.
        RouterConfigError: The agent uses the global domain.
    """
    tf = fleet.agent(agent).tf
    return RouterConfig(
        agent=agent,
        local=fleet.local_address(agent),
        remote=fleet.global_address(agent),
        rules=fleet.policy.rules,
        prefix_frames=tf.prefix_frames,
        shared_frames=tf.shared_frames,
        placed_by_others=tf.placed_by_others,
    )


def description_of(agent: AgentSpec) -> AgentDescription:
    """Return what the fleet file says of an agent's sensors; accelerators and software are not in it."""
    return AgentDescription(
        sensors=tuple(
            SensorDescription(
                name=sensor.name, model=sensor.model, streams=tuple(_stream(s) for s in sensor.streams)
            )
            for sensor in agent.sensors
        )
    )


def _stream(stream: StreamSpec) -> StreamDescription:
    return StreamDescription(
        topic=stream.topic,
        type=stream.type,
        codec=stream.codec,
        decoded_topic=stream.decoded_topic,
        camera_info_topic=stream.camera_info_topic,
        width=stream.width,
        height=stream.height,
        rate_hz=stream.rate_hz,
    )
