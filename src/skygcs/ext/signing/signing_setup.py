"""Gives vehicles a signing key, or removes it: sends SETUP_SIGNING and verifies it by the frames they send afterwards.

The message has no acknowledgement and contains the key in clear. It is sent on one channel, never recorded, and refused
if another receiver could hear it.
"""

from __future__ import annotations

import asyncio
import ipaddress
from pathlib import Path

from skygcs.config.models import (
    SerialLinkConfig,
    TcpClientLinkConfig,
    TcpServerLinkConfig,
    UdpClientLinkConfig,
    UdpServerLinkConfig,
)
from skygcs.config.signing import read_key
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.msgids import SETUP_SIGNING, STATUSTEXT
from skygcs.core.mavlink.signing import KEY_BYTES, is_signed_with, key_id
from skygcs.core.protocols.command import MAX_TEXTS, Outcome
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.routing.source_statistics import RADIO_SOURCE
from skygcs.core.vehicle.flight_evidence import why_not_idle
from skygcs.core.vehicle.flight_lock import SigningClockReset
from skygcs.core.vehicle.gate import standing
from skygcs.core.vehicle.orders import require_connected
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.events import Event
from skygcs.links.base import Channel
from skygcs.rpc.context import Services
from skygcs.runtime.fleet_orders import Reports, Unreported

SIGNING = standing("signing")

TRIES = 3
WAIT_S = 2.5
"""Wait after each transmission: two heartbeats, and the delay of a slow radio."""


ONLY_DISARMED = "a key is changed on the ground, disarmed"

RADIO_KEY = RADIO_SOURCE[0] << 8 | RADIO_SOURCE[1]


class SigningSetup:
    """`setup` and `off` serve the RPC; outcomes are events, without the key."""

    def __init__(self, core: Services) -> None:
        self._hub = core.hub
        self._fleet = core.fleet
        self._signing = core.signing
        self._now = core.now
        self._on_event = core.event_log.publish

    async def setup(
        self, targets: str | list[str], key_file: Path, *, force: bool = False, reports: Reports | None = None
    ) -> dict[str, Outcome]:
        """Give the vehicles the key of a file. Raises TargetError, or KeyFileError before anything is sent."""
        return await self._send_key(targets, read_key(key_file), reports or Unreported(), force=force)

    async def off(self, targets: str | list[str], *, reports: Reports | None = None) -> dict[str, Outcome]:
        """Remove the vehicles' key. Raises TargetError."""
        return await self._send_key(targets, None, reports or Unreported(), force=False)

    def reset_clock(self, wanted: str, *, force: bool = False) -> str:
        """See `Signing.reset_clock`. Without ``force`` it also raises RefusedError while a vehicle may be in use."""
        self._fleet.locks.require(SigningClockReset())
        now = self._now()
        used = [a.name for a in self._fleet.vehicles.values() if a.vehicle.connected and why_not_idle(a.vehicle, now)]
        if used and not force:
            raise RefusedError(
                f"{', '.join(used[:5])} armed or in the air: a vehicle that has heard the later time takes no order "
                "signed with an earlier one; land first, or insist with force (--force)"
            )
        return self._signing.reset_clock(wanted)

    async def _send_key(
        self, targets: str | list[str], key: bytes | None, reports: Reports, *, force: bool
    ) -> dict[str, Outcome]:
        vehicles = [actor.vehicle for actor in self._fleet.resolve(targets)]
        reports.begun([vehicle.name for vehicle in vehicles])

        async def one(vehicle: Vehicle) -> Outcome:
            outcome = await self._report_one(vehicle, key, force=force)
            reports.ended(vehicle.name, outcome)
            return outcome

        async with asyncio.TaskGroup() as group:
            tasks = {vehicle.name: group.create_task(one(vehicle)) for vehicle in vehicles}
        return {name: task.result() for name, task in tasks.items()}

    async def _report_one(self, vehicle: Vehicle, key: bytes | None, *, force: bool) -> Outcome:
        what = "signing off" if key is None else f"signing setup (key {key_id(key)})"
        try:
            require_connected(vehicle, self._now())
            gates = self._hub.send_gates
            if gates is not None and (why := gates.refusal(vehicle.sysid, self._hub.boot_clock())) is not None:
                raise RefusedError(why)
            if (why := why_not_idle(vehicle, self._now())) is not None:
                raise RefusedError(f"{why}: {ONLY_DISARMED}")
            if key is not None and not force and self._signing.is_pinned(key):
                raise RefusedError(f"{self._signing.pinned_text(key)}, or insist with force (--force)")
            channel = self._channel_for(vehicle, with_key=key is not None, force=force)
        except RefusedError as error:
            outcome = Outcome(False, "refused", f"refused: {error}")
        else:
            try:
                outcome = await self._send_until_shown(vehicle, key, channel)
            except asyncio.CancelledError:
                text = (
                    f"{vehicle.name}: {what}: cancelled; it may or may not have been taken: skygcs-cli signing status"
                )
                self._on_event(Event("signing", vehicle.name, vehicle.sysid, text, {"result": "cancelled"}))
                raise
        text = f"{vehicle.name}: {what}: {outcome.message}"
        self._on_event(Event("signing", vehicle.name, vehicle.sysid, text, {"result": outcome.result}))
        return outcome

    def _channel_for(self, vehicle: Vehicle, *, with_key: bool, force: bool) -> Channel:
        """The channel that only this vehicle receives; with ``force`` the best one. Raises RefusedError naming others.

        Removing a key reveals none, so any channel will do.
        """
        channels = [
            self._hub.channels[i] for i in self._hub.channels_to(vehicle.sysid, vehicle.compid, everywhere=True)
        ]
        if not channels:
            raise RefusedError("no link on which it was heard")
        heard_by = {channel: self._others_on(channel, vehicle) for channel in channels}
        private = [channel for channel, others in heard_by.items() if others is None]
        if private:
            return private[0]
        if not with_key or force:
            (best,) = self._hub.channels_to(vehicle.sysid, vehicle.compid)[:1]
            return self._hub.channels[best]
        where = "; ".join(f"{channel.link.name}: {others}" for channel, others in heard_by.items())
        raise RefusedError(
            f"the key would be sent in clear where others can receive it ({where}); use a cable, or insist with "
            "force (--force)"
        )

    def _others_on(self, channel: Channel, vehicle: Vehicle) -> str | None:
        """Names other receivers of a channel, for a message; None: there are none."""
        config = channel.config
        if config.role == "radio" or RADIO_KEY in channel.sources:
            return "a radio, received by everyone in range"
        if isinstance(config, UdpServerLinkConfig | UdpClientLinkConfig | TcpServerLinkConfig | TcpClientLinkConfig):
            if not _is_this_machine(channel.peer):
                return f"a network, on the way to {channel.peer}"
        elif config.type == "udp_broadcast":
            return "a broadcast"
        elif isinstance(config, SerialLinkConfig) and config.role == "gcs":
            return "another ground station"
        others = [
            actor.name
            for key, actor in sorted(self._fleet.vehicles.items())
            if key in channel.sources and actor.sysid != vehicle.sysid
        ]
        return f"{', '.join(others[:5])} on the same link" if others else None

    async def _send_until_shown(self, vehicle: Vehicle, key: bytes | None, channel: Channel) -> Outcome:
        """Send it until the vehicle's frames show that it was accepted."""
        info = self._hub.dialect.messages.get(SETUP_SIGNING)
        if info is None:
            return Outcome(False, "unsupported", f"the dialect {self._hub.dialect.name} has no SETUP_SIGNING")
        began = self._now()
        shown = asyncio.Event()
        texts: list[str] = []

        # the evidence that it was accepted
        def look(frame: Frame) -> None:
            if frame.sysid != vehicle.sysid or frame.compid != vehicle.compid:
                return
            if frame.msgid == STATUSTEXT and len(texts) < MAX_TEXTS:
                texts.append(str(frame.fields().get("text", "")))
            if (key is None and not frame.signed) or (key is not None and _shows(frame, key)):
                shown.set()

        values = {"target_system": vehicle.sysid, "target_component": vehicle.compid, "secret_key": [0] * KEY_BYTES}
        # send, and check the vehicle's signatures
        for number in range(1, TRIES + 1):
            if (why := why_not_idle(vehicle, self._now())) is not None:
                refusal = f"refused: {why}: {ONLY_DISARMED}"
                return Outcome(False, "refused", refusal, number - 1, self._now() - began)
            if key is not None:
                values |= {"secret_key": list(key), "initial_timestamp": self._signing.stamp(key)}
            shown.clear()
            if not self._hub.send_on((channel.id,), info, values, Priority.COMMAND, clearance=SIGNING):
                return Outcome(False, "failed", f"{channel.link.name} did not accept the message", number)
            remove = self._hub.observers.add(None, {vehicle.key}, lambda frame, _, now: look(frame))
            try:
                with self._signing.watching(lambda frame, verdict: look(frame)):
                    async with asyncio.timeout(WAIT_S):
                        await shown.wait()
            except TimeoutError:
                continue
            finally:
                remove()
            message = (
                "it no longer signs" if key is None else f"it signs with key {key_id(key)}{self._left(vehicle, key)}"
            )
            return Outcome(True, "accepted", message, number, self._now() - began, tuple(texts))
        # no answer
        if key is None:
            why = "it still signs; it accepts this only over a link that signs with its key (or, ArduPilot, over USB)"
        else:
            why = "none of its frames was signed with this key; not every firmware can sign (PX4 1.16 cannot)"
            why += ", and a vehicle with another key accepts a new one only over a link that signs with the old one"
        return Outcome(False, "timeout", why, TRIES, self._now() - began, tuple(texts))

    def _left(self, vehicle: Vehicle, key: bytes) -> str:
        """Return what remains to be changed on our links to the vehicle."""
        heard = {c.link.name: c for c in self._hub.channels.values() if vehicle.key in c.sources}
        silent = [name for name in heard if self._signing.link_key(name) is None]
        other = [name for name in heard if self._signing.link_key(name) not in (None, key)]
        todo = (
            [f"{', '.join(silent)}: give the link the key, or the vehicle accepts no orders over it"] if silent else []
        )
        todo += [f"{', '.join(other)}: the link has another key and drops the vehicle's frames"] if other else []
        return "".join(f"; {text} (links.NAME.signing.key_file)" for text in todo)


def _shows(frame: Frame, key: bytes) -> bool:
    return frame.signed and is_signed_with(frame.raw, key)


def _is_this_machine(peer: str) -> bool:
    host = peer.rpartition(":")[0].strip("[]").partition("%")[0]
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
