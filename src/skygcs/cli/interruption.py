"""Ctrl-C while an order is under way: what was sent, what goes on, and the command that ends it.

`skygcs.cli.connection.run` calls `explain` for the requests that a command was waiting for, so that every command says
it. The daemon decides what a closed connection ends and what goes on: `Method.outlives_client`.

    an order                       after Ctrl-C                                          the command that ends it
    ----------------------------   ---------------------------------------------------   -------------------------------
    that ends a flight             the daemon carries it on to its outcome               (hold, where it moves)
    that moves or arms             it is tried no more; a vehicle that took it goes on   hold, land, disarm
    that sets something            nothing more is sent; what was taken is kept          the command that reads it
    of a plan                      the plan is as it was, or flies                       plan status, plan abort
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from skygcs.cli.render import fixed, plural, say
from skygcs.errors import SkygcsError
from skygcs.rpc.client import Client

SETTLE_S = 0.3
"""After the connection is closed, for what the daemon undoes then and for the next heartbeat; a person waits for it."""

STATES_S = 2.0
"""Seconds to wait for the states of the vehicles; a daemon answers within milliseconds."""

SHOWN = 12
"""Vehicles whose states are listed."""


class AfterEffect(NamedTuple):
    """Effect that goes on after an order was sent and its client left, and what ends it; ``{targets}`` is filled in."""

    goes_on: str
    ends: str


_CARRIED_ON = "the daemon carries it on until each vehicle has answered"
_TAKEN = "it is not tried again; a vehicle that has taken it goes on with it"
_KEPT = "nothing more is sent; what a vehicle has taken it keeps"
_HOLD = "`skygcs-cli hold {targets}`, or `land {targets}`"

AFTER: Mapping[str, AfterEffect] = {
    "vehicles.arm": AfterEffect(_TAKEN, "`skygcs-cli disarm {targets}`"),
    "vehicles.takeoff": AfterEffect(_TAKEN, _HOLD),
    "vehicles.goto": AfterEffect(_TAKEN, _HOLD),
    "vehicles.mode": AfterEffect(_TAKEN, _HOLD),
    "vehicles.command": AfterEffect(_TAKEN, _HOLD),
    "missions.start": AfterEffect(_TAKEN, "`skygcs-cli mission pause {targets}`"),
    "missions.resume": AfterEffect(_TAKEN, "`skygcs-cli mission pause {targets}`"),
    "missions.pause": AfterEffect(_TAKEN, "`skygcs-cli mission resume {targets}`"),
    "missions.set_current": AfterEffect(_TAKEN, "`skygcs-cli mission pause {targets}`"),
    "control.set": AfterEffect(_TAKEN, _HOLD),
    "trajectory.start": AfterEffect(_TAKEN, "`skygcs-cli trajectory abort {targets}`"),
    "vehicles.land": AfterEffect(_CARRIED_ON, "`skygcs-cli hold {targets}`"),
    "vehicles.rtl": AfterEffect(_CARRIED_ON, "`skygcs-cli hold {targets}`"),
    "vehicles.hold": AfterEffect(_CARRIED_ON, "any other order"),
    "vehicles.stop": AfterEffect(_CARRIED_ON + ", for 30 s at most", "any other order"),
    "vehicles.disarm": AfterEffect(_CARRIED_ON, "`skygcs-cli arm {targets}`"),
    "vehicles.calibrate": AfterEffect("the daemon cancels it", "`skygcs-cli calibrate {targets} --cancel`"),
    "vehicles.reboot": AfterEffect(_TAKEN, "nothing: wait until it is heard again (`skygcs-cli status`)"),
    "vehicles.renumber": AfterEffect(_CARRIED_ON, "nothing: `skygcs-cli status` shows its system id"),
    "vehicles.set_home": AfterEffect(_KEPT, "`skygcs-cli home {targets}` sets it again"),
    "vehicles.interval": AfterEffect(_KEPT, "`skygcs-cli interval {targets} MESSAGE default`"),
    "vehicles.stream": AfterEffect(_KEPT, "`skygcs-cli stream {targets} STREAM HZ`"),
    "origin.push": AfterEffect(_KEPT, "`skygcs-cli origin push {targets}` sends it again"),
    "params.set": AfterEffect(_KEPT, "`skygcs-cli param get {targets} NAME …` reads what they hold"),
    "preflight.run": AfterEffect(_KEPT, "`skygcs-cli preflight {targets}` reads what they hold"),
    "fence.set": AfterEffect(_KEPT, "`skygcs-cli fence status {targets}` reads what they hold"),
    "fence.test": AfterEffect("the daemon restores the fence as it was", "`skygcs-cli fence status {targets}`"),
    "undo.run": AfterEffect(_KEPT, "`skygcs-cli undo` lists what is left"),
    "signing.setup": AfterEffect(_KEPT, "`skygcs-cli signing status` shows who has the key"),
    "signing.off": AfterEffect(_KEPT, "`skygcs-cli signing status` shows who has the key"),
    "plan.run": AfterEffect("it may have begun", "`skygcs-cli plan abort`, or `plan land`; `plan status` shows it"),
    "plan.resume": AfterEffect("it may have gone on", "`skygcs-cli plan pause`, or `plan abort`"),
    "plan.pause": AfterEffect("the plan is being paused", "`skygcs-cli plan resume`"),
    "plan.abort": AfterEffect("the plan is being aborted", "`skygcs-cli hold all`"),
    "plan.land": AfterEffect("they are being landed", "`skygcs-cli hold all`"),
}
"""By method. What is not here was a question, whose answer is not needed any more."""


class Unanswered(NamedTuple):
    """A request that was sent and has no answer yet."""

    method: str
    params: Mapping[str, Any]


def interrupted_lines(pending: Sequence[Unanswered]) -> list[str]:
    """Return what is said of each order among the requests."""
    lines = []
    for request in pending:
        after = AFTER.get(request.method)
        if after is None:
            continue
        targets = targets_of(request)
        what = request.method.removeprefix("vehicles.").replace(".", " ")
        lines.append(f"interrupted: {what} {targets}".rstrip() + f" was sent; {after.goes_on}")
        lines.append(f"to end it: {after.ends.format(targets=targets)}")
    return lines


def targets_of(request: Unanswered) -> str:
    """The targets of a request as a person types them; "" without targets."""
    targets = request.params.get("targets", request.params.get("target", ""))
    return ",".join(map(str, targets)) if isinstance(targets, list) else str(targets)


async def explain(pending: Sequence[Unanswered], again: Client) -> None:
    """Print what was interrupted, and how the vehicles are now; ``again``: a new client, as the one of the command is
    closed. To be awaited after a CancelledError; a second Ctrl-C ends it."""
    lines = interrupted_lines(pending)
    if not lines:
        return
    if (task := asyncio.current_task()) is not None:
        task.uncancel()
    for line in lines:
        say(line, err=True)
    targets = next((found for request in pending if (found := targets_of(request))), "")
    if not targets or any(request.method.startswith(("params.", "signing.", "undo.")) for request in pending):
        return
    await asyncio.sleep(SETTLE_S)
    try:
        async with asyncio.timeout(STATES_S), again as gcs:
            states = await gcs.vehicles(targets)
    except (SkygcsError, OSError, TimeoutError) as error:
        say(f"how they are now is not known: {error or 'no answer'}; `skygcs-cli status`", err=True)
        return
    for state in states[:SHOWN]:
        say(f"now: {state_line(state)}", err=True)
    if len(states) > SHOWN:
        say(f"now: {plural(len(states) - SHOWN, 'more vehicle')}; `skygcs-cli status`", err=True)


def state_line(state: Mapping[str, Any]) -> str:
    """ "alpha armed, in the air, AUTO.TAKEOFF, 1.6 m": what a vehicle does now."""
    if not state["connected"]:
        return f"{state['name']} is not heard"
    armed = {True: "armed", False: "disarmed", None: "armed or not is unknown"}[state["armed"]]
    height = fixed((state.get("position") or {}).get("alt_rel_m"), 1, " m")
    landed = str(state.get("landed") or "").replace("_", " ")
    return f"{state['name']} {', '.join(part for part in (armed, landed, state['mode'], height) if part)}"
