"""Which frames get a flow, so that the compiled fast path forwards the next ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from skygcs.core.mavlink.frame import Frame
from skygcs.core.routing.routing_table import RoutingVerdict
from skygcs.links.base import ForwardingPath
from skygcs.runtime.channel_statistics import Flows, FrameObservers
from support.plain_hub import HubBench, PlainChannel
from support.routed import heartbeat, message

ALPHA = 7 << 8 | 1


class StubTable:
    """In the place of the compiled code."""

    records_waiting = 0

    def __init__(self) -> None:
        self.invalidated = 0

    def invalidate(self) -> None:
        self.invalidated += 1

    def take(self) -> tuple[int, int, bytes, int]:
        return 3, 2, b"12345678raw", 1


class FlowBench:
    """Flows over the routes of a plain hub: a vehicle on a radio, and a ground station."""

    def __init__(self) -> None:
        bench = self.bench = HubBench()
        self.radio, self.gcs = bench.channel("radio", role="radio"), bench.channel("gcs", role="gcs")
        for channel in (self.radio, self.gcs):
            out: Any = SimpleNamespace(of=channel)
            channel.out = out
        bench.feed(self.radio, heartbeat(7))
        self.table, self.one_by_one, self.recorded = StubTable(), set[int](), list[tuple[bytes, int]]()
        recorder: Any = SimpleNamespace(offer_many=lambda records, count: self.recorded.append((records, count)))
        table: Any = self.table
        self.flows = Flows(
            table,
            bench.hub.router,
            bench.hub.channels,
            bench.hub.observers,
            recorder,
            each_frame=self.one_by_one.__contains__,
            on_fault=lambda error: bench.faults.append(str(error)),
        )
        bench.hub.observers.on_change = self.flows.forget
        self.opened: list[tuple[str, tuple[PlainChannel, ...]]] = []
        self.radio.add_flow = self._opened  # type: ignore[method-assign]

    def _opened(self, frame: Frame, path: ForwardingPath) -> None:
        outs: Any = path.outs
        self.opened.append((frame.name, tuple(out.of for out in outs)))

    def open(self, raw: bytes) -> None:
        (frame,) = self.radio.parser.feed_datagram(raw)
        self.flows.open(self.radio, frame, ALPHA, self.radio.sources[ALPHA])


async def test_telemetry_gets_a_flow_to_where_the_router_sends_it_and_what_has_a_target_none() -> None:
    bench = FlowBench()
    bench.open(message("ATTITUDE", 7))
    bench.open(message("COMMAND_ACK", 7, target_system=255, target_component=190))
    assert bench.opened == [("ATTITUDE", (bench.gcs,))]


async def test_frames_that_are_observed_get_no_flow_until_they_are_no_longer() -> None:
    bench = FlowBench()
    remove = bench.bench.hub.observers.add({30}, None, lambda *_: None)
    assert bench.table.invalidated == 1, "flows that were open are closed"
    bench.open(message("ATTITUDE", 7))
    assert bench.opened == []
    remove()
    bench.open(message("ATTITUDE", 7))
    assert bench.opened == [("ATTITUDE", (bench.gcs,))]


async def test_a_channel_whose_frames_are_handled_one_by_one_gets_none_and_is_asked_again_after_a_change() -> None:
    bench = FlowBench()
    bench.one_by_one.add(bench.gcs.id)
    bench.open(message("ATTITUDE", 7))
    bench.one_by_one.clear()
    bench.open(message("ATTITUDE", 7))
    assert bench.opened == [], "that there is none is remembered"
    bench.flows.forget()
    bench.open(message("ATTITUDE", 7))
    assert bench.opened == [("ATTITUDE", (bench.gcs,))]


async def test_what_the_fast_path_forwarded_is_counted_and_recorded() -> None:
    bench = FlowBench()
    counters = bench.bench.hub.router.counters
    before = counters[RoutingVerdict.FORWARDED], counters[RoutingVerdict.LOCAL]
    bench.flows.take()
    assert (counters[RoutingVerdict.FORWARDED], counters[RoutingVerdict.LOCAL]) == (before[0] + 3, before[1] + 2)
    assert bench.recorded == [(b"12345678raw", 1)]


async def test_a_tap_hears_what_it_asked_for_until_it_is_removed() -> None:
    bench = HubBench()
    channel = bench.channel("a")
    heard: list[tuple[str, int]] = []
    remove = bench.hub.observers.add({30}, {2 << 8 | 1}, lambda f, c, now: heard.append((f.name, f.sysid)))
    bench.feed(channel, message("ATTITUDE", 1), message("ATTITUDE", 2), heartbeat(2))
    remove()
    remove()
    bench.feed(channel, message("ATTITUDE", 2, seq=9))
    assert heard == [("ATTITUDE", 2)]


def test_the_observed_messages_are_those_of_all_observers_and_each_change_is_reported() -> None:
    observers, changes = FrameObservers(), []
    observers.on_change = lambda: changes.append(observers.msgids)
    remove_attitude = observers.add({30}, None, lambda *_: None)
    remove_all = observers.add(None, {7 << 8}, lambda *_: None)
    assert observers.watch(30, 2 << 8 | 1)
    assert observers.watch(0, 7 << 8 | 191), "component 0: the whole system"
    assert not observers.watch(0, 2 << 8 | 1)
    remove_all()
    remove_attitude()
    remove_attitude()
    assert changes == [{30}, None, {30}, set()]
