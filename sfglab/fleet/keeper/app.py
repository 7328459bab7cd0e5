"""The keeper as a process: ``python -m sfglab.fleet.keeper CONFIG``; see `component`.

Beside ``ready`` it reports every replay, ``{"is": "replayed", "topic", "packets", "size_bytes", "gaps",
"overflows"}``.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.address import BusAddress
from sfglab.fleet.component import run_component
from sfglab.fleet.keeper.cache import Limits
from sfglab.fleet.keeper.node import KeeperSettings, StreamKeeper

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.component import Report


@dataclass(frozen=True, slots=True, kw_only=True)
class KeeperConfig(KeeperSettings):
    """What a keeper's process is told, beside what it keeps."""

    address: BusAddress  #: The agent's own domain.

    def to_json(self) -> str:
        """Return the configuration as a process's argument."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> KeeperConfig:
        """Read what `to_json` wrote.

        Raises:
            KeeperError: A stream cannot be replayed.
            LimitsError: Nothing could be kept.
        """
        values = json.loads(text)
        values["address"], values["streams"] = BusAddress(**values["address"]), tuple(values["streams"])
        if "limits" in values:
            values["limits"] = Limits(**values["limits"])
        return cls(**values)


async def run_keeper(config: KeeperConfig, report: Callable[[Report], None]) -> None:
    """Run a keeper until cancelled; everything it started has ended when this returns.

    Args:
        config: Where and what.
        report: Takes its reports.

    Raises:
        BusError: The domain cannot be joined.
    """
    from sfglab.bus import Node

    async with Node("stream_keeper", **config.address.options()) as node:
        keeper = StreamKeeper(node, config, on_replay=lambda r: report({"is": "replayed", **asdict(r)}))
        await keeper.run(on_ready=lambda: report({"is": "ready"}))


def main(argument: str) -> None:
    """Be the process: serve until standard input ends or until told to terminate."""

    async def body(report: Callable[[Report], None]) -> None:
        await run_keeper(KeeperConfig.from_json(argument), report)

    run_component(body)
