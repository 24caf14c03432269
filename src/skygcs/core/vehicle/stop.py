"""The emergency stop: hold, land or kill, repeated until the vehicle's state shows its effect.

    hold    the mode that stops and holds (AUTO.LOITER, BRAKE), in which no setpoints move the vehicle
    land    the order land; of a class that has no landing the same as hold
    kill    forced disarming: the motors stop, and a flying vehicle falls; needs a confirmation

Unlike plain orders it is also sent to a vehicle that is lost or shares its id with another, with the highest priority
and over every link. It is repeated until the heartbeat shows its effect, the vehicle refuses it, or `PERSIST_S` is
over. A newer order replaces hold and land, but not kill.
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
from skygcs.spelling import enumerated

Action = Literal["hold", "land", "kill"]

PERSIST_S = 30.0
"""Some fifty transmissions. If none of them arrives, the vehicle's own failsafe for a lost station acts."""

MAX_NAMES = 10
"""Vehicles listed in a refusal; of further ones the number is stated."""


def stop(vehicle: Vehicle, now: float, action: Action) -> Plan:
    """Raises RefusedError for a vehicle of a recording, and for a hold if it has no mode that holds."""
    require_live(vehicle)
    if action == "hold" or (action == "land" and not autopilot.can_land(vehicle)):
        plan = autopilot.brake(vehicle, now)
        hint = f"{autopilot.firmware_name(vehicle)} did not say why; stop it with land"
        plan = replace(plan, steps=tuple(replace(step, refused=hint) for step in plan.steps))
    elif action == "land":
        known = vehicle.abilities.lands
        plan = autopilot.land(vehicle, now) if known else autopilot.land_by_command(vehicle)
    else:
        plan = replace(autopilot.disarm(force=True), done="motors stopped")
    return replace(plan, order="stop", emergency=True, persist_s=PERSIST_S)


def require_confirmed(action: str, vehicles: Mapping[str, str | None], confirm: str | None) -> None:
    """Raises RefusedError for a kill, or for the action "disarm" with a duplicate system id, without the right word of
    confirmation. The error names the vehicles and the word.

    ``vehicles``: vehicle name -> where a second vehicle sends with its ids (`SharedIds.where`). The word
    contains the number of vehicles that would get the order, duplicates included: a script written for one vehicle
    does not kill them all, and the word can be typed quickly.
    """
    twice = sum(where is not None for where in vehicles.values())
    if action not in ("kill", "disarm") or (action == "disarm" and not twice):
        return
    word = f"{action}-{len(vehicles) + twice}"
    if confirm == word:
        return
    # duplicates first: they are the reason for the word
    names = sorted(vehicles, key=lambda name: vehicles[name] is None)
    named = [name if (where := vehicles[name]) is None else f"{name} (two vehicles: {where})" for name in names]
    wrong = "" if confirm is None else f", not {confirm[:40]!r}"
    text = f"{action} stops the motors of {enumerated(named, MAX_NAMES)}, which will fall if flying"
    raise RefusedError(f"{text}; confirm with {word!r}{wrong}")
