"""This station's view of all sites: the part of the bridge behind the station socket."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from pydantic_core import from_json

from skygcs import __version__
from skygcs.core.geo import Origin
from skygcs.errors import BusError, RpcError, TargetError
from skygcs.ext.federation.bridge.bus import Bus
from skygcs.ext.federation.bridge.own_origin import OwnOrigin
from skygcs.ext.federation.bridge.readers import Readers
from skygcs.ext.federation.bridge.remote_feed import RemoteFeed
from skygcs.ext.federation.bridge.station import Station
from skygcs.ext.federation.bridge.station_methods import SITES, station_methods
from skygcs.ext.federation.bridge.station_services import RemoteOrders
from skygcs.ext.federation.bridge.station_socket import StationSocket
from skygcs.ext.federation.protocol.received_json import cleaned, printable
from skygcs.ext.federation.protocol.remote_sites import CONTESTED_S, RemoteSites
from skygcs.ext.federation.protocol.site_names import qualified, select_at, subject_token
from skygcs.rpc.error_codes import LINK_ERROR

FULL_WITHIN_S = 1.0
"""Time limit of another site's answer with a whole state."""

AGES = frozenset({"age_s", "last_heartbeat_age_s", "state_age_s"})

MAX_FULL_BYTES = 1 << 20


class StationView:
    """A part of the bridge: the station socket and its services (`StationServices`). Run `run` in a task."""

    def __init__(self, station: Station, sites: RemoteSites, readers: Readers) -> None:
        self.site = station.site
        self.daemon_address = station.daemon_address
        self.daemon_token = station.daemon_token
        self.orders: RemoteOrders | None = None
        """Orders to other sites; set by the part that gives them."""
        self.conflicts: Callable[[], list[dict[str, Any]]] = list
        """Returns the conflicts with vehicles of other sites; set by the part that watches them."""
        self.one_bridge: Callable[[], dict[str, Any] | None] = _no_site
        """Which bridge of this site this one is; of the part that lets one act."""
        self._station = station
        self._bus: Bus = station.bus
        self._sites = sites
        self._clock = station.clock
        self._link = station.daemon_link("station")
        self._own = None if self._link is None else OwnOrigin(self._link)
        self.feed = RemoteFeed(sites, station.clock.now_s, lambda: self.origin)
        self.socket = StationSocket(station.socket_path, self)
        self._readers = readers
        readers.on_batch.append(self.feed.on_batch)
        readers.on_event.append(self.feed.on_event)
        station.methods[SITES] = self._answer_sites

    @property
    def origin(self) -> Origin | None:
        """Origin of the own world frame."""
        return None if self._own is None else self._own.origin

    async def run(self) -> None:
        """Serve the socket until it is cancelled. Raises LinkError."""
        await self.socket.start(station_methods(self._station.methods))
        try:
            if self._link is None or self._own is None:
                await asyncio.Event().wait()
            else:
                async with asyncio.TaskGroup() as group:
                    group.create_task(self._link.run(), name="daemon of the station")
                    group.create_task(self._own.run(), name="own origin")
        finally:
            self.feed.close()
            await self.socket.close()

    def status(self) -> dict[str, Any]:
        """JSON-able."""
        return {"socket": str(self.socket.path), **self.socket.stats()}

    # -- for the clients of the socket

    def site_names(self) -> Sequence[str]:
        return self._sites.names

    def hub_problem(self) -> str | None:
        """Why sites may be missing; None while the hub is connected."""
        return None if self._bus.connected else f"there is no connection to the hub: {self._bus.text}"

    def states(self, targets: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
        """The states of vehicles of other sites. Raises TargetError."""
        now, found = self._clock.now_s(), []
        for site, parts in targets.items():
            chosen = {row.name for row in select_at(site, parts, self._sites.rows(site))}
            states = self._sites.states(site, now, self.origin)
            for row, state in zip(self._sites.rows(site), states, strict=True):
                if row.name in chosen:
                    found.append(state)
        return found

    async def full_state(self, site: str, target: str) -> dict[str, Any]:
        """The whole state of one vehicle, as its daemon has it, with total ages. Raises TargetError, RpcError."""
        chosen = select_at(site, [target], self._sites.rows(site))
        if len(chosen) != 1:
            raise TargetError(f"{site}/{target} names {len(chosen)} vehicles; give one")
        name = chosen[0].name
        subject = f"state.{site}.full.{subject_token(name)}"
        try:
            answer = await self._bus.request(subject, b"", FULL_WITHIN_S)
        except BusError as error:
            text = (
                f"{site} does not answer ({error}); vehicles.list has its newest state of {site}/{name}, with its age"
            )
            raise RpcError(LINK_ERROR, text) from None
        return self._read_full(site, name, answer)

    def _read_full(self, site: str, name: str, answer: bytes) -> dict[str, Any]:
        try:
            if len(answer) > MAX_FULL_BYTES:
                raise ValueError("it is too long")
            found = cleaned(from_json(answer, allow_inf_nan=False))
            if "error" in found:
                raise RpcError(LINK_ERROR, f"{site}: {printable(str(found['error']), 300)}")
            state, sent_s = found["state"], found["sent_s"]
            if not isinstance(state, dict) or not isinstance(sent_s, float):
                raise ValueError("it is not a state")
        except (ValueError, KeyError, TypeError) as error:
            raise RpcError(LINK_ERROR, f"{site} sent a state of {name} that cannot be used ({error})") from None
        now = self._clock.now_s()
        offset = self._sites.clock(site, now)
        transit_s = None if offset is None else max(0.0, now - (sent_s - offset.offset_s))
        state = {**_older(state, transit_s), "name": qualified(site, name), "site": site}
        state["age_s"] = state.get("last_heartbeat_age_s")
        if self._sites.is_silent(site, now):
            state["connected"] = False
        return state

    def show_event(self, event: Mapping[str, Any]) -> None:
        """Show an event of this bridge like an event of another site."""
        site = self._station.name
        self._readers.recent.append({**event, "site": site})
        self.feed.on_event(site, event)

    def info(self) -> dict[str, Any]:
        """Answer daemon.info of a station that reaches no daemon. ``now_s``: the clock of a request's deadline_s."""
        station = self._station
        return {
            "version": __version__,
            "daemon": None,
            "now_s": round(station.loop.time(), 4),
            "fleet_file": None,
            "operator_timeout_s": None,
            "federation": {"site": station.site, "role": station.config.role, "socket": str(station.socket_path)},
        }

    def recent_events(self) -> list[dict[str, Any]]:
        """Recent events of other sites, oldest first."""
        return list(self._readers.recent)

    async def _answer_sites(self, _: dict[str, Any]) -> dict[str, Any]:
        """This station, its connection to the hub, and the other sites: total ages, vehicles, clocks."""
        station, now = self._station, self._clock.now_s()
        return {
            "station": station.name,
            "site": station.site,
            "role": station.config.role,
            "hub": self._bus.status(),
            "contested": now - self._sites.own_contested_at < CONTESTED_S,
            "bridge": self.one_bridge(),
            "sites": self._sites.sites(now),
            "conflicts": self.conflicts(),
        }


def _no_site() -> None:
    """Return None: a station that is no site is no site's bridge."""


def _older(value: Any, seconds: float | None) -> Any:
    """The same JSON with every age larger by ``seconds``; None: the ages become unknown."""
    if isinstance(value, list):
        return [_older(item, seconds) for item in value]
    if not isinstance(value, dict):
        return value
    return {
        key: (None if seconds is None else round(item + seconds, 3))
        if key in AGES and isinstance(item, int | float)
        else _older(item, seconds)
        for key, item in value.items()
    }
