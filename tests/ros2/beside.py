"""What tests beside real ROS 2 ask of it."""

from __future__ import annotations

import asyncio

from sfglab.messages import deserialize, serialize

ANSWER_S = 60


async def asked(process, do, answer, **values):
    """Give a peer an order and return its report."""
    process.order(do=do, **values)
    return await process.expect(answer, timeout_s=ANSWER_S)


async def until(true):
    """Ask until it is true."""
    async with asyncio.timeout(ANSWER_S):
        while not await true():
            await asyncio.sleep(0.1)


def without_padding(message):
    """Return a message in which the octet of those without fields is zero: rosidl never looks at it."""
    for name, value in vars(message).items():
        if name == "structure_needs_at_least_one_member":
            setattr(message, name, 0)
        for inner in value if isinstance(value, list) else [value]:
            if hasattr(inner, "__msgtype__"):
                without_padding(inner)
    return message


async def passed_through(ros, name, given, theirs=""):
    """Return what rclpy makes of messages, in our bytes: its own have no zeros in their gaps."""
    back = []
    for first in range(0, len(given), 20):
        part = given[first : first + 20]
        passed = await asked(
            ros, "pass_through", "passed", kind=theirs or name, cdr=[one.hex() for one in part]
        )
        back += [serialize(deserialize(bytes.fromhex(one), name)) for one in passed["cdr"]]
    return back
