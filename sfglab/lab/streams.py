"""Processes of a camera's stream: camera, decoders and viewers on the hosts of a test bed."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.lab.workers.camera import CameraConfig
from sfglab.lab.workers.viewer import ViewerConfig
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.component import Report
    from sfglab.lab.testbed import Testbed

GLOBAL_DOMAIN = 0
FIRST_PICTURE_S = 60.0
LINGER_S = 0.1


class StreamProcesses(ProcessGroup):
    """Processes of a stream on a test bed's hosts; one of them is named ``camera``."""

    def __init__(self, config: Any, testbed: Testbed) -> None:
        self._config, self._testbed = config, testbed
        #: Number, time stamp and size of the frames that the camera reported.
        self.sent: list[tuple[int, int, int]] = []
        super().__init__(self.first_members(), wrap_command=testbed.argv, on_report=self.note)

    def first_members(self) -> Iterable[Member]:
        """Return the processes that are started on entering."""
        raise NotImplementedError

    def note(self, name: str, report: Report) -> None:
        """Store what a process reported; here the sent frames of the camera."""
        if name == "camera" and report["is"] == "sent":
            self.sent += [(n, s, b) for n, s, b in report["frames"]]

    @property
    def encoder(self) -> str:
        """Name of the encoder that the camera opened."""
        return str(self["camera"].readiness["encoder"])

    def shared(self, host: str) -> BusAddress:
        """Return the bus address of a host in the domain that all hosts share."""
        interface = self._testbed.interface(host)
        return BusAddress(
            domain_id=GLOBAL_DOMAIN, interface=interface, multicast=self._config.multicast
        )

    def camera(self, *places: tuple[BusAddress, str]) -> Member:
        """Return the camera, which publishes its frames at addresses on topics."""
        config = CameraConfig(
            places=places,
            source=self._config.source,
            seed=self._config.seed,
            encoder=self._config.encoder,
        )
        module = "sfglab.lab.workers.camera"
        return Member(name="camera", host="edge", module=module, config=config, ready="running")

    def viewer_config(self, topic: str, local: BusAddress, *, joined: bool = False) -> ViewerConfig:
        """Return the configuration of a viewer at the consumer for a stream's topic, with a local domain."""
        image = routes_of_topic(topic)[0]
        return ViewerConfig(
            remote=self.shared("consumer"),
            local=local,
            remote_topic=image.source_topic,
            remote_type=image.source_type,
            codec=image.codec,
            local_topic=image.local_topic,
            joined=joined,
        )

    async def seen(self, names: Iterable[str]) -> dict[str, Report]:
        """Stop viewers of the camera's stream, and return their reports by viewer.

        Capture stamps identify frames. In the reports, ``sightings`` has numbers of frames instead of
        stamps. ``unreadable`` is the number of frames with a stamp that the camera did not send. ``missed``
        is the number of frames that were skipped, and ``disordered`` that of frames that are not newer than
        the one before.
        """
        reports = await self.ask("seen", names, timeout_s=FIRST_PICTURE_S, do="stop")
        stamps = {stamp_ns for report in reports.values() for stamp_ns, _ in report["sightings"]}
        while stamps and self.sent[-1][1] < max(stamps):
            await self["camera"].expect("sent", timeout_s=FIRST_PICTURE_S)
        numbers = {stamp_ns: number for number, stamp_ns, _ in self.sent}
        for report in reports.values():
            known = [(numbers[t], seen_ns) for t, seen_ns in report["sightings"] if t in numbers]
            steps = np.diff([number for number, _ in known])
            report["unreadable"] = len(report["sightings"]) - len(known)
            report["missed"] = int(np.maximum(steps - 1, 0).sum())
            report["disordered"] = int((steps <= 0).sum())
            report["sightings"] = known
        return reports

    async def warm(self, decoder: str) -> tuple[int, ...]:
        """Return a decoder's process ids when its spare is ready, so that no measurement includes its start.

        Raises:
            ProcessFailedError: The spare process does not become ready.
        """
        process = self[decoder]
        for _ in range(500):
            process.order(do="list")
            listed = await process.expect("processes", timeout_s=FIRST_PICTURE_S)
            if listed["warm"]:
                return (process.pid, *listed["pids"])
            await asyncio.sleep(0.02)
        raise ProcessFailedError(f"{decoder}: its spare pipeline process did not become ready")

    async def released(self, decoder: str) -> None:
        """Wait until a decoder has released its pipeline."""
        while (await self[decoder].expect("status", timeout_s=FIRST_PICTURE_S))["state"] != "IDLE":
            pass
