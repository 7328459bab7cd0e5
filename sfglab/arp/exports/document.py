"""What the exported files have in common: refusals, how a plan is summed up, and XML with comments."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.arp.plan import Plan, TopicPlan
    from sfglab.rtps import Vendor


class ExportError(SfglabError, ValueError):
    """A plan that the format cannot express."""


def require_vendor(plan: Plan, vendor: Vendor) -> None:
    """Refuse a plan that was reckoned with another implementation's timing.

    Raises:
        ExportError: It was.
    """
    if plan.vendor.name != vendor.name:
        raise ExportError(
            f"this plan reckons with the timing of {plan.vendor.name}, which {vendor.name} does not have; "
            f"plan again for {vendor.name}"
        )


def summary(plan: Plan) -> str:
    """Return one line on where a plan comes from."""
    return (
        f"QoS by sfglab (method {plan.method}) for {len(plan.topics)} topics on {plan.medium.rate_bps / 1e6:g} "
        f"Mbit/s with {100 * plan.medium.loss:g} % loss, {plan.vendor.name}: {100 * plan.utilisation:.0f} % of "
        "the medium's time is planned."
    )


def rate_text(part: TopicPlan) -> str:
    """Return how often a topic's node works; behind a local cache that is how often it reads."""
    return f"{part.rate_hz:.4g} Hz" + (
        ", of which a local cache lets changes pass" if part.topic.cached else ""
    )


def new_comment(text: str) -> Any:
    """Return a comment; XML forbids two hyphens in a row there."""
    return ET.Comment(f" {text.replace('--', '- -')} ")


def child(parent: ET.Element, path: str, text: str | None = None, **attributes: str) -> ET.Element:
    """Add an element, with those that hold it, and return it.

    Args:
        parent: Where.
        path: Names from there, separated by slashes; what exists is used again.
        text: What it says.
        attributes: Of the last one.
    """
    *holders, last = path.split("/")
    for name in holders:
        found = parent.find(name)
        parent = ET.SubElement(parent, name) if found is None else found
    element = ET.SubElement(parent, last, attributes)
    element.text = text
    return element


def render(root: ET.Element) -> str:
    """Return a document's text, indented."""
    ET.indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{ET.tostring(root, encoding="unicode")}\n'
