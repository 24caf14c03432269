"""The place that every own message passes: what it lets through, keeps back, counts and reports."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import check, encode
from skygcs.core.vehicle import gate
from skygcs.core.vehicle.gate import MAX_REPORTED, Clearance, OutgoingGate, clear_message
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import model_of
from skygcs.errors import RefusedError
from skygcs.events import Event
from support.table import each

DIALECT = load_dialect("ardupilotmega")
NOW = 10.0


def vehicle(*, armed: bool) -> Vehicle:
    made = Vehicle(1, 1, DIALECT, name="alpha")
    beat = {"type": 2, "autopilot": 3, "base_mode": 0x80 if armed else 0, "system_status": 4 if armed else 3}
    raw = encode(DIALECT.by_name["HEARTBEAT"], beat | {"mavlink_version": 3}, sysid=1, compid=1, seq=0)
    frame, _ = check(raw, DIALECT.messages)
    assert frame is not None
    made.on_frame(frame, NOW)
    return made


ARMED, DISARMED = vehicle(armed=True), vehicle(armed=False)


class Watched:
    """A gate and what it reports."""

    def __init__(self) -> None:
        self.events: list[Event] = []
        self.gate = OutgoingGate(lambda: NOW, self.events.append)

    def passes(
        self,
        name: str,
        fields: dict[str, Any] | None = None,
        clearance: Clearance | None = None,
        to: Iterable[Vehicle] = (ARMED,),
    ) -> bool:
        return self.gate.passes(name, fields or {}, clearance, lambda: to)


@each("to", [(), (ARMED,), (DISARMED,), (DISARMED, ARMED)])
def test_without_a_clearance_a_message_passes_as_a_raw_one_on_which_nobody_insists(to: tuple[Vehicle, ...]) -> None:
    watched = Watched()
    models = [model_of(one, NOW) for one in to]
    messages: list[tuple[str, dict[str, Any]]] = [(name, {}) for name in sorted(DIALECT.by_name)]
    messages += [("COMMAND_LONG", {"command": number, "param1": 1.0}) for number in DIALECT.enums["MAV_CMD"]]
    numbers = {number: str(number) for number in DIALECT.enums["MAV_CMD"]}
    whats: dict[str, str] = {}  # kind -> why, of those kept back
    kept_back = 0
    for name, fields in messages:
        why = None
        try:
            clear_message(models, name, fields, {0: "0"} | numbers, force=False)
        except RefusedError as error:
            why = str(error)
            whats.setdefault(name if "command" not in fields else f"{name} {fields['command']}", why)
        assert watched.passes(name, fields, to=to) is (why is None), name
        kept_back += why is not None
        assert watched.gate.blocked == kept_back
    reported = [event.text.removeprefix("the outgoing gate kept a message back: ") for event in watched.events]
    assert reported == list(whats.values())[:MAX_REPORTED]


def test_a_clearance_lets_through_what_it_names_and_nothing_else() -> None:
    watched = Watched()
    setpoints = gate.standing("setpoints")
    for name in sorted(DIALECT.by_name):
        assert watched.passes(name, clearance=setpoints) is (
            name in setpoints.messages or name in gate.HARMLESS_MESSAGES
        )
    calibrate = gate.standing("calibrate")
    for number in DIALECT.enums["MAV_CMD"]:
        wanted = number in calibrate.commands or number in gate.HARMLESS_COMMANDS
        assert watched.passes("COMMAND_LONG", {"command": number, "param1": 1.0}, calibrate) is wanted


def test_the_reached_vehicles_are_looked_up_only_where_they_decide() -> None:
    """The hub works it out for each message: not for the many that pass anyway."""
    watched = Watched()

    def never() -> Iterable[Vehicle]:
        raise AssertionError("looked up the vehicles")

    assert watched.gate.passes("PING", {}, None, never)
    assert watched.gate.passes("GPS_RTCM_DATA", {}, gate.standing("corrections"), never)


def test_each_kind_is_reported_once_and_a_bounded_number_of_them_while_all_are_counted() -> None:
    watched = Watched()
    kinds = MAX_REPORTED + 10
    for _ in range(2):
        for number in range(60_000, 60_000 + kinds):
            assert not watched.passes("COMMAND_LONG", {"command": number})
    assert watched.gate.blocked == 2 * kinds
    whats = [event.data["what"] for event in watched.events]
    assert whats == [f"COMMAND_LONG {number}" for number in range(60_000, 60_000 + MAX_REPORTED)]
    assert {(event.kind, event.vehicle, event.sysid) for event in watched.events} == {("fault", None, None)}
