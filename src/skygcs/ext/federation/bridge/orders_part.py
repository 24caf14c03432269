"""Orders of other stations as a part of the bridge: their subject, the daemon, their record on the bus."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from skygcs.disk_writer import DiskWriter
from skygcs.ext.federation.bridge.audit_file import AuditFile
from skygcs.ext.federation.bridge.bus import Message
from skygcs.ext.federation.bridge.daemon_orders import DaemonOrders
from skygcs.ext.federation.bridge.hub_config import ORDERS, STOPS
from skygcs.ext.federation.bridge.orders_taken import MAX_MESSAGES, MAX_STOP_MESSAGES, OrdersTaken, names_stop
from skygcs.ext.federation.bridge.station import Station
from skygcs.ext.federation.protocol.own_states import OwnStates
from skygcs.ext.federation.protocol.remote_sites import CONTESTED_S, RemoteSites
from skygcs.rpc.client import connect

FILE_NAME = "federation-orders.jsonl"
"""In the daemon's log folder."""

MAX_WAITING_RECORDS = 1000
"""Records that may wait to be sent to the bus; the file has all of them."""

NotHeld = Callable[[str], str | None]


def held(_: str) -> str | None:
    """Return no refusal: the vehicles of the site are all its own."""
    return None


class OrdersTakenPart:
    """`run` in a task. ``not_held``: why this site does not command a vehicle of this name; None if it does."""

    def __init__(self, station: Station, site: str, daemon_address: str, states: OwnStates, sites: RemoteSites) -> None:
        """``states``: of this site's vehicles, as they are shared. ``sites``: shows if another bridge sends under this
        site's name."""
        self.not_held: NotHeld = held
        self.others_took_orders: Callable[[], bool] = lambda: False
        """True if another bridge has acted as this site since this one began: its orders are not in the record here."""
        self._station = station
        self._records: asyncio.Queue[tuple[str, bytes]] = asyncio.Queue(MAX_WAITING_RECORDS)
        self._records_lost = 0
        self._states = states
        self._sites = sites
        self._daemon = DaemonOrders(
            lambda: connect(daemon_address, token=station.daemon_token),
            station.loop,
            lambda name: name in self._states,
        )
        file = AuditFile(station.fleet.daemon.log_dir / FILE_NAME)
        self._site = site
        disk = DiskWriter(station.loop, station.report)
        self._taken = OrdersTaken(
            site, self._daemon, file, disk, self._publish, self._why_not, station.clock.site_s, station.loop
        )

    async def run(self) -> None:
        """Take orders until it is cancelled."""
        if self.others_took_orders():
            self._taken.gate.forget_before(self._station.clock.site_s())

        async def answer(message: Message) -> bytes:
            return await self._taken.answer(message.subject, message.data, message.sender)

        bus = self._station.bus
        subscriptions = [
            await bus.serve(f"{STOPS}{self._site}.*", answer, at_once=MAX_STOP_MESSAGES),
            await bus.serve(
                f"{ORDERS}{self._site}.*",
                answer,
                at_once=MAX_MESSAGES,
                reserved=MAX_STOP_MESSAGES,
                is_urgent=names_stop,
            ),
        ]
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._daemon.run(), name="daemon of the orders")
                group.create_task(self._send_records(), name="record of orders")
        finally:
            for subscription in subscriptions:
                await subscription.close()
            await self._taken.close()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        daemon = {"connected": self._daemon.connected, "text": self._daemon.text}
        return {**self._taken.status(), "daemon": daemon, "records_lost": self._records_lost}

    def _why_not(self, vehicle: str) -> str | None:
        """Why no order of another station is taken for this vehicle."""
        contested_s = self._station.clock.now_s() - self._sites.own_contested_at
        if contested_s < CONTESTED_S:  # both get each order
            return f"two bridges send as {self._site}: end one of them"
        if vehicle in self._states and not self._states.shares(vehicle):
            return f"{vehicle} is not shared with other stations (federation.share)"
        return self.not_held(vehicle)

    def _publish(self, subject: str, data: bytes) -> None:
        try:
            self._records.put_nowait((subject, data))
        except asyncio.QueueFull:
            self._records_lost += 1

    async def _send_records(self) -> None:
        while True:
            subject, data = await self._records.get()
            if not await self._station.bus.publish(subject, data):
                self._records_lost += 1
