"""A ground station that meets a fleet: everything it asks for at once, and again when nothing comes."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.mavlink.frame import Frame, encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.daemon import Daemon
from support.daemons import memory_link

LIST_AGAIN_S = 5.0
"""QGroundControl's ParameterManager repeats its request so often, four times ..."""
LIST_REPEATS = 4

MISSING_AFTER_S = 3.0
MISSION_AGAIN_S = 1.5
FILE_AGAIN_S = 1.0
REPEATS = 5
"""... and PlanManager and FTPManager theirs."""

STREAMS = (1, 2, 3, 6, 10, 11, 12)
ASKED = (519, 520, 512, 512, 410)
"""MAV_CMDs that a station asks each vehicle as it connects."""


class GroundStation:
    """On a memory link of the daemon, as 255/190 unless said otherwise."""

    def __init__(self, daemon: Daemon, link: str, sysid: int = 255, compid: int = 190) -> None:
        found = memory_link(daemon, link)
        self.dialect = daemon.dialect
        self.sysid, self.compid = sysid, compid
        self.parameters: dict[int, set[int]] = {}
        """Indices by vehicle, and ..."""
        self.counts: dict[int, int] = {}
        self.listed_at: dict[int, float] = {}
        """... when the last of them came."""
        self.texts: list[str] = []
        """STATUSTEXTs of the daemon, from whichever system."""
        self.heard: set[int] = set()
        self.on_frame: Callable[[Frame], None] | None = None
        self._peer = found.peer
        self._parser = FrameParser(daemon.dialect)
        self._peer.on_bytes = self._on_bytes
        self._seq = 0
        self._now = daemon.now
        self._tasks: list[asyncio.Task[None]] = []

    def send(self, name: str, **values: Any) -> None:
        info = self.dialect.by_name[name]
        self._seq = (self._seq + 1) & 0xFF
        self._peer.send(encode(info, values, sysid=self.sysid, compid=self.compid, seq=self._seq))

    def connect(self, vehicles: list[int]) -> None:
        """Begin with all of it, for all of them."""
        self.every(1.0, "HEARTBEAT", type=6, autopilot=8, mavlink_version=3)
        self.every(0.1, "TIMESYNC", tc1=0, ts1=1)
        self.every(1.0, "SYSTEM_TIME", time_unix_usec=1)
        for vehicle in vehicles:
            target = {"target_system": vehicle, "target_component": 1}
            self.again(LIST_AGAIN_S, LIST_REPEATS, "PARAM_REQUEST_LIST", target, lambda v: v in self.parameters)
            self._tasks.append(asyncio.create_task(self._ask_for_missing(vehicle)))
            self.again(MISSION_AGAIN_S, REPEATS, "MISSION_REQUEST_LIST", target)
            self.again(FILE_AGAIN_S, REPEATS, "FILE_TRANSFER_PROTOCOL", {**target, "payload": [0, 0, 0, 4, 14]})
            self.again(2.0, REPEATS, "LOG_REQUEST_LIST", {**target, "end": 0xFFFF})
            for stream in STREAMS:
                rate = {"req_stream_id": stream, "req_message_rate": 4, "start_stop": 1}
                self.again(3.0, REPEATS, "REQUEST_DATA_STREAM", {**target, **rate})
            for command in ASKED:
                self.again(3.0, 3, "COMMAND_LONG", {**target, "command": command, "param1": 148.0})

    async def _ask_for_missing(self, vehicle: int) -> None:
        """QGroundControl: ten at a time, when nothing has come for 3 s."""
        while not self.has_list(vehicle):
            await asyncio.sleep(MISSING_AFTER_S)
            if vehicle in self.counts and self._now() - self.listed_at[vehicle] >= MISSING_AFTER_S:
                missing = [n for n in range(self.counts[vehicle]) if n not in self.parameters[vehicle]]
                for index in missing[:10]:
                    self.send("PARAM_REQUEST_READ", target_system=vehicle, target_component=1, param_index=index)

    def every(self, period_s: float, name: str, **values: Any) -> None:
        self.again(period_s, 1_000_000, name, values)

    def again(
        self,
        period_s: float,
        repeats: int,
        name: str,
        values: Mapping[str, Any],
        enough: Callable[[int], bool] = lambda vehicle: False,
    ) -> None:
        """Send it so often, unless it is enough for the vehicle."""

        async def sending() -> None:
            for _ in range(repeats + 1):
                self.send(name, **values)
                await asyncio.sleep(period_s)
                if enough(values.get("target_system", 0)):
                    return

        self._tasks.append(asyncio.create_task(sending()))

    def disconnect(self) -> None:
        for task in self._tasks:
            task.cancel()

    def has_list(self, vehicle: int) -> bool:
        return vehicle in self.counts and len(self.parameters[vehicle]) >= self.counts[vehicle]

    def _on_bytes(self, data: bytes) -> None:
        for frame in self._parser.feed(data):
            self.heard.add(frame.sysid)
            if frame.name == "PARAM_VALUE":
                fields = frame.fields()
                if fields["param_index"] < fields["param_count"]:
                    self.parameters.setdefault(frame.sysid, set()).add(fields["param_index"])
                    self.counts[frame.sysid] = fields["param_count"]
                    self.listed_at[frame.sysid] = self._now()
            elif frame.name == "STATUSTEXT" and frame.compid == 25:
                self.texts.append(frame.fields()["text"])
            if self.on_frame is not None:
                self.on_frame(frame)
