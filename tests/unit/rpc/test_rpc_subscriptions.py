"""What subscribers are told, how often, and what slowness costs (themselves only)."""

from __future__ import annotations

import asyncio
import json
import sys
from typing import Any
from unittest.mock import Mock

import pytest

from skygcs.errors import TargetError
from skygcs.rpc import slices
from skygcs.rpc.dispatch import InvalidParams
from skygcs.rpc.models import SubscribeParams
from skygcs.rpc.slices import Slices
from skygcs.rpc.subscriptions import QUEUED, Feeds, Subscription
from support.fake_daemon import FakeDaemon
from support.table import each


class Reader:
    """A client's output that can be blocked."""

    def __init__(self) -> None:
        self.writable = True
        self.raw = b""

    def write(self, data: bytes) -> None:
        self.raw += data

    def take(self) -> list[dict[str, Any]]:
        """The notifications' params since the last time."""
        lines, self.raw = self.raw.splitlines(), b""
        notifications = [json.loads(line) for line in lines]
        assert all(n["jsonrpc"] == "2.0" and "id" not in n for n in notifications)
        return [{"method": n["method"], **n["params"]} for n in notifications]


class Told:
    """Feeds on the running loop, and readers of them."""

    def __init__(self, vehicle_count: int = 3) -> None:
        self.daemon = FakeDaemon(vehicle_count)
        self.slices = Slices(asyncio.get_running_loop(), self.daemon.fleet.next_control_tick)
        self.feeds = Feeds(self.daemon, asyncio.get_running_loop(), self.slices)

    def add(self, number: int = 1, **params: Any) -> tuple[Reader, Subscription]:
        reader = Reader()
        return reader, self.feeds.add(reader, number, SubscribeParams.model_validate(params))


async def settle() -> None:
    """Until what is due at this moment is done."""
    for _ in range(5):
        await asyncio.sleep(0)


@pytest.fixture
async def reported() -> Told:
    return Told()


@pytest.mark.looptime
async def test_telemetry_begins_at_once_and_keeps_its_rate(reported: Told) -> None:
    reader, _ = reported.add(topic="telemetry", rate_hz=5)
    await settle()
    first = reader.take()
    assert [n["state"]["name"] for n in first] == ["alpha", "bravo", "carol"]
    assert {n["subscription"] for n in first} == {1} and {n["method"] for n in first} == {"telemetry"}
    await asyncio.sleep(10.01)
    assert len(reader.take()) == pytest.approx(3 * 50, abs=3)
    reported.feeds.close()


@pytest.mark.looptime
@pytest.mark.parametrize("rate_hz", [None, 0.3, 1, 2, 3, 7, 15, 20])
async def test_any_rate_is_kept_on_average_and_two_a_second_if_nothing_is_said(rate_hz: float | None) -> None:
    reported = Told(1)
    reader, _ = reported.add(topic="telemetry", **({} if rate_hz is None else {"rate_hz": rate_hz}))
    await asyncio.sleep(100)
    assert len(reader.take()) == pytest.approx(100 * (rate_hz or 2) + 1, abs=2)
    reported.feeds.close()


@pytest.mark.looptime
async def test_states_that_take_long_are_written_in_slices_with_pauses_for_an_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slices, "SLICE_S", -1.0)  # each look at the clock ends a slice
    reported = Told()
    reported.slices.order_came()
    reader, _ = reported.add(topic="telemetry", rate_hz=5)
    turns: list[list[str]] = []
    for _ in range(3):
        await settle()
        turns.append([n["state"]["name"] for n in reader.take()])
        await asyncio.sleep(slices.PAUSE_S)
    assert turns == [["alpha"], ["bravo"], ["carol"]]
    reported.feeds.close()


@pytest.mark.looptime
async def test_states_wait_for_a_control_tick_that_is_due_but_not_for_long(reported: Told) -> None:
    loop = asyncio.get_running_loop()
    reported.daemon.fleet.control_tick_at = loop.time()  # and nobody carries it out
    reader, _ = reported.add(topic="telemetry", rate_hz=5)
    await asyncio.sleep(slices.PUT_OFF_S / 2)
    assert reader.take() == []
    await asyncio.sleep(slices.PUT_OFF_S)
    assert [n["state"]["name"] for n in reader.take()] == ["alpha", "bravo", "carol"]
    reported.daemon.fleet.control_tick_at = loop.time() + 1.0
    await asyncio.sleep(0.5)
    assert len(reader.take()) == pytest.approx(3 * 2, abs=3)
    reported.feeds.close()


@pytest.mark.looptime
async def test_a_state_is_made_once_per_tick_for_all_subscribers(reported: Told) -> None:
    for number in range(20):
        reported.add(number, topic="telemetry", rate_hz=10)
    reported.add(21, topic="telemetry", rate_hz=2)
    await settle()
    before = reported.daemon.vehicle("alpha").states_made
    await asyncio.sleep(10.01)
    assert reported.daemon.vehicle("alpha").states_made - before == pytest.approx(100, abs=1)
    reported.feeds.close()


@pytest.mark.looptime
async def test_a_slow_reader_gets_fewer_and_fresh_states_and_the_others_all(reported: Told) -> None:
    slow, _ = reported.add(1, topic="telemetry", rate_hz=10, names=["mode"])
    quick, _ = reported.add(2, topic="telemetry", rate_hz=10, names=["mode"])
    await settle()
    slow.take()
    slow.writable = False
    for i in range(50):
        reported.daemon.vehicle("alpha").mode = f"MODE{i}"
        await asyncio.sleep(0.1)
    assert slow.raw == b""
    slow.writable = True
    reported.feeds.resume()
    await settle()
    update = slow.take()
    assert [n["state"]["name"] for n in update] == ["alpha", "bravo", "carol"]
    assert update[0]["state"]["mode"] == "MODE49"
    assert len(quick.take()) == pytest.approx(3 * 51, abs=3)
    reported.feeds.close()


@pytest.mark.looptime
async def test_every_vehicle_has_its_turn_with_a_reader_that_takes_little() -> None:
    reported = Told(60)
    reader, _ = reported.add(topic="telemetry", rate_hz=20, names=["mode"])
    seen: dict[str, int] = {}
    original = reader.write

    def write_and_block(data: bytes) -> None:
        original(data)
        reader.writable = False

    reader.write = write_and_block  # type: ignore[method-assign]
    for _ in range(40):
        await asyncio.sleep(0.05)
        for n in reader.take():
            seen[n["state"]["name"]] = seen.get(n["state"]["name"], 0) + 1
        reader.writable = True
        reported.feeds.resume()
    assert len(seen) == 60
    assert max(seen.values()) - min(seen.values()) <= 2
    reported.feeds.close()


@pytest.mark.looptime
async def test_only_the_wanted_sections_and_vehicles_are_sent(reported: Told) -> None:
    reader, _ = reported.add(topic="telemetry", targets="1,carol", names=["battery", "links"])
    await settle()
    update = reader.take()
    assert [set(n["state"]) for n in update] == [{"name", "sysid", "battery", "links"}] * 2
    assert update[0]["state"]["links"]["radio"]["loss_ratio"] == 0.013
    with pytest.raises(InvalidParams, match=r"no batery.*battery"):
        reported.add(2, topic="telemetry", names=["batery"])
    reported.feeds.close()


@pytest.mark.looptime
async def test_vehicles_that_come_later_belong_to_all_and_to_their_group(reported: Told) -> None:
    late = reported.daemon.fleet.vehicles.pop(3 << 8 | 1)
    everyone, _ = reported.add(1, topic="telemetry")
    red, _ = reported.add(2, topic="telemetry", targets="red")
    await settle()
    assert len(everyone.take()) == 2 and len(red.take()) == 1
    reported.daemon.fleet.vehicles[3 << 8 | 1] = late
    await asyncio.sleep(0.6)
    assert {n["state"]["name"] for n in everyone.take()} == {"alpha", "bravo", "carol"}
    assert {n["state"]["name"] for n in red.take()} == {"alpha", "carol"}
    reported.feeds.close()


@pytest.mark.looptime
async def test_all_may_be_nobody_yet_but_any_other_target_must_name_somebody(reported: Told) -> None:
    reported.daemon.fleet.vehicles.clear()
    reader, _ = reported.add(topic="telemetry")
    await asyncio.sleep(1)
    assert reader.raw == b""
    for topic in ("telemetry", "events", "messages"):
        with pytest.raises(TargetError):
            reported.add(2, topic=topic, targets="alpha")
    reported.feeds.close()


@pytest.mark.looptime
async def test_a_vehicle_whose_state_fails_does_not_stop_the_others(reported: Told) -> None:
    reported.daemon.vehicle("bravo").state_fails = ZeroDivisionError("a bug")
    reader, _ = reported.add(topic="telemetry", rate_hz=1)
    await asyncio.sleep(3.01)
    assert {n["state"]["name"] for n in reader.take()} == {"alpha", "carol"}
    reported.feeds.close()


@pytest.mark.looptime
async def test_nothing_runs_and_nobody_listens_without_subscriptions(reported: Told) -> None:
    subscriptions = [reported.add(i, topic=t)[1] for i, t in enumerate(("telemetry", "events", "messages"))]
    await settle()
    for subscription in subscriptions:
        reported.feeds.remove(subscription)
        reported.feeds.remove(subscription)
    await settle()
    made = reported.daemon.vehicle("alpha").states_made
    await asyncio.sleep(10)
    assert reported.daemon.vehicle("alpha").states_made == made
    assert reported.daemon.listeners == 0


@pytest.mark.looptime
async def test_events_of_the_wanted_kinds_and_vehicles_come_in_order(reported: Told) -> None:
    everything, _ = reported.add(1, topic="events")
    arming, _ = reported.add(2, topic="events", names=["armed"], targets="alpha,bravo")
    for kind, vehicle in (("armed", "alpha"), ("mode", "alpha"), ("armed", "carol"), ("link_up", None)):
        reported.daemon.emit(kind, vehicle, f"{kind} {vehicle}", odd=float("nan"))
    await settle()
    wanted = ["armed alpha", "mode alpha", "armed carol", "link_up None"]
    assert [n["event"]["text"] for n in everything.take()] == wanted
    told_of = arming.take()
    assert [n["event"]["text"] for n in told_of] == ["armed alpha"]
    assert told_of[0]["subscription"] == 2 and "dropped" not in told_of[0]
    assert told_of[0]["event"]["data"] == {"odd": None}


@pytest.mark.looptime
@pytest.mark.parametrize("topic", ["events", "messages"])
async def test_a_slow_reader_loses_the_oldest_and_is_told_how_many(reported: Told, topic: str) -> None:
    reader, subscription = reported.add(topic=topic)
    reader.writable = False
    for i in range(QUEUED + 40):
        if topic == "events":
            reported.daemon.emit("mode", "alpha", str(i))
        else:
            reported.daemon.hear("ATTITUDE", time_boot_ms=i)
    await settle()
    assert reader.raw == b""
    reader.writable = True
    assert not isinstance(subscription, type(None))
    subscription.flush()
    update = reader.take()
    assert len(update) == QUEUED
    assert update[0]["dropped"] == 40 and all("dropped" not in n for n in update[1:])
    key = [n["event"]["text"] if topic == "events" else n["message"]["fields"]["time_boot_ms"] for n in update]
    assert [int(k) for k in key] == list(range(40, QUEUED + 40))


@pytest.mark.looptime
@pytest.mark.parametrize("topic", ["events", "messages"])
async def test_one_costs_no_more_for_many_that_want_the_same_and_each_gets_what_came_since_it_began(
    reported: Told, topic: str
) -> None:
    def come() -> None:
        if topic == "events":
            reported.daemon.emit("mode", "alpha", "x")
        else:
            reported.daemon.hear("ATTITUDE")

    def calls_of_one() -> int:
        calls = 0

        def count(_frame: object, event: str, _arg: object) -> None:
            nonlocal calls
            calls += event == "call"

        sys.setprofile(count)
        try:
            come()
        finally:
            sys.setprofile(None)
        return calls

    first, _ = reported.add(1, topic=topic)
    come()
    await settle()
    alone = calls_of_one()
    others = [reported.add(n, topic=topic) for n in range(2, 40)]
    for reader, _ in others[1:]:
        reader.writable = False
    assert calls_of_one() <= alone
    await settle()
    assert [[n["subscription"] for n in reader.take()] for reader in (first, others[0][0])] == [[1] * 3, [2]]
    others[1][0].writable = True
    others[1][1].flush()
    (late,) = others[1][0].take()
    assert late["subscription"] == 3 and "dropped" not in late
    for _, subscription in others:
        reported.feeds.remove(subscription)
    come()
    await settle()
    assert len(first.take()) == 1 and others[0][0].raw == b""


@pytest.mark.looptime
async def test_messages_are_decoded_with_their_source_and_age(reported: Told) -> None:
    reader, _ = reported.add(topic="messages", names=["attitude", 0])
    reported.daemon.hear("ATTITUDE", roll=float("nan"), pitch=0.5)
    reported.daemon.hear("SYS_STATUS")
    reported.daemon.hear("HEARTBEAT", sysid=255, compid=190)
    await settle()
    attitude, heartbeat = (n["message"] for n in reader.take())
    assert (attitude["vehicle"], attitude["sysid"], attitude["compid"], attitude["name"]) == ("alpha", 1, 1, "ATTITUDE")
    assert attitude["fields"]["roll"] is None and attitude["fields"]["pitch"] == 0.5
    assert attitude["age_s"] == 0
    assert (heartbeat["vehicle"], heartbeat["name"]) == (None, "HEARTBEAT")
    with pytest.raises(InvalidParams, match="NONSENSE"):
        reported.add(2, topic="messages", names=["ATTITUDE", "NONSENSE"])


async def test_a_client_whose_output_fails_delays_no_other(reported: Told) -> None:
    (broken, _), (reader, _) = reported.add(1, topic="events"), reported.add(2, topic="events")
    broken.write = Mock(side_effect=RuntimeError("closed"))  # type: ignore[method-assign]
    reported.daemon.emit("warning", "alpha", "x")
    await settle()
    assert [n["event"]["text"] for n in reader.take()] == ["x"]


@pytest.mark.looptime
async def test_messages_that_waited_say_how_old_they_are(reported: Told) -> None:
    reader, subscription = reported.add(topic="messages")
    reader.writable = False
    reported.daemon.hear("ATTITUDE")
    await asyncio.sleep(1.5)
    reader.writable = True
    subscription.flush()
    assert reader.take()[0]["message"]["age_s"] == 1.5


@pytest.mark.looptime
async def test_messages_of_one_target_only(reported: Told) -> None:
    reader, _ = reported.add(topic="messages", targets="bravo")
    reported.daemon.hear("ATTITUDE", sysid=1)
    reported.daemon.hear("ATTITUDE", sysid=2)
    await settle()
    assert [n["message"]["vehicle"] for n in reader.take()] == ["bravo"]


@pytest.mark.looptime
async def test_the_rate_of_messages_is_limited_per_name_and_source(reported: Told) -> None:
    limited, _ = reported.add(1, topic="messages", rate_hz=2)
    full, _ = reported.add(2, topic="messages")
    for _ in range(100):
        for sysid in (1, 2):
            reported.daemon.hear("ATTITUDE", sysid=sysid)
        reported.daemon.hear("VFR_HUD")
        await asyncio.sleep(0.1)
    assert len(full.take()) == 300
    counts: dict[tuple[str, int], int] = {}
    for n in limited.take():
        key = (n["message"]["name"], n["message"]["sysid"])
        counts[key] = counts.get(key, 0) + 1
    assert set(counts) == {("ATTITUDE", 1), ("ATTITUDE", 2), ("VFR_HUD", 1)}
    assert all(count == 20 for count in counts.values()), counts


@each(
    "params",
    [
        {"topic": "nonsense"},
        {"topic": "telemetry", "rate_hz": 21},
        {"topic": "telemetry", "rate_hz": 0},
        {"topic": "events", "rate_hz": 1},
        {"topic": "messages", "names": []},
        {"topic": "messages", "names": [True]},
        {"topic": "messages", "names": ["X"] * 65},
        {"topic": "telemetry", "targets": []},
        {"topic": "telemetry", "targets": {"a": 1}},
    ],
)
def test_subscriptions_that_make_no_sense_are_refused(params: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        SubscribeParams.model_validate(params)
