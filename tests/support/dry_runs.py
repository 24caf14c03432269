"""Random plans: what the dry run passes is flown undisturbed to its end, and what it refuses says a command that leads
to a flight or to the next true reason."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import random
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from skygcs.core.plan.fleet_plan import PhasedPlan, Plan
from skygcs.core.separation import separation_m
from skygcs.core.trajectory import MotionLimits
from skygcs.errors import SkygcsError
from support.called import plans_of
from support.flown import Flown, aloft
from support.planned import content, inline, instant_planning, phased, plan_events, state, timed

OVER = ("finished", "stopped", "aborted", "landed")
PLANS_OF_ONE = 8
"""Plans flown with one daemon, one after the other."""

LONGEST_S = 400.0
LOOK_S = 0.5
LONGEST_CHAIN = 8
"""Commands that are carried out, one refusal after the other."""

RATIO = 2.0
NEAR_M = 3.0
"""Places of a random plan are mostly this far apart: some are refused for it."""

Vector = tuple[float, float, float]


@dataclass(slots=True)
class Judged:
    """Plans of one daemon."""

    passed: int = 0
    """Dry runs that passed."""
    flown: int = 0
    """Plans flown to their ends, also after what was refused was cleared."""
    refused: int = 0
    led_on: int = 0
    """Refused plans whose commands led to a flight, or to another reason that only a person can clear."""
    faults: list[str] = field(default_factory=list)
    commands: dict[str, int] = field(default_factory=dict)
    """How often each was carried out, by its first words."""

    def __iadd__(self, other: Judged) -> Judged:
        self.passed += other.passed
        self.flown += other.flown
        self.refused += other.refused
        self.led_on += other.led_on
        self.faults += other.faults
        for command, count in other.commands.items():
            self.commands[command] = self.commands.get(command, 0) + count
        return self


class Refusal(NamedTuple):
    """The first reason of a refusal, and the command that clears it."""

    text: str
    command: str


class RandomPlans:
    """Random plans of one fleet."""

    def __init__(self, gcs: Flown, seed: int) -> None:
        self.gcs, self.seed, self.rng = gcs, seed, random.Random(seed)
        self.names = [f"v{sim.sysid}" for sim in gcs.sims]
        self.judged = Judged()
        self.goals: dict[str, Vector] = {}

    async def one(self) -> None:
        """Make one, look at its dry run, and fly it or carry out what its refusal says."""
        plan, params = self._plan(), self._params()
        await self._load(plan)
        refusal = await self._dry_run(params)
        if refusal is None:
            self.judged.passed += 1
            if (refusal := await self._fly(params)) is not None:
                self._fault(f"passed, and then refused: {refusal}")
            return
        self.judged.refused += 1
        await self._led_on(params, refusal)

    async def _dry_run(self, params: dict[str, Any]) -> Refusal | None:
        """Why it is refused; None: it passes."""
        try:
            report = await self.gcs("plan.check", **params)
        except SkygcsError as error:
            return Refusal(str(error), _command(str(error)))
        return None if report["ok"] else _first(report)

    # -- what is made

    def _plan(self) -> Plan:
        rng, here = self.rng, {name: self.gcs.place(name) for name in self.names}
        starts = {name: (x, y, max(up, 5.0)) for name, (x, y, up) in here.items()}
        far_m, top_m = rng.choice([(15.0, 14.0), (30.0, 17.0), (46.0, 17.0), (52.0, 21.0)])
        for _ in range(60):
            self.goals = {
                name: (rng.uniform(-far_m, far_m), rng.uniform(-far_m, far_m), rng.uniform(5.0, top_m))
                for name in self.names
            }
            pairs = itertools.combinations(self.goals.values(), 2)
            if all(separation_m(a[0] - b[0], a[1] - b[1], a[2] - b[2], RATIO) > NEAR_M for a, b in pairs):
                break
        if rng.random() < 0.5:
            speed = rng.choice([0.8, 1.5, 3.0, 6.0])
            limits = MotionLimits(speed, rng.choice([0.5, 1.0, 2.0]), min(speed, 1.5), min(speed, 1.0))
            return timed(starts, self.goals, limits)
        return self._in_phases(starts)

    def _in_phases(self, starts: dict[str, Vector]) -> PhasedPlan:
        """Climb to layers, cross, descend; the layers are sometimes too near each other."""
        gap_m = self.rng.choice([2.0, 5.0, 6.5, 7.0])
        tops = {name: 6.0 + gap_m * i for i, name in enumerate(self.names)}
        return phased(
            starts,
            ("climb", {name: (x, y, tops[name]) for name, (x, y, _) in starts.items()}),
            ("cross", {name: (x, y, tops[name]) for name, (x, y, _) in self.goals.items()}),
            ("descend", dict(self.goals)),
        )

    def _params(self) -> dict[str, Any]:
        rng = self.rng
        return {
            "by": rng.choice(["auto", "auto", "goto", "setpoints"]),
            "mode": rng.choice(["position", "velocity"]),
            "speed": rng.choice([0.4, 1.0, 1.0, 1.5]),
        }

    async def _load(self, plan: Plan) -> None:
        plans_of(self.gcs.daemon).runner.work = inline
        await self.gcs("plan.load", plan=content(plan), name="random")

    # -- what becomes of it

    async def _fly(self, params: dict[str, Any]) -> Refusal | None:
        """Run it, with nobody in its way, to its end. Why it is not flown; None: it was."""
        since = self.gcs.now
        try:
            answer = await self.gcs("plan.run", **params)
        except SkygcsError as error:
            return Refusal(str(error), _command(str(error)))
        if not answer["started"]:
            return _first(answer["report"])
        for _ in range(round(LONGEST_S / LOOK_S)):
            if state(self.gcs) in OVER:
                break
            await asyncio.sleep(LOOK_S)
        if state(self.gcs) == "finished":
            self.judged.flown += 1
            return None
        self._fault(f"passed, and stopped: {params} {plan_events(self.gcs, since)[-2:]}")
        with contextlib.suppress(SkygcsError):
            await self.gcs("plan.abort")
        await asyncio.sleep(15.0)
        return None

    async def _led_on(self, params: dict[str, Any], refusal: Refusal) -> None:
        """Carry out the command of the first refusal, again and again."""
        seen: list[Refusal] = []
        following: Refusal | None = refusal
        for _ in range(LONGEST_CHAIN):
            if following is None:
                break
            if following in seen:
                self._fault(f"its command does not clear it: {following}")
                return
            seen.append(following)
            further = await self._carry_out(following.command, params)
            if further is None:
                break
            following = await self._fly(params := further)
        self.judged.led_on += 1

    async def _carry_out(self, command: str, params: dict[str, Any]) -> dict[str, Any] | None:
        """As a person types it. What is to be run next; None: the command itself says what else is in the way."""
        words = command.removeprefix("skygcs-cli ").split()
        kind = " ".join(words[:2])
        self.judged.commands[kind] = self.judged.commands.get(kind, 0) + 1
        match words:
            case ["plan", "run", "FILE", *options]:
                return params | _options(options)
            case ["plan", "make", "FILE", "--fleet", *options]:
                if not await self._make("--kind" in options, params):
                    return None
                return {key: value for key, value in params.items() if key not in ("speed", "vehicles")}
            case ["hold" | "land" as order, name]:
                await self.gcs(f"vehicles.{order}", targets=name)
                await asyncio.sleep(10.0)
            case ["param", "set", name, param, value]:
                await self.gcs("params.set", targets=name, params={param: float(value)})
            case _:
                raise AssertionError(f"nobody has said how this is carried out: {command}")
        return params

    async def _make(self, in_phases: bool, params: dict[str, Any]) -> bool:
        """A plan between the same places. False: there is none, and `plan make` says why: the places themselves."""
        how = {"kind": "phased"} if in_phases else {}
        goals = {name: list(goal) for name, goal in self.goals.items()}
        found = await self.gcs("plan.make", goals=goals, by=params["by"], **how)
        if found["plan"] is None:
            assert found["reasons"], found
            return False
        await self.gcs("plan.load", plan=found["plan"], name="made")
        return True

    def _fault(self, text: str) -> None:
        self.judged.faults.append(f"seed {self.seed}: {text}"[:600])


def _options(words: list[str]) -> dict[str, Any]:
    """Options of `plan run FILE` as parameters."""
    found: dict[str, Any] = {}
    rest = list(words)
    while rest:
        match rest:
            case ["--speed", value, *rest]:
                found["speed"] = float(value)
            case ["--by", value, *rest]:
                found["by"] = value
            case ["--force", *rest]:
                found["force"] = True
            case ["--set-return-heights", *rest]:
                found["set_return_heights"] = True
            case [targets, *rest]:
                found["vehicles"] = targets
    return found


def _first(report: dict[str, Any]) -> Refusal:
    found = next(finding for finding in report["findings"] if finding["severity"] == "refused")
    return Refusal(f"{found['vehicle']} {found['check']}: {found['text']}", found["command"])


def _command(text: str) -> str:
    """The command that an error names."""
    found = re.search(r"`(skygcs-cli [^`]*)`", text)
    assert found is not None, f"an error without a command: {text}"
    return found.group(1)


async def judge(seed: int, folder: Path, plans: int = PLANS_OF_ONE) -> Judged:
    """Plans of one daemon, with two or three vehicles of both firmwares."""
    rng = random.Random(seed)
    px4, ardupilot = rng.choice([(1, 1), (2, 0), (0, 2), (2, 1), (1, 2)])
    async with aloft(folder, px4=px4, ardupilot=ardupilot) as gcs:
        instant_planning(gcs.daemon)
        run = RandomPlans(gcs, seed)
        for _ in range(plans):
            await run.one()
        return run.judged
