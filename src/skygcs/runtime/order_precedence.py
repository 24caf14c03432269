"""Precedence of one vehicle's orders: whether one that was asked for still counts, or a newer one, its pilot or its
state has taken its place.

Orders that move the vehicle are counted in the `OrderLedger`; each has a serial from when it was asked for. Nothing is
sent here.

    question                                    asked
    -----------------------------------------   ------------------------------------------------------------------------
    `overtaken`, `taken_by_pilot`               before an order is planned that has waited since `asked`
    `late`                                      before its plan is executed: awaits the end of a later one in progress
    `taken`, `pilot_since`                      before each transmission, and between two attempts
    `superseded`                                where it takes effect without a plan

And of one vehicle's setpoints, whether they are those of the client that it follows (`StreamGate`).
"""

from __future__ import annotations

import asyncio
import math
from collections.abc import Callable
from dataclasses import replace

from skygcs.core.protocols.command import CommandSpec, Outcome
from skygcs.core.vehicle.autopilot import arms
from skygcs.core.vehicle.flight_evidence import disarmed_since
from skygcs.core.vehicle.order_ledger import ClientIdentity, OrderLedger, StreamOwner
from skygcs.core.vehicle.order_plan import Plan
from skygcs.core.vehicle.stick_modes import Hands, hands, taken_since
from skygcs.core.vehicle.takeoff_watch import reports_takeoff
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.events import Event
from skygcs.runtime.command_client import EVERYWHERE, SUPERSEDED
from skygcs.runtime.task_set import ORDER_SERIAL, Asked, ask

MOVING = frozenset(
    {"mode", "disarm", "takeoff", "land", "rtl", "hold", "goto", "reboot", "stop", "control", "release", "mission"}
)
"""Orders that replace the one in progress."""

ARMING = frozenset({"arm"})
"""Orders that arm and move nothing yet."""

ENDING = EVERYWHERE | {"stop"}
"""Orders that end a flight; they replace an arming in progress, too."""


class OrderPrecedence:
    """Precedence among the orders of one vehicle. ``first_number``: see `OrderLedger`."""

    def __init__(self, vehicle: Vehicle, loop: asyncio.AbstractEventLoop, first_number: int = 0) -> None:
        self.ledger = OrderLedger(first_number)
        self._vehicle = vehicle
        self._loop = loop
        self._ended = asyncio.Event()

    def note_end(self) -> None:
        """A plan in progress, or an order that is repeated, has ended."""
        self._ended.set()

    async def next_end(self) -> None:
        """Wait for the next `note_end`."""
        self._ended.clear()
        await self._ended.wait()

    def asked(self, serial: int | None = None) -> Asked:
        """Note that an order is asked for which does not go out at once. ``serial``: None: that of the present task,
        or, in an order of the daemon's own, that of the last order so far."""
        vehicle = self._vehicle
        changing = self.ledger.in_progress > 0 or reports_takeoff(vehicle, self._loop.time())
        serial = (ORDER_SERIAL.get() or self.ledger.effective_serial) if serial is None else serial
        return Asked(serial, None if changing else vehicle.custom_mode, self.ledger.number)

    def overtaken(self, asked: Asked, *, by_mode: bool = True) -> str | None:
        """Why an order that has waited since ``asked`` must not be sent any more; None: it may be. An order that was
        asked for later moves the vehicle, or may, or, with ``by_mode``, the mode has changed. Neither orders of the
        daemon's own count, nor those that the vehicle has refused."""
        switched = self._switched(asked) if by_mode else None
        if self.ledger.effective_serial > asked.serial or (
            switched is not None and self.ledger.is_behind(asked.serial)
        ):
            return SUPERSEDED
        return switched

    def taken_by_pilot(self, asked: Asked) -> str | None:
        """Why what changes the mode must not be sent any more: the mode was switched since ``asked``, and neither by an
        order of ours nor by a failsafe of the vehicle. None: it may be."""
        ours = self.ledger.number != asked.number or self._vehicle.failsafe
        return None if ours else self._switched(asked)

    def hands(self) -> Hands:
        """Whose hands the vehicle is in now."""
        return hands(self._vehicle, self._loop.time())

    def taken(self, plan: Plan, before: Hands, *, asked_now: bool) -> str | None:
        """Why a plan is left to the pilot of a vehicle that was in the hands ``before`` when it began; None: it is
        sent. One that ends the flight always is if a person gives it (``asked_now``)."""
        if self._vehicle.mode in plan.spares:
            return f"it is in {self._vehicle.mode}"
        if arms_in(plan) and (why := disarmed_since(self._vehicle, before.at)) is not None:
            return why
        if plan.emergency or plan.final or (plan.order in EVERYWHERE and asked_now):
            return None
        return self.pilot_since(plan.order, before)

    def pilot_since(self, order: str, before: Hands) -> str | None:
        """`taken_since` of an order that moves the vehicle or arms it; a mode that the vehicle has accepted from us and
        that shows late is not its pilot's."""
        vehicle = self._vehicle
        if order not in ARMING | MOVING:
            return None
        if self.ledger.is_own_mode(vehicle.custom_mode, vehicle.mode_changes, vehicle.mode_since):
            before = before._replace(stick_mode=vehicle.mode)
        if order in MOVING:
            return taken_since(vehicle, self._loop.time(), before)
        why = taken_since(vehicle, self._loop.time(), before._replace(armed=True))
        return why and f"{why}; order it again to arm it in {vehicle.mode}"

    def _switched(self, asked: Asked) -> str | None:
        if asked.custom_mode is None or self._vehicle.custom_mode == asked.custom_mode:
            return None
        return f"it was switched to {self._vehicle.mode} while this order waited"

    async def late(self, order: str = "goto") -> str | None:
        """Why an order of the present task, which moves the vehicle, must not be sent: one that was asked for later
        moves it, or may. None: it may be. The end of a later one that is in progress is awaited, as the vehicle may
        refuse that."""
        serial = ORDER_SERIAL.get()
        if not serial or order not in MOVING or order == "stop":
            return None
        while self.ledger.is_behind(serial) and self.ledger.effective_serial <= serial:
            await self.next_end()
        return self.superseded()

    def superseded(self) -> str | None:
        """Why the order of the present task must not take effect: one that was asked for later has; None: it may."""
        return SUPERSEDED if self.ledger.effective_serial > (ORDER_SERIAL.get() or math.inf) else None

    def note_effect(self) -> None:
        """The order of the present task moves the vehicle without a plan: under control by setpoints."""
        serial = ORDER_SERIAL.get()
        self.ledger.note_effect(ask() if serial is None else serial)


def arms_in(plan: Plan) -> bool:
    """True if a command of this plan arms."""
    return any(arms(spec) for spec in commands_of(plan))


def commands_of(plan: Plan) -> list[CommandSpec]:
    """The commands of a plan, in their order."""
    return [step.command for step in plan.steps if step.command is not None]


class StreamGate:
    """The gate that every setpoint to one vehicle comes through; `StreamOwner` decides whose stream it follows."""

    def __init__(
        self,
        owner: StreamOwner,
        vehicle: Vehicle,
        loop: asyncio.AbstractEventLoop,
        on_event: Callable[[Event], None],
        flying: Callable[[], bool],
    ) -> None:
        """``flying()``: True while the vehicle flies by setpoints."""
        self.owner = owner
        self._vehicle = vehicle
        self._loop = loop
        self._on_event = on_event
        self._flying = flying

    def follow(
        self, client: ClientIdentity, valid_s: float, follow: Callable[[], Outcome], *, take_over: bool = False
    ) -> Outcome:
        """Follow one setpoint of this client, good for ``valid_s``, unless the vehicle follows those of another."""
        owner, now = self.owner, self._loop.time()
        why = owner.refusal(client, valid_s, now, take_over=take_over)
        if not self._flying():
            return follow()  # which refuses it for a reason of its own
        if why is not None:
            if owner.is_new(client):
                self._report(f"setpoints of {client.name} are refused: {why}", client)
            return replace(Outcome.refused(why), taken=True)
        outcome = follow()
        if outcome.ok and (before := owner.followed(client, valid_s, now)) is not None:
            self._report(f"{client.name} has taken over from the setpoints of {before.name}", client)
        return outcome

    def lead(self, client: ClientIdentity, valid_s: float) -> None:
        """An order has this client fly it: its stream takes the place of any other."""
        if (before := self.owner.followed(client, valid_s, self._loop.time())) is not None:
            self._report(f"{client.name} has taken over from the setpoints of {before.name}", client)

    def ended(self, how: str, *, spares: ClientIdentity | None = None) -> Callable[[], None]:
        """An order leads it from now on; see `StreamOwner.ended`."""
        return self.owner.ended(how, self._loop.time(), spares=spares)

    def _report(self, text: str, client: ClientIdentity) -> None:
        self._on_event(Event("control", self._vehicle.name, self._vehicle.sysid, text, {"client": client.name}))
