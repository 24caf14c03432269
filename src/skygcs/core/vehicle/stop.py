"""The emergency stop: hold, land or kill, repeated until the vehicle shows it.

    hold    into the mode that stops and holds where it is (AUTO.LOITER, BRAKE); nobody's setpoints move it there
    land    NAV_LAND, where it is
    kill    forced disarming: the motors stop, and a vehicle that flies falls; wants a confirmation

It differs from the plain orders: it is sent to a vehicle that is lost or shares its id with another as well, with the
highest priority and over every link, and given again until the heartbeat shows it, the vehicle refuses it, or
`PERSIST_S` is over. A newer order takes the place of hold and land, but not of a kill.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from skygcs.core.vehicle import autopilot
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.orders import require_live
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError

Action = Literal["hold", "land", "kill"]

PERSIST_S = 30.0
"""Some fifty transmissions. A vehicle that nothing reached for so long has its own failsafe for a lost station."""

MAX_NAMES = 10
"""So many are listed in a refusal; of more the number says enough."""


def stop(vehicle: Vehicle, now: float, action: Action) -> Plan:
    """Raises RefusedError for a vehicle of a recording, and for a hold where no mode holds."""
    require_live(vehicle)
    if action == "hold":
        plan = autopilot.brake(vehicle)
        hint = f"{autopilot.firmware_name(vehicle)} did not say why; stop it with land"
        plan = replace(plan, steps=tuple(replace(step, refused=hint) for step in plan.steps))
    elif action == "land":
        plan = autopilot.land(vehicle)
    else:
        plan = replace(autopilot.disarm(force=True), done="motors stopped")
    return replace(plan, order="stop", emergency=True, persist_s=PERSIST_S)


def require_confirmed(action: str, vehicles: Mapping[str, str | None], confirm: str | None) -> None:
    """Raises RefusedError for a kill, or for the action "disarm" with a duplicate system id, that is not confirmed with
    its word, naming the vehicles and the word.

    ``vehicles``: by name, where a second vehicle sends with its ids (`Vehicle.duplicate_where`). The word has the
    number of vehicles that would get the order, duplicates included: a script that says it for one does not kill them
    all, and somebody in a hurry can type it.
    """
    twice = sum(where is not None for where in vehicles.values())
    if action not in ("kill", "disarm") or (action == "disarm" and not twice):
        return
    word = f"{action}-{len(vehicles) + twice}"
    if confirm == word:
        return
    # first those of which there are two: that is what the word is for
    names = sorted(vehicles, key=lambda name: vehicles[name] is None)
    named = [name if (where := vehicles[name]) is None else f"{name} (two vehicles: {where})" for name in names]
    who = ", ".join(named[:MAX_NAMES]) + (f" and {len(named) - MAX_NAMES} more" if len(named) > MAX_NAMES else "")
    wrong = "" if confirm is None else f", not {confirm[:40]!r}"
    raise RefusedError(f"{action} stops the motors of {who}, which will fall if flying; confirm with {word!r}{wrong}")
