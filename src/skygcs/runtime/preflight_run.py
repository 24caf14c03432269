"""Preflight of one vehicle: requests the data of the checks, evaluates them by `core.preflight`, sets parameters.

It also guards the arming: with ``require_preflight`` an arming is refused unless the vehicle has passed preflight since
it started, and recently.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from skygcs.config.control import POSITION_HZ, VELOCITY_HZ
from skygcs.config.models import VehicleConfig
from skygcs.core.params.expectations import Expectations
from skygcs.core.params.names import turns_on
from skygcs.core.preflight.health import FRESH_S
from skygcs.core.preflight.report import (
    Answer,
    Finding,
    Fix,
    PreflightFacts,
    PreflightReport,
    ReturnSetting,
    Severity,
    failed,
    offered_heights,
    passed,
)
from skygcs.core.preflight.settings import return_height
from skygcs.core.preflight.table import examine, needed_messages, needed_params
from skygcs.core.protocols.parameter import ParamOutcome
from skygcs.core.separation import Footprint, pair_margin
from skygcs.core.vehicle import targets
from skygcs.core.vehicle.flight_evidence import why_not_idle
from skygcs.core.vehicle.origin import off_m
from skygcs.core.vehicle.snapshot import take_snapshot
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.core.vehicle.vehicle_model import sticks_of
from skygcs.runtime.fleet import Fleet, Unheard
from skygcs.runtime.param_metadata import VehicleMetadata
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.runtime.vehicle_services import VehiclePart
from skygcs.spelling import rounded

AT_ONCE = 8
"""Parameters of one vehicle requested at the same time: 8 x 45 B are 65 ms of 57600 baud; a missing one takes 7 s."""

VEHICLES_AT_ONCE = 3
"""Vehicles examined at the same time: their requests, some fifteen each, share a radio."""

REQUESTS = 2
"""Requests for a message that was promised and did not come. A radio that loses 2 % loses one of four vehicles'
messages in every fourth preflight."""

SETTLE_S = 3.0
"""Time until the vehicle's telemetry reflects a set parameter: it evaluates its arming checks once a second, and
SYS_STATUS comes every two seconds."""

Confirmed = Mapping[str, float] | None


@dataclass(frozen=True, slots=True)
class Examined:
    """A report, its time (the loop's clock), the parameters set before it, and why others were not set."""

    report: PreflightReport
    at: float
    fixed: Mapping[str, ParamOutcome]
    unfixed: str = ""
    return_height: ReturnSetting | None = None


class Preflight(VehiclePart):
    """Findings about one vehicle since it started, and whether it may be armed."""

    def __init__(self, actor: VehicleActor) -> None:
        services = actor.services
        actor.preflight_refusal = self.refusal
        self.last: Examined | None = None
        """The last report since the vehicle started; a reboot clears it."""
        # collaborators
        self.vehicle = actor.vehicle
        self._actor = actor
        self._config = actor.config
        self._params = actor.params
        self._metadata = actor.part(VehicleMetadata)
        self._services = services
        self._dialect = services.dialect
        self._loop = services.loop
        self._valid_s = services.preflight_valid_s
        self.wall_clock: Callable[[], float] = time.time
        """The time of day in Unix seconds, with which the vehicle's clock is compared."""
        self._pose_problem: Callable[[float], str | None] | None = None
        # runs, and parameters that the vehicle does not have
        self._lock = asyncio.Lock()
        self._lives = 0
        self._absent: set[str] = set()
        """Names of parameters that it does not have, except required ones, which may appear after a change of
        settings."""
        self._expectations = _expectations(self._config)

    @property
    def footprint(self) -> Footprint:
        """The space that the vehicle needs."""
        return self._config.separation.footprint()

    def fly_by_poses(self, problem: Callable[[float], str | None]) -> None:
        """Expect poses of motion capture instead of GPS from now on. ``problem(now)``: why it cannot fly by them."""
        self._pose_problem = problem
        self._expectations = replace(
            self._expectations, mocap=True, gps_fix_min="no_gps", satellites_min=0, hdop_max=0.0
        )

    async def run(self, *, fix: bool = False, confirmed: Confirmed = None) -> Examined:
        """Examine it. With ``fix`` set the parameters that correct a finding, and examine it again.

        ``confirmed``: set only these, and only to these values, because the user has confirmed them.
        """
        async with self._lock:
            examined = await self._examine({}, "")
            fixes = _agreed(examined.report.fixes, confirmed) if fix else ()
            if not fixes:
                return examined
            if (why := why_not_idle(self.vehicle, self._loop.time())) is not None:
                return await self._examine({}, f"{why}: no parameters are changed then")
            fixed = await self._params.set({f.name: f.value for f in fixes})
            await asyncio.sleep(SETTLE_S)
            return await self._examine(fixed, "")

    def on_reboot(self) -> None:
        """The findings are void."""
        self._lives += 1
        self._absent.clear()
        self.last = None

    def refusal(self) -> str | None:
        """Why it must not be armed, if it has to have passed; None if it may. No request is sent."""
        state, how = self.state(), self._actor.preflight_hint
        if state == "passed":
            return None
        if self.last is None:
            return self._actor.never_passed()
        if state == "expired":
            ago_min, limit_min = (self._loop.time() - self.last.at) / 60, self._valid_s / 60
            return f"its preflight was passed {ago_min:.0f} min ago (valid for {limit_min:g} min); {how}"
        return f"preflight failed: {self.last.report.summary()}; correct that and {how}"

    def state(self) -> str:
        """never, failed, passed or expired."""
        if self.last is None:
            return "never"
        if not self.last.report.ok:
            return "failed"
        return "passed" if self._loop.time() - self.last.at <= self._valid_s else "expired"

    def status(self) -> dict[str, Any]:
        """JSON-able: the last report since the vehicle's start, and whether it permits arming."""
        last = self.last
        age_s = None if last is None else self._loop.time() - last.at
        return {
            "state": self.state(),
            "required": self._config.require_preflight,
            "age_s": None if age_s is None else round(age_s, 1),
            "valid_s": None if age_s is None or self.state() != "passed" else round(self._valid_s - age_s, 1),
            "refusal": self._actor.arming_refusal(force=False),
            "report": None if last is None else result(last, self.vehicle),
        }

    async def _examine(self, fixed: Mapping[str, ParamOutcome], unfixed: str) -> Examined:
        """Examine it; the report counts only if the vehicle has not rebooted meanwhile."""
        life = self._lives
        wanted = self._expectations
        asked: dict[str, Answer] = {}
        if self._facts({}).able:
            asked = await self._ask_params(wanted)
            await self._ask_messages()
        facts = self._facts(asked)
        height = return_height(facts)
        returns = None if height is None else ReturnSetting(*height)
        examined = Examined(examine(facts, wanted), self._loop.time(), fixed, unfixed, returns)
        if life == self._lives:
            self.last = examined
        return examined

    def _facts(self, answers: Mapping[str, Answer]) -> PreflightFacts:
        known = {a.param.name: a.param for a in answers.values() if a.param is not None}
        if self.vehicle.family == "px4":  # an ArduCopter has a value outside a recommended range from the beginning
            known = dict(self._params.known()) | known
        return PreflightFacts(
            state=dict(take_snapshot(self.vehicle, self._loop.time(), self.wall_clock())),
            gcs_sysid=None if self._services.own[0] == self.vehicle.sysid else self._services.own[0],
            configured=self._actor.configured,
            expected_autopilot=self._config.autopilot,
            links=self._services.links.facts(self.vehicle.key, self._loop.time()),
            answers=answers,
            copter=self.vehicle.abilities.setpoints,
            abilities=self.vehicle.abilities,
            sticks=sticks_of(self.vehicle, self._loop.time()),
            outside=self._metadata.outside(known.values()) if answers else None,
            judged=len(known),
            pose_problem=None if self._pose_problem is None else self._pose_problem(self._loop.time()),
            origin_off_m=None if self.vehicle.origin is None else off_m(self.vehicle, self.vehicle.origin),
            dropped=self.vehicle.dropped,
        )

    async def _ask_params(self, wanted: Expectations) -> dict[str, Answer]:
        """Read the needed parameters, by their requested names, several at a time. Values that PX4 confirms by its hash
        are not read again."""
        answers: dict[str, Answer] = {}
        known = await self._params.vouched()
        slots = asyncio.Semaphore(AT_ONCE)

        async def ask(names: tuple[str, ...]) -> None:
            async with slots:
                for name in names:
                    if name in known:
                        answers[name] = Answer(known[name])
                    elif name in self._absent:
                        answers[name] = Answer(absent=True)
                    else:
                        answers[name] = _answer(await self._params.get(name))
                    if not answers[name].absent:
                        return
                    if name not in wanted.params or wanted.params[name].optional:
                        self._absent.add(name)

        async with asyncio.TaskGroup() as group:
            for names in needed_params(self.vehicle.family, wanted, self.vehicle.abilities):
                group.create_task(ask(names), name=f"preflight of {self.vehicle.name}: {names[0]}")
        return answers

    async def _ask_messages(self) -> None:
        """Request the messages that have not come lately, one after another; the check reports a missing one."""
        for message in needed_messages(self.vehicle.family):
            slot = self.vehicle.slot(message) if message in self._dialect.by_name else None
            if message in self._dialect.by_name and (slot is None or self._loop.time() - slot.at > FRESH_S):
                if self._unneeded(message):
                    continue
                for _ in range(REQUESTS):
                    if (await self._actor.request(message)).result != "timeout":
                        break

    def _unneeded(self, message: str) -> bool:
        """True if the message's data is known: a battery's charge is in SYS_STATUS, too; the version does not
        change."""
        vehicle = self.vehicle
        if message == "BATTERY_STATUS":
            battery = vehicle.telemetry("battery")
            return battery is not None and battery["percent"] is not None
        if message == "AUTOPILOT_VERSION":
            return vehicle.firmware is not None
        return False


async def examine_fleet(
    fleet: Fleet,
    expression: str | int | Sequence[str | int],
    *,
    fix: bool = False,
    confirmed: Mapping[str, Mapping[str, float]] | None = None,
) -> dict[str, Any]:
    """See `examine_all`; with the vehicles of the fleet file that are not heard. Raises TargetError."""
    everything: list[VehicleActor | Unheard] = [*fleet.vehicles.values(), *fleet.unheard()]
    found = targets.select(expression, everything)
    vehicles = {v.name: v if isinstance(v, Unheard) else v.part(Preflight) for v in found}
    return await examine_all(vehicles, fix=fix, confirmed=confirmed)


async def examine_all(
    vehicles: Mapping[str, Preflight | Unheard],
    *,
    fix: bool = False,
    confirmed: Mapping[str, Mapping[str, float]] | None = None,
) -> dict[str, Any]:
    """JSON-able, by vehicle name; see `Preflight.run`. ``confirmed``: by vehicle name, then by parameter name."""
    slots = asyncio.Semaphore(VEHICLES_AT_ONCE)

    async def one(name: str, vehicle: Preflight | Unheard) -> dict[str, Any]:
        if isinstance(vehicle, Unheard):
            return _unheard_result(vehicle)
        agreed = None if confirmed is None else confirmed.get(name, {})
        async with slots:
            return result(await vehicle.run(fix=fix, confirmed=agreed), vehicle.vehicle)

    async with asyncio.TaskGroup() as group:
        tasks = {n: group.create_task(one(n, v), name=f"preflight of {n}") for n, v in vehicles.items()}
    reports = {name: task.result() for name, task in tasks.items()}
    for name, finding in _return_together(vehicles).items():
        reports[name]["findings"].append(finding.as_dict())
    return reports


def _return_together(vehicles: Mapping[str, Preflight | Unheard]) -> dict[str, Finding]:
    """Findings about vehicles whose return heights are nearer to each other than their margin: that they would return
    one after another, and what brings them home at once. It keeps none of them on the ground."""
    seen = {name: v for name, v in vehicles.items() if isinstance(v, Preflight) and v.last is not None}
    heights = {name: None if v.last is None else v.last.return_height for name, v in seen.items()}
    known = {name: height for name, height in heights.items() if height is not None}
    if len(known) < 2:
        return {}
    margins = [pair_margin(v.footprint, v.footprint) for v in seen.values()]
    apart_m = max(margin.total_m * margin.downwash_ratio for margin in margins)
    found = {}
    for name, wanted_m in offered_heights(known, apart_m).items():
        param, per_metre, height_m = known[name]
        if wanted_m == height_m:
            continue
        text = f"returns at {rounded(height_m)} m, less than {rounded(apart_m)} m from another: where their ways "
        text += "conflict they return one after another; all at once with "
        text += f"{param} {wanted_m * per_metre:g} ({wanted_m:g} m)"
        found[name] = passed(text).named("return heights", Severity.NOTE)
    return found


def _unheard_result(vehicle: Unheard) -> dict[str, Any]:
    text = "it is in the fleet file and has not been heard"
    todo = "switch it on; check its radio and the link; or remove it from the file"
    finding = failed(text, todo).named("link", Severity.FAULT)
    report = PreflightReport((finding,))
    return {"sysid": vehicle.sysid, "autopilot": "", "in_air": None, **report.as_dict(), "fixed": {}, "unfixed": ""}


def result(examined: Examined, vehicle: Vehicle) -> dict[str, Any]:
    """JSON-able: the report, and the parameters set before it."""
    return {
        "sysid": vehicle.sysid,
        "autopilot": vehicle.family,
        "in_air": vehicle.in_air(examined.at),
        **examined.report.as_dict(),
        "fixed": {name: outcome.as_dict() for name, outcome in examined.fixed.items()},
        "unfixed": examined.unfixed,
    }


def _expectations(config: VehicleConfig) -> Expectations:
    control = config.control
    slowest_hz = min(control.velocity_hz or VELOCITY_HZ, control.position_hz or POSITION_HZ)
    wanted = config.preflight.expectations(control=config.control_planned, setpoint_hz=slowest_hz)
    return replace(wanted, delegated=config.delegated)


def _answer(outcome: ParamOutcome) -> Answer:
    return Answer(outcome.param if outcome.ok else None, outcome.result == "unknown", outcome.message)


def _agreed(fixes: tuple[Fix, ...], confirmed: Confirmed) -> tuple[Fix, ...]:
    """The parameters in the order in which a vehicle shows them: switches of features first."""
    agreed = [f for f in fixes if confirmed is None or confirmed.get(f.name) == f.value]
    return tuple(sorted(agreed, key=lambda f: not (turns_on(f.name) and f.value)))
