"""The compiled fast path by itself: bursts, callbacks that close and raise, memory that runs out, peers that change.

tests/integration/test_fast_path_hub.py compares it with the same hub without it; `make fuzz` runs this file under the
address and undefined behaviour sanitizers.
"""

from __future__ import annotations

import gc
import os
import random
import sys
import tracemalloc
import weakref
from collections.abc import Iterator
from typing import Any

import pytest

from skygcs.core.routing.router import DuplicateFilter
from skygcs.links import fast_path
from skygcs.links.reading import LARGEST_DATAGRAM_BYTES
from skygcs.links.udp import DATAGRAMS_PER_WAKEUP
from support.fast_path_bench import AMPLE, Bench, Channel, Slot, attitude
from support.frames import dialect
from support.table import each
from support.watchdog import processor_limit

pytestmark = pytest.mark.skipif(
    fast_path.new_table(dialect(), recording=False) is None and not os.environ.get("SKYGCS_REQUIRE_FASTPATH"),
    reason="skygcs was installed without a compiler",
)

LIMIT_S = 60.0
"""Of processor time; a test takes a tenth of a second, under the sanitizers some."""


@pytest.fixture
def bench() -> Iterator[Bench]:
    with processor_limit(LIMIT_S):
        made = Bench()
        yield made
        made.close()


def full_datagrams(bench: Bench, count: int) -> list[bytes]:
    """Of 250 frames, each of another source, whose flows are open and go nowhere."""
    bench.learn()
    for compid in range(count):
        bench.open_flow(source=0x0100 + compid, outs=())
    return [b"".join(attitude(n, compid=compid, number=n) for n in range(250)) for compid in range(count)]


@pytest.mark.parametrize("frames", [1, 63, 64, 65, 66, 128, 129, 256])
@pytest.mark.parametrize("whole", [True, False])
def test_all_frames_of_a_datagram_arrive_in_order(bench: Bench, frames: int, whole: bool) -> None:
    bench.out = bench.new_out(bench.target, whole=whole)
    bench.learn()
    bench.open_flow()
    sent = [attitude(n, number=n) for n in range(frames)]
    bench.send(b"".join(sent))
    bench.fast_path.ready(*AMPLE)
    assert b"".join(bench.received()) == b"".join(sent)
    assert not bench.left
    assert bench.table.take()[0] == frames
    assert (bench.target.tx_frames, bench.target.tx_bytes, bench.channel.rx_frames) == (frames, 40 * frames, frames)
    assert bench.stats.frames == frames


def test_a_datagram_of_more_frames_than_it_takes_is_left_to_python(bench: Bench) -> None:
    bench.learn()
    bench.open_flow()
    bench.send(b"".join(attitude(n, number=n) for n in range(257)))
    bench.fast_path.ready(*AMPLE)
    assert len(bench.left) == 1
    assert not bench.received()


def test_bursts_of_full_wake_ups_arrive_in_order(bench: Bench) -> None:
    """Each destination is sent to several times within a burst, and waits once."""
    bench.learn()
    others = [bench.new_out(Channel()) for _ in range(3)]
    bench.open_flow()
    bench.open_flow(source=0x01BF, outs=(others[0], bench.out, others[1], others[2]))
    sent = []
    for n in range(DATAGRAMS_PER_WAKEUP * 3):
        sent.append(attitude(n, number=n) + attitude(n, compid=0xBF, number=n))
    for at in range(0, len(sent), DATAGRAMS_PER_WAKEUP):
        bench.send(*sent[at : at + DATAGRAMS_PER_WAKEUP])
        bench.fast_path.ready(*AMPLE)
        bench.table.take()
        got = bench.received()
        assert len(got) == DATAGRAMS_PER_WAKEUP * 5
        assert [raw for raw in got if raw[6] == 1] == [data[:40] for data in sent[at : at + DATAGRAMS_PER_WAKEUP]]


def test_a_wake_up_ends_with_the_datagram_that_spends_its_share_and_the_next_one_goes_on(bench: Bench) -> None:
    """Only what is left to Python counts; what was received is kept, in its order, also if a callback fails."""
    bench.learn()
    bench.open_flow()
    garbage = [bytes((0xFD, n)) * 50 for n in range(4)]
    sent = [attitude(1), garbage[0], attitude(2), garbage[1], attitude(3), garbage[2], garbage[3], attitude(4)]
    bench.send(*sent)
    bench.fast_path.ready(1, 3600.0)
    assert (bench.left, bench.received(), bench.fast_path.kept) == (garbage[:1], [attitude(1)], 6)
    bench.send(attitude(5))
    bench.fast_path.ready(101, 3600.0)
    assert (bench.left, bench.received(), bench.fast_path.kept) == (garbage[:3], [attitude(2), attitude(3)], 2)

    def fail(data: bytes, *_: object) -> None:
        raise ValueError

    bench.on_left = fail
    with pytest.raises(ValueError):
        bench.fast_path.ready(1 << 40, 0.0)
    assert (bench.left, bench.fast_path.kept) == (garbage, 1)
    bench.fast_path.ready(1, 0.0)
    assert (bench.received(), bench.fast_path.kept) == ([attitude(4)], 0)
    bench.fast_path.ready(1, 0.0)
    assert bench.received() == [attitude(5)]
    bench.send(garbage[0], garbage[1])
    bench.on_left = lambda *_: bench.fast_path.close()
    bench.fast_path.ready(1, 0.0)
    assert bench.fast_path.kept == 0


def test_a_datagram_that_is_too_large_is_dropped_and_counted(bench: Bench) -> None:
    bench.learn()
    bench.open_flow()
    largest = b"".join(attitude(n, number=n) for n in range(256))
    largest += b"?" * (LARGEST_DATAGRAM_BYTES - len(largest))
    bench.send(largest, largest + b"?", bytes(65_507), attitude(1))
    bench.fast_path.ready(*AMPLE)
    assert (bench.left, bench.received(), bench.fast_path.too_large) == ([largest], [attitude(1)], 2)


# -- callbacks


def test_a_fault_behind_one_datagram_does_not_drop_the_rest_of_the_burst(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They are out of the kernel, and nobody else has them. The first fault is raised, no other is lost."""
    others: list[str] = []
    monkeypatch.setattr(sys, "unraisablehook", lambda fault: others.append(str(fault.exc_value)))
    bench.learn()
    bench.open_flow()

    def fail(data: bytes, *_: object) -> None:
        raise ValueError(f"{len(data)} bytes")

    bench.on_left = fail
    bench.send(b"?", attitude(1), b"??", attitude(2), b"???")
    with pytest.raises(ValueError, match="1 bytes"):
        bench.fast_path.ready(*AMPLE)
    assert others == ["2 bytes", "3 bytes"]
    assert bench.left == [b"?", b"??", b"???"]
    assert bench.received() == [attitude(1), attitude(2)]


def test_a_fault_behind_the_newest_frames_does_not_drop_the_datagram_after_them(bench: Bench) -> None:
    bench.learn()

    calls: list[float] = []

    def fail(now: float) -> None:
        calls.append(now)
        if len(calls) == 1:
            raise ValueError("behind a heartbeat")

    bench.open_flow(again=fail)
    bench.send(attitude(1), b"?", attitude(2))
    with pytest.raises(ValueError, match="behind a heartbeat"):
        bench.fast_path.ready(*AMPLE)
    assert bench.left == [b"?"]
    assert bench.received() == [attitude(1), attitude(2)]


@each("error", [OSError(5, "disk"), BlockingIOError(11, "later"), KeyboardInterrupt()])
def test_an_error_of_python_code_is_not_taken_for_the_sockets(bench: Bench, error: BaseException) -> None:
    def fail(*_: object) -> None:
        raise error

    bench.on_left = fail
    bench.send(b"?")
    with pytest.raises(type(error)):
        bench.fast_path.ready(*AMPLE)
    assert not bench.errors


def test_an_error_of_the_socket_is_reported(bench: Bench) -> None:
    bench.server.close()
    bench.fast_path.ready(*AMPLE)
    assert [error.errno for error in bench.errors] == [9]


def test_a_link_closed_behind_a_datagram_ends_the_burst(bench: Bench) -> None:
    """Also with so many records that `after` is due, which was let go of."""
    bench.on_left = lambda *_: bench.fast_path.close()
    bench.send(*full_datagrams(bench, 10), b"?", attitude(1), b"?")
    bench.fast_path.ready(*AMPLE)
    assert bench.left == [b"?"]
    assert bench.taken == 1
    assert bench.channel.rx_frames == 2500
    bench.fast_path.ready(*AMPLE)
    bench.open_flow()
    bench.fast_path.add_peer(bench.vehicle.getsockname(), bench.channel, bench.counts, 1)
    bench.fast_path.remove_peer(bench.vehicle.getsockname())
    bench.fast_path.close()


def test_a_link_closed_while_the_newest_frames_are_reported_is_released_after_the_last(bench: Bench) -> None:
    """``again`` runs while the flows of the burst are gone through."""
    bench.learn()
    called: list[int] = []

    def close(number: int) -> Any:
        def again(now: float) -> None:
            called.append(number)
            bench.fast_path.close()
            bench.table.invalidate()
            gc.collect()

        return again

    slots = [Slot() for _ in range(8)]
    for n, slot in enumerate(slots):
        bench.open_flow(source=0x0101 + n, slot=slot, again=close(n))
    bench.send(*[attitude(1, compid=1 + n) for n in range(8)], b"?")
    bench.fast_path.ready(*AMPLE)
    assert called == list(range(8))  # in the order in which they came
    assert [slot.count for slot in slots] == [1] * 8
    assert len(bench.received()) == 8
    assert not bench.left  # the link was closed before it was this one's turn


def test_flows_added_and_ended_by_callbacks(bench: Bench) -> None:
    bench.learn()
    heartbeats: list[float] = []

    def again(now: float) -> None:
        heartbeats.append(now)
        bench.table.invalidate()
        bench.open_flow(source=0x0102)
        bench.fast_path.remove_peer(bench.vehicle.getsockname())
        bench.fast_path.add_peer(bench.vehicle.getsockname(), bench.channel, bench.counts, 1)
        bench.table.take()

    bench.open_flow(again=again)
    bench.send(attitude(1), attitude(2))
    bench.fast_path.ready(*AMPLE)
    assert heartbeats == [1000.0]
    assert bench.channel.rx_frames == 2
    bench.send(attitude(3))
    bench.fast_path.ready(*AMPLE)
    assert bench.left == [attitude(3)]


def test_a_fast_path_cannot_receive_within_its_own_callback(bench: Bench) -> None:
    caught: list[str] = []

    def again(*_: object) -> None:
        try:
            bench.fast_path.ready(*AMPLE)
        except RuntimeError as error:
            caught.append(str(error))

    bench.on_left = again
    bench.send(b"?")
    bench.fast_path.ready(*AMPLE)
    assert len(caught) == 1


def test_the_last_reference_may_go_in_a_callback() -> None:
    bench = Bench()
    ready = bench.fast_path.ready

    def drop(*_: object) -> None:
        nonlocal ready
        bench.fast_path.close()
        del bench.fast_path
        ready = None

    bench.on_left = drop
    bench.send(b"?", b"?")
    ready(*AMPLE)
    assert bench.left == [b"?"]
    for sock in bench.sockets:
        sock.close()


# -- owners and memory


def test_counts_for_a_freed_channel_are_dropped(bench: Bench) -> None:
    bench.learn()
    bench.open_flow()
    gone = weakref.ref(bench.target)
    bench.send(attitude(1))
    bench.fast_path.ready(*AMPLE)
    bench.target = Channel()
    gc.collect()
    assert gone() is None
    assert bench.table.take()[0] == 1


def test_what_is_closed_is_released() -> None:
    def once() -> None:
        bench = Bench()
        bench.learn()
        for n in range(50):
            bench.open_flow(source=0x0101 + n, slot=Slot())
        bench.send(*[attitude(1, compid=1 + n) for n in range(50)], b"?")
        bench.fast_path.ready(*AMPLE)
        bench.close()

    for _ in range(3):
        once()
    tracemalloc.start()
    grown = []
    try:
        for _ in range(4):  # a leak grows each time; a table of the interpreter that happens to grow does so once
            gc.collect()
            before = tracemalloc.get_traced_memory()[0]
            for _ in range(10):
                once()
            gc.collect()
            grown.append(tracemalloc.get_traced_memory()[0] - before)
    finally:
        tracemalloc.stop()
    assert min(grown) < 900, grown  # one flow that is kept of fifty would be 10 times 100 bytes


def test_peers_that_come_and_go_do_not_add_up(bench: Bench) -> None:
    """A sender may claim any address."""
    addresses = [(f"10.{n >> 16 & 255}.{n >> 8 & 255}.{n & 255}", 14550) for n in range(60_000)]
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for address in addresses:
            bench.fast_path.add_peer(address, bench.channel, bench.counts, 2)
            bench.fast_path.remove_peer(address)
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 100_000  # a cell is 16 bytes
    bench.learn()
    bench.open_flow()
    bench.send(attitude(1))
    bench.fast_path.ready(*AMPLE)
    assert bench.received() == [attitude(1)]


def test_the_buffer_of_records_shrinks_again(bench: Bench) -> None:
    sent = full_datagrams(bench, DATAGRAMS_PER_WAKEUP)
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        bench.send(*sent)
        bench.fast_path.ready(*AMPLE)
        bench.table.take()
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert bench.taken
    assert grown < 300_000


try:
    import _testcapi  # not in every distribution's Python
except ImportError:
    _testcapi = None


@pytest.mark.skipif(not hasattr(_testcapi, "set_nomemory"), reason="this Python cannot pretend that memory runs out")
def test_nothing_is_left_half_done_when_memory_runs_out(bench: Bench) -> None:
    """At every allocation in turn, of every call. Afterwards all goes on."""
    if sys.gettrace() is not None:
        pytest.skip("what traces the lines, as coverage does, needs memory itself")
    peers = [("10.0.0.1", port) for port in range(1, 400)]
    rng = random.Random(1)

    def calls(bench: Bench) -> list[Any]:
        address = bench.vehicle.getsockname()
        return [
            lambda: bench.fast_path.add_peer(address, bench.channel, bench.counts, 1),
            lambda: bench.fast_path.add_peer(rng.choice(peers), bench.channel, bench.counts, 2),
            lambda: bench.fast_path.remove_peer(rng.choice(peers)),
            lambda: bench.open_flow(source=0x0100 + rng.randrange(200), slot=Slot()),
            lambda: bench.open_flow(),
            lambda: bench.fast_path.ready(*AMPLE),
            lambda: bench.fast_path.ready(*AMPLE),
            bench.table.invalidate,
            bench.table.take,
        ]

    failed = 0
    for start in range(60):
        bench.learn()
        for call in calls(bench):
            bench.send(attitude(start), attitude(start, compid=2), b"?")
            _testcapi.set_nomemory(start, start + 1)
            try:
                call()
            except MemoryError:
                failed += 1
            finally:
                _testcapi.remove_mem_hooks()
    bench.fast_path.ready(*AMPLE)
    bench.left.clear()
    bench.table.invalidate()
    bench.fast_path.add_peer(bench.vehicle.getsockname(), bench.channel, bench.counts, 1)
    bench.now += 10.0
    bench.learn()
    bench.open_flow()
    bench.received()
    bench.send(attitude(7))
    bench.fast_path.ready(*AMPLE)
    assert bench.received() == [attitude(7)]
    assert failed > 100


@pytest.mark.skipif(not hasattr(_testcapi, "set_nomemory"), reason="this Python cannot pretend that memory runs out")
def test_a_peer_that_cannot_be_replaced_stays(bench: Bench) -> None:
    """The map of peers is made anew when the 128th is put into it, also if that one is known already."""
    bench.learn()
    for port in range(1, 127):
        bench.fast_path.add_peer(("10.0.0.1", port), bench.channel, bench.counts, 2)
    bench.open_flow()
    failed = 0
    for start in range(12):
        bench.table.take()
        _testcapi.set_nomemory(start, start + 1)
        try:
            bench.fast_path.add_peer(bench.vehicle.getsockname(), bench.channel, bench.counts, 1)
        except MemoryError:
            failed += 1
        finally:
            _testcapi.remove_mem_hooks()
        if start == failed - 1:  # the peer of before, with its flow
            bench.send(attitude(start))
            bench.fast_path.ready(*AMPLE)
            assert bench.received() == [attitude(start)]
    assert 0 < failed < 12
    bench.fast_path.remove_peer(bench.vehicle.getsockname())
    bench.send(b"?")
    bench.fast_path.ready(*AMPLE)
    assert bench.left == [b"?"]


# -- contracts


def test_ids_that_have_no_room_are_refused(bench: Bench) -> None:
    address = bench.vehicle.getsockname()
    for channel_id in (0, 1 << 24):
        with pytest.raises(ValueError):
            bench.fast_path.add_peer(address, bench.channel, bench.counts, channel_id)
        with pytest.raises(ValueError):
            bench.table.first_heard_on(1, channel_id, 0.0)
    with pytest.raises(ValueError):
        bench.table.first_heard_on(1 << 40, 1, 0.0)
    with pytest.raises(ValueError):
        bench.open_flow(source=1 << 16)
    with pytest.raises(ValueError):
        bench.open_flow(1 << 24)


def test_frames_are_remembered_as_long_as_by_the_router(bench: Bench) -> None:
    by_router, rng, now = DuplicateFilter(), random.Random(3), 50.0
    for _ in range(5000):
        now += rng.choice((0.0, 0.1, 0.4, 0.9, 1.1, 3.0))
        frame = rng.randrange(6), rng.randint(1, 3), now
        assert bench.table.first_heard_on(*frame) == by_router.first_heard_on(*frame)


def test_objects_that_were_not_initialised_do_nothing() -> None:
    from skygcs.links._fast_path import FastPath, Out, Table

    table, fast_path = Table.__new__(Table), FastPath.__new__(FastPath)
    with pytest.raises(RuntimeError):
        table.first_heard_on(1, 1, 0.0)
    table.invalidate()
    assert table.take() == (0, 0, b"", 0)
    with pytest.raises(RuntimeError):
        FastPath(table, 1, 1500, None, None, None, None)  # type: ignore[arg-type]
    fast_path.ready(*AMPLE)
    fast_path.close()
    Out.__new__(Out)
    with pytest.raises(ValueError):
        FastPath(Bench().table, -1, 1500, None, None, None, None)  # type: ignore[arg-type]


def test_both_are_made_once(bench: Bench) -> None:
    with pytest.raises(TypeError):
        bench.table.__init__({}, int, False)  # type: ignore[misc]
    with pytest.raises(TypeError):
        bench.out.__init__(1, ("127.0.0.1", 1), bench.channel, True)


def test_a_fast_path_that_was_not_closed_reports_its_counts_when_it_is_freed(bench: Bench) -> None:
    bench.learn()
    server = bench.socket()
    fast_path = bench.new_fast_path(server)
    fast_path.add_peer(bench.vehicle.getsockname(), bench.channel, bench.counts, 1)
    fast_path.add_flow(
        bench.vehicle.getsockname(), 0x0101, 30, bench.stats, bench.heard, (bench.out,), None, None, None, None
    )
    bench.vehicle.sendto(attitude(1), server.getsockname())
    fast_path.ready(*AMPLE)
    del fast_path
    gc.collect()
    assert (bench.channel.rx_frames, bench.target.tx_frames, bench.stats.frames) == (1, 1, 1)
    bench.send(b"?")
    bench.fast_path.ready(*AMPLE)
    assert bench.left == [b"?"]
    assert bench.table.take()[0] == 1
