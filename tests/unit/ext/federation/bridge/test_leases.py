"""The part of a bridge that holds leases, without a hub and in virtual time: what it answers to others."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic_core import from_json, to_json

from skygcs.errors import DaemonUnreachable, RpcError
from skygcs.ext.federation.bridge.bus import Message, OnRequest
from skygcs.ext.federation.bridge.leases import Leases
from skygcs.ext.federation.config import SharedVehicle
from skygcs.ext.federation.protocol.lease import VALID_S
from skygcs.rpc import error_codes

pytestmark = pytest.mark.looptime


class AwayBus:
    """A hub that is away; requests are brought to the part all the same."""

    connected = False

    def __init__(self) -> None:
        self.served: dict[str, OnRequest] = {}

    def on_change(self, observer: Callable[[], None]) -> None:
        """It never changes."""

    async def serve(self, subject: str, on_request: OnRequest) -> Any:
        self.served[subject] = on_request

        async def close() -> None:
            del self.served[subject]

        return SimpleNamespace(close=close)


class HoldingDaemon:
    """In the place of the connection to a daemon that has the lease of alpha. ``state``: answers `vehicles.get`."""

    def __init__(self, state: Callable[[], Awaitable[Any]]) -> None:
        self.client: object | None = None
        self._state = state
        self._on_change: Callable[[], None] = lambda: None

    def on_change(self, observer: Callable[[], None]) -> None:
        self._on_change = observer

    async def run(self) -> None:
        self.client = object()
        self._on_change()
        try:
            await asyncio.Event().wait()
        finally:
            self.client = None
            self._on_change()

    async def call(self, method: str, **params: Any) -> Any:
        match method:
            case "authority.status":
                held = {"held": True, "remaining_s": VALID_S, "token": 1, "hub": "hub"}
                now_s = asyncio.get_running_loop().time()
                return {"site": "north", "run": "run", "now_s": now_s, "vehicles": {"alpha": held}}
            case "vehicles.get":
                return await self._state()
        return {"result": "granted"}


@contextlib.asynccontextmanager
async def holder(state: Callable[[], Awaitable[Any]]) -> AsyncIterator[tuple[Leases, AwayBus, dict[str, Any]]]:
    """The home of alpha, which it holds; its bus, and its methods for clients of the station."""
    bus = AwayBus()
    shared = {"alpha": SharedVehicle(home="north")}
    station: Any = SimpleNamespace(
        bus=bus, name="north", config=SimpleNamespace(vehicles=shared), methods={}, report=lambda event: None
    )
    leases = Leases(station, HoldingDaemon(state), asyncio.get_running_loop().time)  # type: ignore[arg-type]
    running = asyncio.create_task(leases.run())
    try:
        while leases.not_held("alpha") is not None:  # noqa: ASYNC110 - it signals nothing
            await asyncio.sleep(0.05)
        yield leases, bus, station.methods
    finally:
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


async def asked(bus: AwayBus, *, force: bool = False) -> Any:
    """The answer to south, which asks for alpha."""
    message = {"v": 1, "by": "south", "to": "north", "force": force}
    answer = await bus.served["lease.north.*.request"](Message("lease.north.alpha.request", to_json(message)))
    assert answer is not None
    return from_json(answer)["refusal"]


async def _state(control: str | None) -> Any:
    return {"control": None if control is None else {"state": control}}


async def _error(error: RpcError) -> Any:
    raise error


async def _silent() -> Any:
    await asyncio.Event().wait()


UNANSWERED = "the daemon of north does not say what it does with it; `--force` takes it all the same"


@pytest.mark.parametrize(
    ("state", "refusal"),
    [
        (lambda: _state("flying"), "it is flown by setpoints of north; `--force` takes it all the same"),
        (lambda: _state("ended"), None),
        (lambda: _state(None), None),
        (lambda: _error(RpcError(error_codes.TARGET_ERROR, "no vehicle alpha")), None),
        (_silent, UNANSWERED),
        (lambda: _error(DaemonUnreachable("socket", "it has ended")), UNANSWERED),
        (lambda: _error(RpcError(error_codes.LIMIT_EXCEEDED, "too many requests")), UNANSWERED),
    ],
    ids=["flown", "ended", "no control", "not heard", "silent", "ended daemon", "too many"],
)
async def test_a_vehicle_that_may_be_flown_is_not_given_away_without_force(
    state: Callable[[], Awaitable[Any]], refusal: str | None
) -> None:
    async with holder(state) as (leases, bus, _):
        assert await asked(bus) == refusal
        assert (leases.not_held("alpha") is None) == (refusal is not None)
        assert await asked(bus, force=True) is None
        assert leases.not_held("alpha") is not None


@pytest.mark.parametrize("method", ["federation.take", "federation.release"])
async def test_a_bridge_that_stands_by_says_which_one_to_ask(method: str) -> None:
    async with holder(lambda: _state(None)) as (leases, _, methods):
        pass
    # it stands by: the part does not run any more
    with pytest.raises(RpcError, match="alpha: the daemon of this site is away"):
        await methods[method]({"vehicle": "alpha"})
    leases.why_standby = lambda: "another bridge of north leads"
    with pytest.raises(RpcError, match="alpha: another bridge of north leads"):
        await methods[method]({"vehicle": "alpha"})
