"""The interfaces of the bridge that a client of the station socket uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from skygcs.ext.federation.bridge.remote_feed import RemoteFeed
from skygcs.rpc.json_lines import OrderReports


class RemoteOrders(Protocol):
    """Orders to vehicles of other sites; `skygcs.ext.federation.bridge.orders_sent`."""

    methods: frozenset[str]
    """Methods that may be sent to other sites."""

    def check(
        self, method: str, params: Mapping[str, Any], targets: Mapping[str, Sequence[str]], own: Sequence[str] = ()
    ) -> None:
        """See `skygcs.ext.federation.bridge.orders_sent.OrdersSent.check`."""
        ...

    async def give(
        self,
        method: str,
        params: Mapping[str, Any],
        targets: Mapping[str, Sequence[str]],
        by: str,
        own: int = 0,
        reports: OrderReports | None = None,
    ) -> dict[str, dict[str, Any]]:
        """The outcome of each vehicle by its name (south/alpha). ``params``: without targets. ``by``: the user of the
        client. ``own``: how many own vehicles get it, after `check`. ``reports`` gets each outcome as it comes. Raises
        SkygcsError before anything was sent."""
        ...


class StationServices(Protocol):
    """The services for a client of the station; implemented by `station_view.StationView`."""

    site: str | None
    daemon_address: str | None
    """A path or tcp://HOST:PORT; None: this station has no daemon."""
    daemon_token: str | None
    feed: RemoteFeed
    orders: RemoteOrders | None
    """None: this station gives no orders to other sites."""

    def site_names(self) -> Sequence[str]:
        """The other sites that were heard."""
        ...

    def hub_problem(self) -> str | None:
        """Why sites may be missing; None while the hub is connected."""
        ...

    def states(self, targets: Mapping[str, Sequence[str]]) -> list[dict[str, Any]]:
        """The states of vehicles of other sites. Raises TargetError."""
        ...

    async def full_state(self, site: str, target: str) -> dict[str, Any]:
        """The whole state of one vehicle of another site. Raises SkygcsError."""
        ...

    def info(self) -> dict[str, Any]:
        """Answer daemon.info of a station without a daemon."""
        ...

    def recent_events(self) -> list[dict[str, Any]]:
        """Recent events of other sites."""
        ...
