"""The tables of moving references in `make bench-control`, each with its limits and what missed them."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.control.figures import Section
from bench.control.moving import (
    BEAR_ALL,
    WIDE,
    Case,
    Path3,
    Tracked,
    circle,
    figure_of_eight,
    in_virtual_time,
    lose,
    rounded_square,
    sharp_square,
    track,
)
from skygcs.sim.conditions import CALM, Conditions
from support.flown import flown

DELAYS_S = (0.05, 0.2, 0.4, 0.8)
"""There and back."""

CIRCLE_M, SQUARE_M = 0.35, 0.5
"""RMS: the limits of the issue."""

WRONG = 0.3
"""Share of the delay by which it is wrong, either way: it has to stay stable, which is less than this off."""
STABLE_M = 1.0

LOSS = 0.1
POSITION = {"fence": WIDE, "position_hz": 5.0}
PREDICTED = {"fence": WIDE, "velocity_predictor": True}

OVERSHOOT_M = 0.1
FALL_S = 0.7
RECOVERY_RATIO = 1.1
ENTRY_M, ENTRY_UP_M = 0.25, 0.1


def moving_sections() -> Iterator[Section]:
    """In the order of docs/developers/control-figures.md."""
    yield modes()
    yield paths()
    yield wrong_delay()
    yield climb()
    yield uplink_step()
    yield loss()
    yield rates()
    yield entry()


def modes() -> Section:
    """The circle in each control mode over each delay."""
    title = "circle of 5 m at 2 m/s, wind 5 m/s, gusts 1 m/s: RMS and most off, m, by delay there and back"
    section = Section("circle", title, ("flown by", "autopilot", *(f"{d:g} s" for d in DELAYS_S), "limit"))
    section.data = []
    rows: tuple[tuple[str, str, dict[str, Any], float | None], ...] = (
        ("attitude", "attitude", BEAR_ALL, None),
        ("velocity", "velocity", BEAR_ALL, None),
        ("velocity, predicted", "velocity", PREDICTED, CIRCLE_M),
        ("position", "position", POSITION, CIRCLE_M),
    )
    for name, mode, control, limit in rows:
        for autopilot in ("px4", "ardupilot"):
            _row(section, name, [Case(mode, d, control, autopilot=autopilot) for d in DELAYS_S], circle, limit)
    places = [Case("position", d, POSITION, feed_forward=False) for d in DELAYS_S]
    _row(section, "position, places alone", places, circle, None)
    return section


def paths() -> Section:
    """Position control by 5 setpoints and 2 states a second with a tenth of the packets lost."""
    title = "position, 5 setpoints and 2 positions a second, 10 % of all packets lost: RMS and most off, m"
    section = Section("paths", title, ("path", "autopilot", *(f"{d:g} s" for d in DELAYS_S), "limit"))
    section.data = []
    flown_paths: tuple[tuple[str, Path3, float | None], ...] = (
        ("circle", circle, CIRCLE_M),
        ("figure of eight", figure_of_eight, CIRCLE_M),
        ("square, corners of 4 m", rounded_square, SQUARE_M),
        ("square, corners of 2.5 m", sharp_square, None),
    )
    for name, path, limit in flown_paths:
        for autopilot in ("px4", "ardupilot"):
            cases = [Case("position", d, POSITION, autopilot=autopilot, loss=LOSS) for d in DELAYS_S]
            _row(section, name, cases, path, limit)
    return section


def wrong_delay() -> Section:
    """Prediction with a delay that is not the measured one."""
    title = "circle by velocity with prediction over a measured delay of 0.8 s: RMS and most off, m"
    section = Section("wrong_delay", title, ("flown by", "autopilot", "0.56 s", "0.8 s", "1.04 s", "limit"))
    section.data = []
    for autopilot in ("px4", "ardupilot"):
        cases = [Case("velocity", 0.8, PREDICTED, autopilot=autopilot, delay_error=e) for e in (-WRONG, 0.0, WRONG)]
        _row(section, "velocity, predicted", cases, circle, STABLE_M)
    return section


def climb() -> Section:
    """East by a velocity, up by a place 3 m higher, flown by position control over 2 s of delay."""
    title = "place 3 m higher with 1 m/s to the east (mixed), by position over 2 s there and back: overshoot, m"
    section = Section("climb", title, ("autopilot", "overshoot", "at the end", "limit"))
    section.data = []
    for autopilot in ("px4", "ardupilot"):
        over_m, off_m = in_virtual_time(lambda folder, kind=autopilot: _climb(folder, kind))
        _verdict(section, f"climb, {autopilot}: overshoot", over_m, OVERSHOOT_M)
        section.rows.append((autopilot, f"{over_m:.3f}", f"{off_m:.3f} off", f"{OVERSHOOT_M:g}"))
        section.data[-1]["off_at_end_m"] = round(off_m, 4)
    return section


def uplink_step() -> Section:
    """Attitude is flown when the way up gets 0.575 s slower, at ten phases of the pings."""
    title = "the way up goes from 0.01 to 0.585 s while attitude is flown: until it is given up, s"
    section = Section("uplink_step", title, ("moments", "fall after, s", "limit"))
    section.data = []
    falls_s = []
    for n in range(10):
        phase_s = 0.02 * n  # of the 0.2 s between two pings
        fall_s = in_virtual_time(lambda folder, phase_s=phase_s: _uplink_step(folder, phase_s))
        _verdict(section, f"uplink step at phase {phase_s:.2f} s", fall_s, FALL_S)
        falls_s.append(fall_s)
    section.rows.append((str(len(falls_s)), f"{min(falls_s):.2f} to {max(falls_s):.2f}", f"{FALL_S:g}"))
    return section


def loss() -> Section:
    """Attitude for ten minutes with every twentieth packet lost each way."""
    title = "attitude for 600 s with 5 % of all packets lost: how often the guard changed the control mode"
    section = Section("loss", title, ("lost", "seconds", "changes", "limit"))
    section.data = []
    changes = in_virtual_time(_changes)
    _verdict(section, "changes of the control mode", changes, 0)
    section.rows.append(("5 %", "600", str(changes), "0"))
    return section


def rates() -> Section:
    """Attitude in 5 m/s of wind that begins at once, at 50 Hz and at the 20 that a link leaves."""
    title = "wind of 5 m/s begins while attitude holds: back within 0.1 m for good after, s"
    section = Section("rates", title, ("setpoints per second", "back after", "most off, m", "limit"))
    section.data = []
    found = {}
    for hz in (50.0, 20.0):
        found[hz], most_m = in_virtual_time(lambda folder, rate_hz=hz: _recovery(folder, rate_hz))
        limit = RECOVERY_RATIO * found[50.0]
        _verdict(section, f"recovery at {hz:g} Hz", found[hz], limit)
        section.rows.append((f"{hz:g}", f"{found[hz]:.1f}", f"{most_m:.2f}", "" if hz == 50.0 else f"{limit:.1f}"))
    return section


def entry() -> Section:
    """The vehicle hovers in wind under its own control; attitude is entered."""
    title = "attitude is entered: how far it moves within 15 s, m"
    section = Section("entry", title, ("autopilot", "wind m/s", "hover thrust wrong by", "across", "up", "limits"))
    section.data = []
    for autopilot in ("px4", "ardupilot"):
        for wind_mps, wrong in ((5.0, 1.0), (0.0, 1.25), (0.0, 0.8)):
            across_m, up_m = in_virtual_time(
                lambda folder, kind=autopilot, w=wind_mps, factor=wrong: _entry(folder, kind, w, factor)
            )
            what = f"entry, {autopilot}, wind {wind_mps:g} m/s, hover thrust x {wrong:g}"
            _verdict(section, f"{what}: across", across_m, ENTRY_M)
            _verdict(section, f"{what}: up", up_m, ENTRY_UP_M)
            cells = (autopilot, f"{wind_mps:g}", f"x {wrong:g}", f"{across_m:.2f}", f"{up_m:.2f}")
            section.rows.append((*cells, f"{ENTRY_M:g} / {ENTRY_UP_M:g}"))
    return section


# -- flights


async def _climb(folder: Path, autopilot: str) -> tuple[float, float]:
    kind = {"px4": int(autopilot == "px4"), "ardupilot": int(autopilot == "ardupilot")}
    air = {"type": "memory", "role": "radio", "delay_s": 1.0}
    async with flown(folder, control={"fence": WIDE}, links={"air": air}, **kind) as gcs:
        await gcs.done("control.set", mode="position")
        await asyncio.sleep(5.0)
        goal_m, began = gcs.place()[2] + 3.0, gcs.now
        while gcs.now < began + 30.0:
            await gcs.done(
                "control.setpoint", vel_enu_mps=[1.0, 0.0, None], pos_enu_m=[None, None, goal_m], valid_s=1.0
            )
            await asyncio.sleep(0.1)
        ups = [look.pos_m[2] for look in gcs.truth[1] if look.at >= began]
        return max(0.0, max(ups) - goal_m), abs(ups[-1] - goal_m)


async def _uplink_step(folder: Path, phase_s: float) -> float:
    air = {"type": "memory", "role": "radio", "delay_s": 0.01}
    async with flown(folder, control={"fence": WIDE}, links={"air": air}) as gcs:
        await gcs.fly("attitude")
        await asyncio.sleep(10.0 + phase_s)
        outward = gcs.link.outward
        began = gcs.now
        outward._config = outward._config.model_copy(update={"delay_s": 0.585})
        try:
            return await gcs.until(lambda: gcs.control()["control_mode"] != "attitude", 10.0) - began
        except AssertionError:
            return math.inf


async def _changes(folder: Path) -> int:
    air = {"type": "memory", "role": "radio", "delay_s": 0.01}
    async with flown(folder, control={"fence": WIDE}, links={"air": air}) as gcs:
        await gcs.fly("attitude")
        lose(gcs, 0.05)
        began = gcs.now
        await asyncio.sleep(600.0)
        lose(gcs, 0.0)
        return len(gcs.texts(began))


async def _recovery(folder: Path, rate_hz: float) -> tuple[float, float]:
    control = {"fence": WIDE, "rate_min_hz": 10.0}
    air = {"type": "memory", "role": "radio", "delay_s": 0.005}
    async with flown(folder, control=control, links={"air": air}) as gcs:
        await gcs.fly("attitude")
        engagement = gcs.actor().offboard
        refresh = engagement.refresh_budget

        def leave_less() -> None:
            refresh()
            engagement.controller.attitude_hz_allowed = min(engagement.controller.attitude_hz_allowed, rate_hz)

        engagement.refresh_budget = leave_less  # type: ignore[method-assign]
        leave_less()
        await asyncio.sleep(10.0)
        assert abs(gcs.control()["rate_hz"] - rate_hz) < 1.0, gcs.control()
        start, began = gcs.place(), gcs.now
        gcs.sim().motion.wind.mean_enu_mps = (5.0, 0.0, 0.0)
        await asyncio.sleep(40.0)
        off = [(look.at - began, math.dist(look.pos_m, start)) for look in gcs.truth[1] if look.at >= began]
        away = [at for at, off_m in off if off_m > 0.1]
        return (away[-1] if away else 0.0), max(off_m for _, off_m in off)


async def _entry(folder: Path, autopilot: str, wind_mps: float, wrong: float) -> tuple[float, float]:
    kind = {"px4": int(autopilot == "px4"), "ardupilot": int(autopilot == "ardupilot")}
    air = {"type": "memory", "role": "radio", "delay_s": 0.01}
    conditions = Conditions(wind_enu_mps=(wind_mps, 0.0, 0.0)) if wind_mps else CALM
    # the battery of one that has just taken off gives 1.11 of the nominal thrust
    control = {"fence": WIDE, "hover_thrust": round(0.45 / 1.11 * wrong, 3)}
    async with flown(folder, control=control, conditions=conditions, links={"air": air}, **kind) as gcs:
        await asyncio.sleep(15.0)
        start, began = gcs.place(), gcs.now
        await gcs.fly("attitude")
        await asyncio.sleep(15.0)
        looks = [look.pos_m for look in gcs.truth[1] if look.at >= began]
        across_m = max(math.dist(start[:2], here[:2]) for here in looks)
        return across_m, max(abs(here[2] - start[2]) for here in looks)


# -- rows


def _row(section: Section, name: str, cases: list[Case], path: Path3, limit: float | None) -> None:
    """One flight a cell."""
    cells = []
    for case in cases:
        found = track(case, path)
        cells.append(_cell(found, case))
        what = f"{name}, {case.autopilot}, {case.delay_s:g} s"
        if case.delay_error:
            what += f", in truth {case.delay_s * (1 + case.delay_error):g} s"
        _verdict(section, what, found.rms_m, limit)
        section.data[-1] |= {"most_m": round(found.most_m, 3), "control_mode": found.control_mode}
        if limit is not None and found.control_mode != case.mode:
            section.missed.append(f"{what}: flown by {found.control_mode} at the end")
    section.rows.append((name, cases[0].autopilot, *cells, "" if limit is None else f"{limit:g}"))


def _cell(found: Tracked, case: Case) -> str:
    instead = "" if found.control_mode == case.mode else f" ({found.control_mode})"
    return f"{found.rms_m:.2f}, {found.most_m:.2f}{instead}"


def _verdict(section: Section, what: str, value: float, limit: float | None) -> None:
    """Into the data, and to what was missed."""
    met = None if limit is None else value <= limit
    shown = round(value, 4) if math.isfinite(value) else None
    section.data.append({"what": what, "value": shown, "limit": limit, "met": met})
    if met is False:
        section.missed.append(f"{section.key}: {what}: {value:.3f}, wanted at most {limit:g}")
