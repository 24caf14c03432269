"""The soak's book sees what is lost, doubled, damaged and misdelivered; its junk holds no frame."""

from __future__ import annotations

import random

from bench import soak_traffic
from bench.soak_traffic import AUTOPILOT, Book, Kind, Source, World
from skygcs.core.mavlink.parser import FrameParser
from support.frames import dialect
from support.table import each

KIND: Kind = soak_traffic._kind("ATTITUDE")
A, B = 0, 1
TO_A, TO_B = 1 << A, 1 << B


def frames(count: int) -> list[bytes]:
    source = Source(1, AUTOPILOT)
    return [source.telemetry(KIND) for _ in range(count)]


def test_what_comes_as_it_should_is_delivered() -> None:
    book = Book()
    for raw in frames(3):
        book.sent(raw, TO_A, TO_B)
        book.received(raw, A, "a")
    book.received(raw, B, "b")
    assert book.totals["frames delivered"] == 4
    assert not book.missing()
    assert not book.strange


def test_a_lost_frame_is_missing_where_it_must_come() -> None:
    book = Book()
    for raw in frames(5):
        book.sent(raw, TO_A | TO_B, 0)
    book.received(raw, A, "a")
    assert book.missing() == {A: 4, B: 5}


@each(
    ("what", "receiver", "times", "damage"),
    [("misdelivered", B, 1, False), ("doubled", A, 2, False), ("unknown or damaged", A, 1, True)],
)
def test_a_frame_that_should_not_come_is_counted(what: str, receiver: int, times: int, damage: bool) -> None:
    book = Book()
    (raw,) = frames(1)
    book.sent(raw, TO_A, 0)
    for _ in range(times):
        book.received(raw[:-1] + b"?" if damage else raw, receiver, "x")
    assert book.totals[what] == 1
    assert len(book.strange) == 1


def test_a_heartbeat_whose_number_has_come_round_may_come_twice() -> None:
    book = Book()
    raw = Source(1, AUTOPILOT).heartbeat(2, 12)
    for _ in range(2):
        book.sent(raw, TO_A, 0)
        book.received(raw, A, "a")
    assert not book.strange
    assert not book.missing()


def test_a_copy_of_somebody_elses_is_no_loss() -> None:
    """A forged heartbeat may happen to be the vehicle's own, byte for byte: one of the two is dropped as a copy."""
    book = Book()
    raw = Source(1, AUTOPILOT).heartbeat(2, 12)
    book.sent(raw, TO_A, 0)
    book.sent(raw, 0, TO_A)
    assert book.missing() == {A: 1}
    book.received(raw, A, "a")
    assert not book.missing()
    book.received(raw, A, "a")
    assert not book.strange


def test_what_comes_after_its_leg_is_not_misdelivered() -> None:
    book = Book()
    (raw,) = frames(1)
    book.sent(raw, TO_A, 0)
    book.next_leg()
    book.received(raw, A, "a")
    assert not book.strange


def test_a_heartbeat_of_the_leg_before_may_come_after_an_equal_one_was_sent() -> None:
    book = Book()
    raw = Source(1, AUTOPILOT).heartbeat(2, 12)
    book.sent(raw, TO_A, 0)
    book.next_leg()
    book.sent(raw, TO_A, 0)
    book.received(raw, A, "a")
    book.received(raw, A, "a")
    assert not book.strange
    assert not book.missing()
    book.received(raw, A, "a")
    assert book.totals["doubled"] == 1


def test_of_equal_heartbeats_in_two_legs_the_one_that_may_come_is_taken() -> None:
    """The vehicle's own, which it does not get back, and a forged one in the leg after, which goes there as well."""
    book = Book()
    raw = Source(1, AUTOPILOT).heartbeat(2, 12)
    book.sent(raw, TO_B, 0)
    book.next_leg()
    book.sent(raw, 0, TO_A)
    book.received(raw, A, "a")
    assert not book.strange


def test_junk_holds_no_frame_and_all_else_does() -> None:
    world = World({"field": (1, 2), "air": (2, 3), "near": (3, 1)}, seed=7)
    try:
        parser = FrameParser(dialect())
        for vehicle in world.vehicles:
            for source in (vehicle.autopilot, vehicle.companion):
                for _ in range(20):
                    kind = random.Random(1).choice(world.telemetry)
                    assert len(parser.feed_datagram(source.telemetry(kind))) == 1
                assert len(parser.feed_datagram(source.heartbeat(2, 12))) == 1
        for _ in range(5_000):
            assert parser.feed_datagram(world.noise()) == []
    finally:
        world.close()
