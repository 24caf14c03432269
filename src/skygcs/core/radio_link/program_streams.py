"""Streams that other programs asked a vehicle to stream, and what to put back when the last of them is gone.

A stream belongs to the vehicle's port, not to the program that asked for it: MAVProxy asks an ArduPilot for all of its
streams at 4 Hz, and 3.8 kB/s go on after it has left. So what the vehicle streamed before the first request is
noted. While any program that asked for a stream is connected, nothing of that stream is touched.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from skygcs.core.radio_link.stream_rates import ARDUPILOT_GROUPS

Program = tuple[int, int]
"""Channel id and sysid << 8 | compid."""

MOST_ITEMS = 64
"""Streams of one vehicle that are noted. QGroundControl and MAVProxy ask for ten groups at most."""

MOST_PROGRAMS = 16
"""Programs noted for one stream."""

ALL_GROUPS = 0

SAME = 1.5
"""A stream is as it was if it comes no more than so much faster or slower: radios lose, firmwares round."""

ABOUT_HZ = 0.2
"""Below this a difference of rates is no stream: a message that was requested once."""


class Stream(NamedTuple):
    """Stream that a program asked for: a group of ArduPilot (``message`` None), or one message (``group`` None)."""

    group: int | None
    message: str | None


@dataclass(slots=True)
class _Requests:
    """The requests to one vehicle."""

    before_hz: Mapping[str, float]
    programs: dict[Stream, set[Program]] = field(default_factory=dict)


class Leftover(NamedTuple):
    """A stream that nobody connected has asked for, and what every message came at before anybody asked."""

    stream: Stream
    before_hz: Mapping[str, float]


class ProgramStreams:
    """`on_request` with every request that passes, `left_behind` once a second. Vehicles by sysid << 8 | compid."""

    def __init__(self) -> None:
        self._vehicles: dict[int, _Requests] = {}
        self.not_counted = 0
        """Requests beyond MOST_ITEMS and MOST_PROGRAMS."""

    def on_request(
        self, vehicle: int, program: Program, stream: Stream, rates_hz: Callable[[], Mapping[str, float]]
    ) -> None:
        """``rates_hz()``: what the vehicle sends now; asked for if nobody else has requested anything yet."""
        requests = self._vehicles.get(vehicle)
        if requests is None:
            requests = self._vehicles[vehicle] = _Requests({n: hz for n, hz in rates_hz().items() if hz > 0})
        for one in _groups(stream):
            programs = requests.programs.get(one)
            if programs is None and len(requests.programs) < MOST_ITEMS:
                programs = requests.programs[one] = set()
            if programs is None or (program not in programs and len(programs) >= MOST_PROGRAMS):
                self.not_counted += 1
            else:
                programs.add(program)

    def left_behind(self, is_connected: Callable[[Program], bool]) -> dict[int, list[Leftover]]:
        """Return what the programs that are gone have left, each stream once, by vehicle."""
        left: dict[int, list[Leftover]] = {}
        for vehicle, requests in list(self._vehicles.items()):
            for stream, programs in list(requests.programs.items()):
                programs -= {program for program in programs if not is_connected(program)}
                if not programs:
                    del requests.programs[stream]
                    left.setdefault(vehicle, []).append(Leftover(stream, requests.before_hz))
            if not requests.programs:
                del self._vehicles[vehicle]
        return left

    def forget(self, vehicle: int) -> None:
        """It rebooted, and knows of no request any more; or it is gone."""
        self._vehicles.pop(vehicle, None)


def _groups(stream: Stream) -> list[Stream]:
    return [Stream(group, None) for group in ARDUPILOT_GROUPS] if stream.group == ALL_GROUPS else [stream]


class StreamRequest(NamedTuple):
    """Request sent to put a stream back: a group (REQUEST_DATA_STREAM; 0 Hz stops it) or a message
    (SET_MESSAGE_INTERVAL; None is the vehicle's own default)."""

    stream: Stream
    rate_hz: float | None


def restoring(leftover: Leftover, rates_hz: Mapping[str, float], wanted_hz: Mapping[str, float]) -> list[StreamRequest]:
    """Return what to ask for so that it is as before; [] if it is. ``rates_hz``: what comes now; ``wanted_hz``: what
    skygcs itself asks for, which is no part of a group's rate, and is asked for again where a group's change ends
    it."""
    group, message = leftover.stream
    before_hz = leftover.before_hz
    if message is not None:
        own_hz = _own_rate(message, before_hz, wanted_hz)
        if _is_same(rates_hz.get(message, 0.0), before_hz.get(message, 0.0), own_hz):
            return []
        return [StreamRequest(leftover.stream, own_hz)]
    if group is None or group not in ARDUPILOT_GROUPS:
        return []
    names = ARDUPILOT_GROUPS[group]
    own = {name: hz for name in names if (hz := _own_rate(name, before_hz, wanted_hz)) is not None}
    if all(_is_same(rates_hz.get(n, 0.0), before_hz.get(n, 0.0), own.get(n)) for n in names):
        return []
    came = {n: before_hz[n] for n in names if n not in own and before_hz.get(n, 0.0) >= ABOUT_HZ}
    coming = [name for name in names if name not in own and rates_hz.get(name, 0.0) >= ABOUT_HZ]
    singly = 2 * len(came) < len(coming)  # asked for one by one, and not as the group
    whole_hz = 0.0 if singly or not came else float(max(1, round(max(came.values()))))
    asked = {**(came if singly else {}), **{name: hz for name, hz in own.items() if hz > whole_hz}}
    return [
        StreamRequest(leftover.stream, whole_hz),
        *(StreamRequest(Stream(None, name), hz) for name, hz in asked.items()),
    ]


def _is_same(now_hz: float, before_hz: float, own_hz: float | None) -> bool:
    """True if it comes as before, or as skygcs asks for it."""
    rates_hz = (before_hz,) if own_hz is None else (before_hz, own_hz)
    return any(abs(now_hz - hz) <= ABOUT_HZ or hz / SAME <= now_hz <= hz * SAME for hz in rates_hz)


def _own_rate(message: str, before_hz: Mapping[str, float], wanted_hz: Mapping[str, float]) -> float | None:
    """The rate skygcs asks for, if the message came no faster before; None: the vehicle's own default."""
    wanted = wanted_hz.get(message, 0.0)
    return wanted if wanted > 0 and before_hz.get(message, 0.0) <= SAME * wanted else None
