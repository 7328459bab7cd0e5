"""A `domain_bridge` configuration for one agent: explicit topics, from those that the fleet file knows.

Format: YAML of ros2/domain_bridge 0.5. It has neither patterns nor, in its file, services and actions; what is
left out stands in the file's first lines.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.deploy.routers.dds_router import header
from sfglab.deploy.shapes import check_shape
from sfglab.deploy.verdicts import Broken, Rules, worst_first
from sfglab.documents import Document, KeyPath
from sfglab.fleet.lint import Finding, Meeting, Use, View
from sfglab.fleet.policy import Direction, Policy
from sfglab.names import ResourceKind, dds_topic
from sfglab.qos import Durability

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.fleet_file import Fleet


def render_domain_bridge(fleet: Fleet, agent: str) -> str:
    """Return the YAML file for one agent's `domain_bridge`; the same fleet gives the same text.

    A topic is bridged outward where the agent publishes it and another subscribes it, inward the other way
    round, and only if the policy lets it cross and the file says its type.

    Raises:
        InvalidValueError: The fleet has no such agent.
    """
    spec, view = fleet.agent(agent), View(fleet)
    bridged: list[str] = []
    left_out: list[str] = []
    for (kind, name), meeting in sorted(view.meetings.items(), key=lambda item: item[0][1]):
        ways = _ways(view, agent, kind, name, meeting)
        if not ways:
            continue
        uses = meeting.speakers + meeting.hearers
        type_ = next((use.type for use in uses if use.type), "")
        if kind is not ResourceKind.TOPIC or not type_:
            left_out.append(
                f"{kind.value} {name}" + ("" if type_ else " (its type is not in the fleet file)")
            )
            continue
        bridged += _topic(name, type_, ways, uses)
    lines = [
        *header(fleet, agent, "domain_bridge"),
        "Not bridged, because its file has topics of a known type only:",
    ]
    lines += [f"  {name}" for name in left_out] or ["  nothing"]
    text = [f"# {line}" for line in lines]
    text += [
        f"name: {agent}_bridge",
        f"from_domain: {spec.domain}",
        f"to_domain: {fleet.global_domain}",
    ]
    return "\n".join([*text, "topics:" if bridged else "topics: {}", *bridged]) + "\n"


def _ways(
    view: View, agent: str, kind: ResourceKind, name: str, meeting: Meeting
) -> frozenset[Direction]:
    """Return the ways in which somebody wants a name of this agent's across; services count as outward."""
    speakers, hearers = (
        {use.agent for use in uses} for uses in (meeting.speakers, meeting.hearers)
    )
    ways = set()
    if agent in speakers and hearers - {agent}:
        ways.add(Direction.OUTWARD)
    if agent in hearers and speakers - {agent}:
        ways.add(Direction.INWARD)
    policy = view.fleet.policy
    if kind is not ResourceKind.TOPIC:
        return frozenset(ways)
    return frozenset(way for way in ways if policy.crosses(dds_topic(name), way))


def _topic(name: str, type_: str, ways: frozenset[Direction], uses: list[Use]) -> Iterator[str]:
    yield f"  {name}:"
    yield f"    type: {type_}"
    if ways == frozenset(Direction):
        yield "    bidirectional: true"
    elif ways == {Direction.INWARD}:
        yield "    reversed: true"
    latched = [use for use in uses if use.qos and use.qos.durability is Durability.TRANSIENT_LOCAL]
    if latched:
        depth = sum(use.count for use in latched if use.speaks) or 1
        yield f"    qos: {{reliability: reliable, durability: transient_local, depth: {depth}}}"


Config = dict[str, Any]

RULES: Rules[Config, KeyPath] = Rules()  #: What a configuration may mean that has the right shape.

#: Whether it bridges nothing that a policy keeps.
POLICY: Rules[tuple[Config, Policy], KeyPath] = Rules()


def check_domain_bridge(
    text: str, *, file: str = "bridge.yaml", policy: Policy | None = None
) -> tuple[Finding, ...]:
    """Return what is wrong with a `domain_bridge` configuration in YAML, the worst first.

    The file's name is for places. The policy says what may cross, from the agent's domain as ``from_domain``;
    None does not ask. That something does not cross is no fault: a bridge has topics of a known type only.

    Raises:
        DocumentError: It is not YAML.
        MissingProgramError: The library that reads JSON Schema is not installed.
    """
    document = Document(text, file)
    config: Any = document.value
    findings = check_shape(document, "domain-bridge")
    if not findings:
        findings = (*RULES.broken(config, document.place),)
        findings += (*POLICY.broken((config, policy), document.place),) if policy else ()
    return worst_first(findings)


@RULES.add("loop", "every message goes round for ever", "give them different domains")
def _same_domain(config: Config) -> Iterator[Broken[KeyPath]]:
    for name, topic in config["topics"].items():
        domains = {topic.get(key, config.get(key)) for key in ("from_domain", "to_domain")}
        if len(domains) == 1 and topic.get("remap", name) == name:
            yield Broken(("topics", name), f"{name} goes from domain {domains.pop()} to the same")


@POLICY.add(
    "policy", "the bridge does not do what the fleet file says", "generate it from the fleet file"
)
def _kept_by_policy(asked: tuple[Config, Policy]) -> Iterator[Broken[KeyPath]]:
    config, policy = asked
    for name, topic in config["topics"].items():
        one_way = Direction.INWARD if topic.get("reversed") else Direction.OUTWARD
        for way in Direction if topic.get("bidirectional") else (one_way,):
            if not policy.crosses(dds_topic(name), way):
                yield Broken(
                    ("topics", name), f"{name} crosses {way.value}, and the policy keeps it"
                )
