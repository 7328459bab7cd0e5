"""A planned QoS as a ROS 2 parameter file with `qos_overrides`, which both vendors' nodes read.

Names and types of the parameters as rclcpp (`detail/qos_parameters.hpp`) and rclpy
(`qos_overriding_options.py`) declare them: durations are whole nanoseconds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.arp.exports.document import rate_text, summary

if TYPE_CHECKING:
    from sfglab.arp.plan import Plan
    from sfglab.qos import QoSProfile


_HOW = """\
# Use: ros2 run PACKAGE NODE --ros-args --params-file THIS_FILE
# A node takes an override only if it allows it where it creates the publisher or subscription
# (QosOverridingOptions; with_default_policies() allows history, depth and reliability, so deadline and
# durability must be named), and only as it starts. Rates are no QoS; for the nodes' timers:
"""


def ros2_parameters(plan: Plan) -> str:
    """Return a plan as a ROS 2 parameter file.

    Args:
        plan: Of either vendor.
    """
    import yaml

    overrides = {
        part.topic.name: {"publisher": _policies(part.qos), "subscription": _policies(part.qos)}
        for part in plan.topics
    }
    rates = "".join(f"#   {part.topic.name}: {rate_text(part)}\n" for part in plan.topics)
    content = {"/**": {"ros__parameters": {"qos_overrides": overrides}}}
    # The dumper would point at the subscription's equal mapping with an anchor; rcl's parser knows none.
    body = yaml.dump(content, Dumper=_plain_dumper(), sort_keys=False)
    return f"# {summary(plan)}\n{_HOW}{rates}{body}"


def _policies(qos: QoSProfile) -> dict[str, str | int]:
    policies: dict[str, str | int] = {
        "reliability": qos.reliability.value,
        "durability": qos.durability.value,
        "history": qos.history.value,
        "depth": qos.depth,
    }
    if qos.deadline_ns is not None:
        policies["deadline"] = qos.deadline_ns
    return policies


def _plain_dumper() -> Any:
    import yaml

    class PlainDumper(yaml.SafeDumper):
        """Writes every value where it stands, without anchors."""

        def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002 - the dumper's signature
            return True

    return PlainDumper
