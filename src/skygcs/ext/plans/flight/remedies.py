"""The remedy of each refusal of a flight: the command that clears it, and what a person does before. Pure.

`Finding` takes no refusal without one. In a command FILE is the file of the plan, or of its task. What a command leads
to is a flight, or the next true reason.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from skygcs.spelling import rounded

RUN = "skygcs-cli plan run FILE"
MAKE = "skygcs-cli plan make FILE --fleet -o plan.json"


class Remedy(NamedTuple):
    """``before``: what is done first, as an imperative; empty: nothing."""

    command: str
    before: str = ""

    def text(self, *, insist: bool) -> str:
        """One line for people. ``insist``: force passes the refusal."""
        first = f"{self.before}, then " if self.before else ""
        forced = f"; or insist: `{RUN} --force`" if insist and "--force" not in self.command else ""
        return f"{first}`{self.command}`{forced}"


def again(before: str) -> Remedy:
    """Nothing but what a person does helps."""
    return Remedy(RUN, before)


def insist(before: str) -> Remedy:
    """Return what is not known, or not measured, can be insisted on."""
    return Remedy(f"{RUN} --force", before)


def leave_out(name: str, names: list[str]) -> Remedy:
    """Fly it with the others, of which the one that stays is an obstacle."""
    others = [other for other in names if other != name]
    if not others:
        return Remedy(f"skygcs-cli status {name}", "it is the only one: mend it first")
    return Remedy(f"{RUN} {','.join(others)}", "leave it out")


def hold(name: str) -> Remedy:
    return Remedy(f"skygcs-cli hold {name}")


def land(name: str) -> Remedy:
    return Remedy(f"skygcs-cli land {name}")


def forget(name: str) -> Remedy:
    return Remedy(f"skygcs-cli forget {name} --force", "once you know that it is not there")


def preflight(name: str) -> Remedy:
    return Remedy(f"skygcs-cli preflight {name}", "do what it says")


def bring_up(name: str) -> Remedy:
    """The companion of a vehicle, up to its service."""
    return Remedy(f"skygcs-cli up {name}")


def by_goto() -> Remedy:
    return Remedy(f"{RUN} --by goto")


def by_setpoints() -> Remedy:
    return Remedy(f"{RUN} --by setpoints")


def make_phased() -> Remedy:
    """A plan in phases between the same places, which is flown by goto."""
    return Remedy("skygcs-cli plan make FILE --fleet --kind phased -o phased.json")


def make_again(before: str = "") -> Remedy:
    """A plan between the same places from where the vehicles are, within what the fleet file allows."""
    return Remedy(MAKE, before)


def slower(factor: float) -> Remedy:
    return Remedy(f"{RUN} --speed {factor:.2g}")


def set_return_heights() -> Remedy:
    return Remedy(f"{RUN} --set-return-heights")


def set_parameter(name: str, param: str, value: float) -> Remedy:
    return Remedy(f"skygcs-cli param set {name} {param} {rounded(value)}")


def widen_fence(name: str, radius_m: float | None, height_m: float | None) -> Remedy:
    """The autopilot's own fence with so much room; None: it has enough of that."""
    options = "".join(
        f" {option} {math.ceil(value)}"
        for option, value in (("--radius", radius_m), ("--height", height_m))
        if value is not None
    )
    if not options:
        return Remedy(f"skygcs-cli mission download {name} own.plan", "look at its polygons and circles")
    return Remedy(f"skygcs-cli fence set {name}{options}")
