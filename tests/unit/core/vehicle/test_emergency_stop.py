"""What an emergency stop is made of, and how a kill is confirmed."""

from __future__ import annotations

import math

import pytest

from skygcs.core.vehicle import orders
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from support.table import each
from support.vehicles import ARDUPILOT, PX4, PX4_LOITER, Voice, flight_dialect

NOW = 100.0


def heard(autopilot: int, *, kind: int = 2) -> Vehicle:
    vehicle = Vehicle(1, 1, flight_dialect(), decoder=Decoder(flight_dialect()))
    vehicle.on_frame(Voice(1).beat(autopilot, PX4_LOITER if autopilot == PX4 else 0, armed=True, kind=kind), NOW)
    return vehicle


@each("autopilot", [PX4, ARDUPILOT])
@each(("action", "command"), [("hold", 176), ("land", 21), ("kill", 400)])
def test_every_action_is_an_emergency_that_persists_also_for_a_lost_vehicle(
    autopilot: int, action: orders.Action, command: int
) -> None:
    vehicle = heard(autopilot)
    vehicle.tick(NOW + 60)
    assert not vehicle.connected
    plan = orders.stop(vehicle, NOW + 60, action)
    assert plan.order == "stop" and plan.emergency and plan.persist_s == 30
    assert plan.final is (action == "kill"), "only a kill is the last word"
    (step,) = plan.steps
    assert step.command is not None
    if action == "hold" and autopilot == PX4:  # AUTO.LOITER ordered during a goto, which flies in it, changes nothing
        assert (step.command.command, step.command.params[:3], step.expect) == (192, (-1, 1, 0), None)
        assert all(math.isnan(p) for p in step.command.params[3:])
    else:
        assert step.command.command == command
    if action == "kill":
        assert step.command.params == (0, 21196)


def test_a_recording_is_not_stopped_and_what_has_no_hold_says_so() -> None:
    vehicle = heard(PX4)
    vehicle.replayed = True
    with pytest.raises(RefusedError, match="recording"):
        orders.stop(vehicle, NOW, "kill")
    with pytest.raises(RefusedError, match="knows only PX4 and ArduPilot"):
        orders.stop(heard(0), NOW, "hold")


def test_a_kill_names_who_falls_and_wants_a_word_that_counts_them() -> None:
    names = dict.fromkeys(["alpha", "bravo"])
    orders.require_confirmed("land", names, None)
    orders.require_confirmed("kill", names, "kill-2")
    with pytest.raises(RefusedError, match=r"alpha and bravo, .* confirm with 'kill-2'$"):
        orders.require_confirmed("kill", names, None)
    for wrong in ("kill-1", "kill", "yes", "KILL-2", ""):
        with pytest.raises(RefusedError, match="not '"):
            orders.require_confirmed("kill", names, wrong)
    with pytest.raises(RefusedError, match="and 20 more"):
        orders.require_confirmed("kill", dict.fromkeys(f"v{n}" for n in range(30)), "kill-2")


@each("action", ["kill", "disarm"])
def test_a_duplicate_id_counts_twice_and_its_links_are_named(action: str) -> None:
    where = "on udp (10.0.0.5:14550) and on udp (10.0.0.9:14550)"
    vehicles = {"alpha": None, "bravo": where}
    with pytest.raises(RefusedError, match=rf"bravo \(two vehicles: .*10\.0\.0\.9.*and alpha, .* '{action}-3'$"):
        orders.require_confirmed(action, vehicles, None)
    with pytest.raises(RefusedError, match=f"not '{action}-2'"):
        orders.require_confirmed(action, vehicles, f"{action}-2")
    orders.require_confirmed(action, vehicles, f"{action}-3")
    orders.require_confirmed("disarm", {"alpha": None}, None)
    for other in ("hold", "land"):
        orders.require_confirmed(other, vehicles, None)
