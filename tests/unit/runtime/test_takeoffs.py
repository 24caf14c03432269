"""The watch over a take-off: what it reports, what it begins, and what those hear that wait for its end."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.core.protocols.command import Outcome
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.order_ledger import OrderLedger
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.command_client import SUPERSEDED
from skygcs.runtime.takeoffs import LOOK_S, NOT_ORDERED_S, Takeoffs
from support.table import each
from support.vehicles import ARDUPILOT, HOME, PX4, PX4_LOITER, Voice, flight_dialect

pytestmark = pytest.mark.looptime

DECODER = Decoder(flight_dialect())
IN_AIR, TAKEOFF_STATE = 2, 3
GUIDED, RTL = 4, 6
PX4_TAKEOFF, PX4_OFFBOARD = 4 << 16 | 2 << 24, 6 << 16
ACCEPTED = Outcome(True, "accepted", "")


class Climber:
    """A vehicle that says ten times a second where it is and in what mode; it climbs with 1 m/s up to ``top_m``."""

    def __init__(self, control_mode: str = "position", autopilot: int = ARDUPILOT) -> None:
        self.loop = asyncio.get_running_loop()
        self.voice, self.autopilot = Voice(1), autopilot
        self.mode = GUIDED if autopilot == ARDUPILOT else PX4_TAKEOFF
        self.state = IN_AIR
        self.up_m, self.top_m = 0.0, 10.0
        self.vehicle = Vehicle(1, 1, flight_dialect(), decoder=DECODER, name="alpha")
        self.ledger = OrderLedger()
        self.events: list[Event] = []
        self.engaged: list[str] = []
        self.engages_with: Callable[[], Outcome] = lambda: ACCEPTED
        orders: Any = SimpleNamespace(ledger=self.ledger)
        self.takeoffs = Takeoffs(self.vehicle, control_mode, orders, self._engage, self.loop, self.events.append)
        self._say()
        self.telling = asyncio.create_task(self._tell())

    async def _engage(self, mode: str) -> Outcome:
        self.engaged.append(mode)
        await asyncio.sleep(1.0)
        return self.engages_with()

    async def _tell(self) -> None:
        while True:
            await asyncio.sleep(0.1)
            self.up_m = min(self.top_m, self.up_m + 0.1)
            self._say()

    def _say(self) -> None:
        now = self.loop.time()
        climbs = (0, 0, -100 if self.up_m < self.top_m else 0)
        for frame in (
            self.voice.beat(self.autopilot, self.mode, armed=True, status=4, kind=2),
            self.voice.landed(self.state),
            self.voice.position(alt_amsl_m=HOME[2] + self.up_m, rel_m=self.up_m, velocity=climbs),
        ):
            self.vehicle.on_frame(frame, now)

    def order(self, *, takes_effect: bool = True) -> int:
        """Another order, begun and ended."""
        number = self.ledger.begins("goto", 1, ends_flight=False)
        self.ledger.ended(number, ACCEPTED if takes_effect else Outcome.refused("no"))
        return number

    def take_off(self, height_m: float = 10.0, *, engage: bool = True, **outcome: Any) -> None:
        number = self.order(takes_effect=outcome.get("ok", True))
        fields = {"ok": True, "result": "accepted", "message": "", "order_number": number} | outcome
        self.takeoffs.begin(Outcome(**fields), HOME[2], height_m, engage=engage)

    async def ended(self) -> str | None:
        return await asyncio.wait_for(self.takeoffs.ended(), 2 * NOT_ORDERED_S)

    def told(self, kind: str) -> list[str]:
        return [event.text for event in self.events if event.kind == kind]


@pytest.fixture
async def made() -> AsyncIterator[list[Climber]]:
    climbers: list[Climber] = []
    yield climbers
    for climber in climbers:
        climber.telling.cancel()
        climber.takeoffs.cancel()
        await asyncio.gather(climber.telling, return_exceptions=True)


@each(
    ("control_mode", "engage", "engaged"),
    [("position", True, ["position"]), ("position", False, []), ("off", True, [])],
)
async def test_control_begins_at_its_height_and_what_waits_goes_on_after_it(
    made: list[Climber], control_mode: str, engage: bool, engaged: list[str]
) -> None:
    made.append(climber := Climber(control_mode))
    climber.take_off(engage=engage)
    begun = climber.loop.time()
    assert climber.takeoffs.under_way() == "it is taking off (0.0 of 10.0 m)"
    ended = asyncio.create_task(climber.ended())
    await asyncio.sleep(5.05)
    assert climber.takeoffs.under_way() == "it is taking off (5.0 of 10.0 m)" and not climber.engaged
    assert await ended is None
    assert climber.engaged == engaged and climber.up_m > 9.0
    assert climber.loop.time() - begun == pytest.approx(10.1 + len(engaged), abs=2 * LOOK_S)
    assert climber.takeoffs.under_way() is None and climber.events == []


@each(
    ("result", "mode", "why"),
    [
        (ACCEPTED, GUIDED, None),
        (ACCEPTED, RTL, "it was switched to RTL during its take-off"),
        (Outcome(False, "failed", "no"), GUIDED, None),
        (Outcome(False, "failed", "no"), RTL, "it was switched to RTL during its take-off"),
        (Outcome(False, "cancelled", "no"), GUIDED, SUPERSEDED),
    ],
)
async def test_what_became_of_the_control_decides(
    made: list[Climber], result: Outcome, mode: int, why: str | None
) -> None:
    made.append(climber := Climber())

    def engages() -> Outcome:
        climber.mode = mode
        climber._say()
        return result

    climber.engages_with = engages
    climber.take_off()
    assert await climber.ended() == why


@each(("accepted", "why"), [(True, None), (False, "it was switched to OFFBOARD during its take-off")])
async def test_offboard_is_where_control_leaves_a_px4(made: list[Climber], accepted: bool, why: str | None) -> None:
    made.append(climber := Climber(autopilot=PX4))

    def engages() -> Outcome:
        climber.mode = PX4_OFFBOARD
        climber._say()
        return Outcome(accepted, "accepted" if accepted else "failed", "")

    climber.engages_with = engages
    climber.take_off()
    await asyncio.sleep(9.95)
    climber.mode = PX4_LOITER
    assert await climber.ended() == why and climber.engaged


@each(
    ("control_mode", "engage", "ends", "told", "not_engaged"),
    [
        ("position", True, {"mode": RTL}, [], ["its mode became RTL"]),
        ("position", False, {"mode": RTL}, [], []),
        ("off", True, {"mode": RTL}, [], []),
        (
            "velocity",
            True,
            {"top_m": 4.0},
            ["it stopped climbing 4.0 m above the ground it stood on; 10.0 m were ordered"],
            ["it stopped climbing 4.0 m above the ground it stood on; 10.0 m were ordered"],
        ),
    ],
)
async def test_one_that_does_not_end_as_it_was_ordered_engages_nothing(
    made: list[Climber], control_mode: str, engage: bool, ends: dict[str, Any], told: list[str], not_engaged: list[str]
) -> None:
    made.append(climber := Climber(control_mode))
    climber.take_off(engage=engage)
    await asyncio.sleep(3.0)
    for name, value in ends.items():
        setattr(climber, name, value)
    why = await climber.ended()
    assert why is not None and why.startswith("its take-off did not end as it was ordered: it")
    assert not climber.engaged and climber.takeoffs.under_way() is None
    assert climber.told("takeoff") == [f"its take-off is wrong: {text}" for text in told]
    assert climber.told("control") == [f"control is not engaged after the take-off: {text}" for text in not_engaged]
    for event in climber.events:
        assert (event.vehicle, event.sysid) == ("alpha", 1)
        assert event.data == ({"state": "off"} if event.kind == "control" else {"height_m": 4.0, "wanted_m": 10.0})


async def test_an_order_that_takes_effect_ends_the_watch_and_one_in_progress_suspends_it(made: list[Climber]) -> None:
    made.append(climber := Climber())
    climber.take_off()
    waits = asyncio.create_task(climber.ended())
    await asyncio.sleep(3.0)
    # while it is sent nothing is judged, and refused it changes nothing
    number = climber.ledger.begins("goto", 1, ends_flight=False)
    climber.mode = RTL
    await asyncio.sleep(2.0)
    climber.mode = GUIDED
    await asyncio.sleep(0.2)
    climber.ledger.ended(number, Outcome.refused("no"))
    await asyncio.sleep(1.0)
    assert not climber.events and climber.takeoffs.under_way() is not None
    climber.order()
    assert await waits == SUPERSEDED
    await asyncio.sleep(20.0)
    assert not climber.events and not climber.engaged and climber.takeoffs.under_way() is None


async def test_a_newer_take_off_takes_the_place_of_one_unless_it_is_refused(made: list[Climber]) -> None:
    made.append(climber := Climber())
    climber.take_off()
    await asyncio.sleep(3.0)
    climber.take_off(20.0, ok=False, result="denied")
    climber.takeoffs.begin(Outcome.refused("no"), HOME[2], 20.0, engage=True)
    assert climber.takeoffs.under_way() == "it is taking off (2.9 of 10.0 m)"
    climber.takeoffs.begin(ACCEPTED, None, 20.0, engage=True)
    assert climber.takeoffs.under_way() == "it is taking off (2.9 of 10.0 m)", "without a height nothing is watched"
    waits = asyncio.create_task(climber.ended())
    climber.top_m = 20.0
    await asyncio.sleep(1.0)
    climber.take_off(20.0)
    assert climber.takeoffs.under_way() == "it is taking off (3.9 of 20.0 m)"
    assert await waits == SUPERSEDED
    assert await climber.ended() is None and climber.engaged == ["position"] and climber.up_m > 18.0


async def test_it_may_be_one_whose_number_is_not_known_or_that_took_effect_unanswered(made: list[Climber]) -> None:
    made.append(climber := Climber())
    climber.order()
    climber.take_off(order_number=None)
    assert await climber.ended() is None and climber.engaged
    # one that failed but may have had an effect ends the watch over the one before
    climber.take_off(20.0)
    number = climber.order()
    climber.takeoffs.begin(Outcome(False, "timeout", "", order_number=number), HOME[2], 30.0, engage=True)
    assert climber.takeoffs.under_way() is None


async def test_when_the_daemon_ends_nothing_is_begun(made: list[Climber]) -> None:
    made.append(climber := Climber())
    climber.take_off()
    waits = asyncio.create_task(climber.ended())
    await asyncio.sleep(2.0)
    climber.takeoffs.cancel()
    climber.takeoffs.cancel()
    assert await waits == SUPERSEDED and climber.takeoffs.under_way() is None
    await asyncio.sleep(20.0)
    assert not climber.engaged and not climber.events


@each(
    ("autopilot", "change", "after_s", "why"),
    [
        (PX4, {"mode": PX4_LOITER, "state": IN_AIR}, 5.0, None),
        (PX4, {"mode": PX4_OFFBOARD, "state": IN_AIR}, 5.0, "it was switched to OFFBOARD during its take-off"),
        (ARDUPILOT, {"state": IN_AIR}, 5.0, None),
        (ARDUPILOT, {"state": IN_AIR, "mode": RTL}, 5.0, "it was switched to RTL during its take-off"),
        (PX4, {}, NOT_ORDERED_S, "it still reports a take-off, which was not ordered here"),
        (PX4, {"order": True}, 5.0, SUPERSEDED),
        (PX4, {"order": False}, NOT_ORDERED_S, "it still reports a take-off, which was not ordered here"),
    ],
)
async def test_one_that_was_not_ordered_here_is_waited_for(
    made: list[Climber], autopilot: int, change: dict[str, Any], after_s: float, why: str | None
) -> None:
    made.append(climber := Climber(autopilot=autopilot))
    assert autopilot == PX4 or (climber.takeoffs.under_way() is None and await climber.ended() is None)
    climber.state = TAKEOFF_STATE
    climber._say()
    begun = climber.loop.time()
    assert climber.takeoffs.under_way() == "it reports a take-off"
    waits = asyncio.create_task(climber.ended())
    await asyncio.sleep(5.0)
    assert not waits.done()
    for name, value in change.items():
        if name == "order":
            climber.order(takes_effect=value)
        else:
            setattr(climber, name, value)
    assert await waits == why
    assert climber.loop.time() - begun == pytest.approx(after_s, abs=2 * LOOK_S + 0.1)


async def test_the_mode_it_had_before_is_no_switch(made: list[Climber]) -> None:
    """An ArduCopter that climbs in RTL, as its pilot wanted."""
    made.append(climber := Climber())
    climber.mode = RTL
    climber.state = TAKEOFF_STATE
    climber._say()
    waits = asyncio.create_task(climber.ended())
    await asyncio.sleep(2.0)
    climber.state = IN_AIR
    assert await waits is None
