"""Observers get what they asked for, and nothing is looked at that nobody asked for."""

from __future__ import annotations

from skygcs.runtime.frame_observers import FrameObservers
from support.plain_hub import HubBench
from support.routed import heartbeat, message


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
