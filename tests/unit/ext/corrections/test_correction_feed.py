"""RTCM from the socket: what goes to the links, and what is kept of it."""

from __future__ import annotations

from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.core.radio_link.corrections import MAX_TYPES
from skygcs.core.radio_link.transmit_queue import Priority
from skygcs.errors import RefusedError
from skygcs.ext.corrections.correction_feed import MAX_RECENT, MESSAGE_BURST, MESSAGES_PER_S, RATE_S, CorrectionFeed
from support.frames import dialect
from support.rtcm import STANDARD_1005, rtcm_frame


class FakeHub:
    """Takes all but every fragment whose number is in ``refuses``."""

    def __init__(self) -> None:
        self.dialect: Any = dialect()
        self.channels: dict[int, Any] = {}
        self.sent: list[Mapping[str, Any]] = []
        self.refuses: set[int] = set()

    def channels_to(self, sysid: int, compid: int) -> tuple[int, ...]:
        assert (sysid, compid) == (0, 0)
        return (1,)

    def send(
        self, info: Any, values: Mapping[str, Any], sysid: int, compid: int, priority: Priority, *, clearance: Any
    ) -> bool:
        assert (info.name, sysid, compid, priority) == ("GPS_RTCM_DATA", 0, 0, Priority.CORRECTION)
        info.pack(values)
        self.sent.append(values)
        return values["flags"] >> 1 & 3 not in self.refuses


class Bench:
    def __init__(self) -> None:
        self.hub = FakeHub()
        self.now = 100.0
        fleet = SimpleNamespace(vehicles={})
        self.feed = CorrectionFeed(self.hub, fleet, lambda: self.now)  # type: ignore[arg-type]


def test_messages_follow_each_other_under_new_sequence_ids() -> None:
    bench = Bench()
    for _ in range(40):
        bench.feed.send("a", rtcm_frame(1077, body_bytes=300))
    flags = [values["flags"] for values in bench.hub.sent]
    assert [f >> 3 for f in flags] == [(n // 2 + 1) % 32 for n in range(80)]
    assert [f & 7 for f in flags] == [1, 3] * 40


def test_a_message_that_had_begun_before_a_standstill_is_not_continued() -> None:
    bench, whole = Bench(), rtcm_frame(1077, body_bytes=300)
    bench.feed.send("a", whole[:100])
    bench.feed.woke()
    assert bench.feed.send("a", whole[100:])["messages"] == 0
    assert bench.feed.send("a", whole)["messages"] == 1


def test_a_flood_of_sound_messages_reaches_the_links_at_the_rate_of_a_base() -> None:
    bench = Bench()
    filler = b"\xd3\x00\x00\x47\xea\x4b"
    first = bench.feed.send("a", filler * 5000)
    assert (first["messages"], first["refused"]) == (MESSAGE_BURST, 5000 - MESSAGE_BURST)
    bench.now += 1.0
    assert bench.feed.send("a", filler * 5000)["messages"] == MESSAGES_PER_S
    assert len(bench.hub.sent) == MESSAGE_BURST + MESSAGES_PER_S
    assert bench.feed.status()["bytes_per_s"] == (MESSAGE_BURST + MESSAGES_PER_S) * len(filler) / RATE_S


def test_a_message_of_which_a_fragment_was_refused_does_not_count_as_sent() -> None:
    bench = Bench()
    bench.hub.refuses = {1}
    reported = bench.feed.send("a", rtcm_frame(1077, body_bytes=300) + STANDARD_1005)
    assert (reported["messages"], reported["refused"], reported["types"]) == (1, 1, {"1005": 1})


def test_what_is_kept_is_bounded() -> None:
    bench = Bench()
    for type_ in range(1, 3 * MAX_TYPES):
        bench.feed.send("a", rtcm_frame(type_, body_bytes=7))
    bench.now += RATE_S + MESSAGE_BURST / MESSAGES_PER_S
    each_s, count = 1 / MESSAGES_PER_S, 2 * MAX_RECENT
    for _ in range(count):
        bench.now += each_s
        bench.feed.send("a", STANDARD_1005)
    assert len(bench.feed._recent) == MAX_RECENT
    status = bench.feed.status()
    assert len(status["types"]) == MAX_TYPES
    assert status["messages"] == 3 * MAX_TYPES - 1 + count
    full = MESSAGES_PER_S * len(STANDARD_1005)
    assert status["bytes_per_s"] == pytest.approx(full, rel=0.001), "the rate that is admitted is measured"
    bench.now += RATE_S + 1
    assert bench.feed.status()["bytes_per_s"] == 0


def test_a_dialect_without_the_message_is_named() -> None:
    bench = Bench()
    bench.hub.dialect = SimpleNamespace(name="minimal", by_name={})
    feed = CorrectionFeed(bench.hub, SimpleNamespace(vehicles={}), lambda: 0.0)  # type: ignore[arg-type]
    with pytest.raises(RefusedError, match="the dialect minimal has no GPS_RTCM_DATA"):
        feed.send("a", STANDARD_1005)
