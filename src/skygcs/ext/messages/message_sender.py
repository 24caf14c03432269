"""Sends any message of the dialect for a client: selects vehicles and links, and checks the message.

Messages have a lower priority than orders (PROTOCOL), so that a stream of them does not delay orders.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from skygcs.core.mavlink.dialect import ABSENT, MessageInfo
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.core.vehicle.gate import Clearance, clear_message
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import RefusedError
from skygcs.runtime.fleet import Fleet
from skygcs.runtime.hub import Hub
from skygcs.runtime.linktable import LinkTable
from skygcs.runtime.task_set import ask
from skygcs.spelling import enumerated

SETPOINTS = frozenset({"SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"})


def target_fields(info: MessageInfo) -> tuple[str | None, str | None]:
    """Names of the fields for the target system and component of a message ("target" in MANUAL_CONTROL)."""
    at = {f.offset: f.name for f in info.fields}
    system, component = info.target_system_offset, info.target_component_offset
    return (None if system == ABSENT else at[system]), (None if component == ABSENT else at[component])


class MessageSender:
    """`send` serves the RPC method messages.send."""

    def __init__(self, hub: Hub, fleet: Fleet, links: LinkTable, now: Callable[[], float]) -> None:
        self._hub = hub
        self._fleet = fleet
        self._links = links
        self._now = now

    def send(
        self,
        name: str,
        fields: Mapping[str, Any],
        target: str | list[str] | None = None,
        link: str | None = None,
        *,
        force: bool = False,
    ) -> dict[str, Any]:
        """Send it to the vehicles of ``target``, with their ids filled in; or to all on ``link``; or to its own target
        field (0: everyone). Without target, link and target field it goes to every link with vehicles.

        What the outgoing gate does not let pass (`core.vehicle.gate`) is refused, most of it unless ``force``.

        The answer's "sent" counts transmissions; "note" names other vehicles that hear it, too. Raises KeyError
        (no such message), ValueError (bad field), TargetError, LinkError (no such link) or RefusedError.
        """
        asked = ask()
        # find the message; its target must be given once
        info = self._hub.dialect.find(name)
        system, _ = target_fields(info)
        if target is not None and link is not None:
            raise RefusedError("give either a target or a link, not both")
        # refuse setpoints to vehicles under control, and links that are bound
        if info.name in SETPOINTS:
            self._refuse_flown(info, fields, target)
        if link is not None:
            self._links.require(link)
            if self._links.configs[link].vehicles:
                raise RefusedError(f"link {link} is bound to vehicles: nothing of ours is sent there")
        # an addressed message needs an address
        if target is None and link is None and system is not None and system not in fields:
            raise RefusedError(
                f"{info.name} is addressed: give a target (a vehicle, a group, all), a link, or its field {system} "
                "(0: everyone)"
            )
        # clear it, and send it
        clearance = self._clear(info, fields, target, link, asked, force=force)
        if link is not None:
            return self._answer(info, int(self._on(self._hub.channels_of_link(link), info, fields, clearance)))
        if target is not None:
            return self._to_vehicles(info, fields, target, clearance)
        return self._to_field(info, fields, clearance)

    def _refuse_flown(self, info: MessageInfo, fields: Mapping[str, Any], target: str | list[str] | None) -> None:
        """Refuse setpoints to a vehicle that skygcs controls: it would follow two streams in turn."""
        system, _ = target_fields(info)
        sysid = int(fields.get(system or "", 0) or 0)
        meant = None if target is None else {actor.sysid for actor in self._fleet.resolve_any(target)}
        for actor in self._fleet.flown():
            if actor.sysid in meant if meant is not None else sysid in (0, actor.sysid):
                raise RefusedError(
                    f"{actor.name} is flown by setpoints of skygcs: end that first (control set {actor.name} off)"
                )

    def _clear(
        self,
        info: MessageInfo,
        fields: Mapping[str, Any],
        target: str | list[str] | None,
        link: str | None,
        asked: int,
        *,
        force: bool,
    ) -> Clearance:
        """The outgoing gate's leave for it. Raises RefusedError, also where a vehicle got an order that was asked for
        after ``asked``."""
        now, reached = self._now(), self._reached(info, fields, target, link)
        # the first call of all waits for the import of this module
        late = [v.name for v in reached if self._fleet.vehicles[v.key].runner.ledger.is_behind(asked)]
        if late:
            raise RefusedError(f"{info.name} was not sent: {enumerated(late, 10)} got a later order; send it again")
        models = [model_of(vehicle, now) for vehicle in reached]
        names = self._hub.dialect.enums.get("MAV_CMD", {})
        return clear_message(models, info.name, fields, names, force=force)

    def _reached(
        self, info: MessageInfo, fields: Mapping[str, Any], target: str | list[str] | None, link: str | None
    ) -> list[Vehicle]:
        """The vehicles that will accept the message."""
        system, _ = target_fields(info)
        live = {key: actor for key, actor in self._fleet.vehicles.items() if not actor.vehicle.replayed}
        channels: set[int] | None = None if link is None else set(self._hub.channels_of_link(link))
        if target is not None:
            meant = self._fleet.resolve_any(target)
            if system is not None:  # an autopilot may accept messages to a component id that it does not know
                sysids = sorted({actor.sysid for actor in meant})
                return [vehicle for sysid in sysids for vehicle in self._fleet.vehicles_of(sysid)]
            channels = {route for actor in meant for route in self._hub.channels_to(actor.sysid, actor.compid)}
        sysid = 0 if system is None else int(fields.get(system, 0) or 0)
        if sysid:
            return [actor.vehicle for actor in live.values() if actor.sysid == sysid]
        heard_on = self._hub.router.channels_of
        return [
            actor.vehicle for key, actor in live.items() if channels is None or channels.intersection(heard_on(key))
        ]

    def _to_field(self, info: MessageInfo, fields: Mapping[str, Any], clearance: Clearance) -> dict[str, Any]:
        """Send by the message's own target fields; without such fields to all."""
        system, component = target_fields(info)
        sysid = int(fields.get(system, 0) or 0) if system is not None else 0
        compid = int(fields.get(component, 0) or 0) if component is not None else 0
        sent = self._on(self._hub.channels_to(sysid, compid), info, fields, clearance)
        if not sent:
            raise RefusedError(f"{info.name} was not sent: {self._why_not(sysid)}")
        return self._answer(info, int(sent))

    def _to_vehicles(
        self, info: MessageInfo, fields: Mapping[str, Any], target: str | list[str], clearance: Clearance
    ) -> dict[str, Any]:
        meant = [(actor.sysid, actor.compid) for actor in self._fleet.resolve_any(target)]
        system, component = target_fields(info)
        sent = 0
        if system is None:
            channels = dict.fromkeys(route for sysid, compid in meant for route in self._hub.channels_to(sysid, compid))
            sent = sum(self._on((route,), info, fields, clearance) for route in channels)
            note = self._overheard(info, meant, set(channels))
        else:
            note = None
            given = int(fields.get(system, 0) or 0)
            if given and any(given != sysid for sysid, _ in meant):
                raise RefusedError(f"{system}={given} and the target {target} differ; leave one of them out")
            for sysid, compid in meant:
                addressed = {**fields, system: sysid}
                if component is not None:
                    addressed.setdefault(component, compid)
                sent += self._on(self._hub.channels_to(sysid, compid), info, addressed, clearance)
        if not sent:
            raise RefusedError(f"{info.name} was not sent: {self._why_not(*(sysid for sysid, _ in meant))}")
        return self._answer(info, sent, note)

    def _on(
        self, channels: tuple[int, ...], info: MessageInfo, fields: Mapping[str, Any], clearance: Clearance
    ) -> bool:
        return self._hub.send_on(channels, info, fields, Priority.PROTOCOL, clearance=clearance)

    def _overheard(self, info: MessageInfo, meant: list[tuple[int, int]], channels: set[int]) -> str | None:
        """Names the other vehicles behind the same channels."""
        others = [
            actor.name
            for key, actor in sorted(self._fleet.vehicles.items())
            if (actor.sysid, actor.compid) not in meant and channels.intersection(self._hub.router.channels_of(key))
        ]
        if not others:
            return None
        return f"{info.name} has no target field: on the same link {enumerated(others, 10)} got it as well"

    def _why_not(self, *sysids: int) -> str:
        gates = self._hub.send_gates
        for sysid in sysids if gates is not None else ():
            if gates is not None and (why := gates.refusal(sysid, self._hub.boot_clock())) is not None:
                return why
        if sysids and all(any(key >> 8 == sysid for key in self._hub.replayed) for sysid in sysids):
            return "its target exists only in a recording"
        return "no link on which its target was heard"

    @staticmethod
    def _answer(info: MessageInfo, sent: int, note: str | None = None) -> dict[str, Any]:
        return {"sent": sent, "message": info.name} | ({"note": note} if note is not None else {})
