"""The tables of moving references in `make bench-control`, each with its limits and what missed them."""

from __future__ import annotations

from collections.abc import Iterator
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
    rounded_square,
    sharp_square,
    track,
)

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


def moving_sections() -> Iterator[Section]:
    """In the order of docs/developers/control-figures.md."""
    yield modes()
    yield paths()
    yield wrong_delay()


def modes() -> Section:
    """The circle in each control mode over each delay."""
    title = "circle of 5 m at 2 m/s, wind 5 m/s, gusts 1 m/s: RMS and most off, m, by delay there and back"
    section = Section("circle", title, ("flown by", "autopilot", *(f"{d:g} s" for d in DELAYS_S), "limit"))
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
    for autopilot in ("px4", "ardupilot"):
        cases = [Case("velocity", 0.8, PREDICTED, autopilot=autopilot, delay_error=e) for e in (-WRONG, 0.0, WRONG)]
        _row(section, "velocity, predicted", cases, circle, STABLE_M)
    return section


def _row(section: Section, name: str, cases: list[Case], path: Path3, limit: float | None) -> None:
    """One flight a cell."""
    cells = []
    for case in cases:
        found = track(case, path)
        cells.append(_cell(found, case))
        what = f"{name}, {case.autopilot}, {case.delay_s:g} s"
        if case.delay_error:
            what += f", in truth {case.delay_s * (1 + case.delay_error):g} s"
        section.judge(what, found.rms_m, limit)
        if limit is not None and found.control_mode != case.mode:
            section.missed.append(f"{what}: flown by {found.control_mode} at the end")
    section.rows.append((name, cases[0].autopilot, *cells, "" if limit is None else f"{limit:g}"))


def _cell(found: Tracked, case: Case) -> str:
    instead = "" if found.control_mode == case.mode else f" ({found.control_mode})"
    return f"{found.rms_m:.2f}, {found.most_m:.2f}{instead}"
