"""The ground station as a companion sees it: which one, whether it is there, and its orders."""

from __future__ import annotations

import asyncio
import itertools
from types import SimpleNamespace
from typing import Any, cast

import pytest

from skygcs.core.protocols.command import Outcome
from skygcs.core.trajectory.trajectory_clock import ClockOrder
from skygcs.ext.companions.ground_choice import GROUND_SILENT_S, MAX_ADDRESSES, MAX_STATIONS, Candidate, GroundChoice
from skygcs.ext.companions.ground_contact import (
    LISTEN_S,
    MOST_STANDSTILLS,
    Action,
    ContactState,
    GroundContact,
    GroundLost,
)
from skygcs.ext.companions.ground_orders import GroundOrders
from support.table import each

# -- Which of the announced ground stations a companion sends to.


NEVER = float("inf")


def test_the_one_that_is_heard_stays_whatever_else_is_announced() -> None:
    choice = GroundChoice()
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    assert choice.decide(0.0, NEVER) == Candidate("lab", "udp", "10.0.0.1", 14650)
    choice.found("aaa", "udp", ["10.0.0.66"], 14650)  # before it by name
    assert choice.decide(100.0, 1.0) == Candidate("lab", "udp", "10.0.0.1", 14650)
    choice.gone("lab")  # a false goodbye does not part them either
    assert choice.decide(101.0, 1.0) == Candidate("lab", "udp", "10.0.0.1", 14650)


def test_each_address_is_tried_for_a_while_until_one_is_heard() -> None:
    choice = GroundChoice()
    choice.found("a", "udp", ["10.0.0.1", "192.168.1.1"], 14650)
    choice.found("b", "tcp", ["10.0.0.2"], 5770)
    tried = []
    for step in range(4):
        found = choice.decide(step * GROUND_SILENT_S, NEVER)
        assert choice.decide(step * GROUND_SILENT_S + GROUND_SILENT_S / 2, NEVER) == found
        tried.append(None if found is None else found.host)
    assert tried == ["10.0.0.1", "192.168.1.1", "10.0.0.2", "10.0.0.1"]


def test_one_that_moves_is_followed_when_it_is_silent() -> None:
    choice = GroundChoice()
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    choice.decide(0.0, NEVER)
    choice.found("lab", "udp", ["10.0.0.9"], 14650)
    heard = choice.decide(60.0, 1.0)
    assert heard is not None and heard.host == "10.0.0.1"
    moved = choice.decide(70.0, 10.0)
    assert moved is not None and moved.host == "10.0.0.9"


def test_the_only_one_stays_although_it_is_silent() -> None:
    choice = GroundChoice()
    assert choice.decide(0.0, NEVER) is None
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    for now in (0.0, 100.0, 200.0):
        assert choice.decide(now, NEVER) is not None
    choice.gone("lab")
    assert choice.decide(300.0, NEVER) == Candidate("lab", "udp", "10.0.0.1", 14650)


def test_only_the_named_station_is_followed() -> None:
    choice = GroundChoice("lab")
    choice.found("other", "udp", ["10.0.0.66"], 14650)
    assert choice.decide(0.0, NEVER) is None
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    assert choice.decide(1.0, NEVER) is not None
    assert choice.ignored == 1


@each(
    ("transport", "hosts", "port"),
    [
        ("udp", [], 14650),
        ("udp", ["0.0.0.0"], 14650),
        ("udp", ["224.0.0.1", "::", "ff02::1"], 14650),
        ("udp", ["lab.example", "10.0.0"], 14650),
        ("quic", ["10.0.0.1"], 14650),
        ("udp", ["10.0.0.1"], 0),
        ("udp", ["10.0.0.1"], 65536),
    ],
)
def test_announcements_of_no_use_are_ignored(transport: str, hosts: list[str], port: int) -> None:
    choice = GroundChoice()
    choice.found("x", transport, hosts, port)
    assert (choice.candidates, choice.ignored) == ([], 1)


def test_a_flood_of_announcements_takes_no_memory() -> None:
    choice = GroundChoice()
    for number in range(MAX_STATIONS + 50):
        choice.found(f"s{number}", "udp", [f"10.0.{i}.1" for i in range(MAX_ADDRESSES + 20)], 14650)
    assert len(choice.candidates) == MAX_STATIONS * MAX_ADDRESSES
    assert choice.ignored == 50
    choice.found("s3", "udp", ["10.9.9.9"], 14650)  # a known one may change
    assert Candidate("s3", "udp", "10.9.9.9", 14650) in choice.candidates


# -- What a companion does without the ground; all rows of the table.


LOST_S = 5.0


def ticks(
    watch: GroundContact,
    begin: float,
    end: float,
    *,
    contact_at: float | None = None,
    follows: bool = False,
    controlled: bool = True,
) -> list[tuple[float, Action]]:
    """What is ordered, five ticks a second. ``contact_at`` None: contact all the time."""
    found = []
    for k in range(round((end - begin) * 5)):
        now = begin + k / 5
        at = now if contact_at is None else contact_at
        action = watch.tick(now, controlled=controlled, follows=follows, contact_at=at)
        if action is not None:
            found.append((now, action))
    return found


@each("action", ["return", "hold", "land"])
@each("follows", [True, False])
def test_it_acts_once_after_the_silence(action: GroundLost, follows: bool) -> None:
    watch = GroundContact(action, LOST_S)
    assert ticks(watch, 0.0, 20.0) == []
    ((at, ordered),) = ticks(watch, 20.0, 60.0, contact_at=19.8, follows=follows)
    assert ordered == action and at == pytest.approx(24.8, abs=0.21)
    assert watch.state is ContactState.ACTED and watch.lost
    # the order was denied, and the ground is back: its next loss is another one
    assert ticks(watch, 60.0, 70.0) == [] and not watch.lost
    assert [ordered for _, ordered in ticks(watch, 70.0, 90.0, contact_at=70.0)] == [action]


def test_finish_waits_for_the_end_and_once_more_for_the_ground() -> None:
    watch = GroundContact("finish", LOST_S)
    ticks(watch, 0.0, 10.0, follows=True)
    assert ticks(watch, 10.0, 40.0, contact_at=10.0, follows=True) == []
    assert watch.state is ContactState.FINISHING
    ((at, action),) = ticks(watch, 40.0, 60.0, contact_at=10.0)
    assert action == "return" and at == pytest.approx(45.0, abs=0.21)


def test_finish_without_a_trajectory_returns_at_once() -> None:
    watch = GroundContact("finish", LOST_S)
    ticks(watch, 0.0, 10.0)
    ((at, action),) = ticks(watch, 10.0, 30.0, contact_at=10.0)
    assert action == "return" and at == pytest.approx(15.0, abs=0.21)


@each("action", ["return", "hold", "land", "finish"])
def test_a_standstill_of_the_companion_is_no_silence_of_the_ground(action: GroundLost) -> None:
    """A board that throttled for 3 s brought its vehicle home, though the ground had spoken all the time."""
    watch = GroundContact(action, 2.0)
    assert ticks(watch, 0.0, 10.0) == []
    for end in (13.0, 13.4, 16.6):  # what waited is read a moment after it goes on, if the ground is there
        assert ticks(watch, end, end + 0.4, contact_at=10.0) == []
        assert ticks(watch, end + 0.4, end + 0.6) == [] and watch.state is ContactState.WATCHED
    ((at, _),) = ticks(watch, 20.0, 30.0, contact_at=16.8)
    assert at == 20.0 + LISTEN_S, "it is lost after a standstill, too"


@each("period_s", [0.6, 1.5, 3.0])
def test_a_companion_that_is_late_at_every_tick_loses_the_ground_all_the_same(period_s: float) -> None:
    watch = GroundContact("hold", LOST_S)
    times = [k * period_s for k in range(40)]
    heard = [watch.tick(now, controlled=True, follows=False, contact_at=now) for now in times]
    silent = [watch.tick(times[-1] + now, controlled=True, follows=False, contact_at=times[-1]) for now in times[1:]]
    assert set(heard) == {None} and silent.count("hold") == 1


def test_so_many_standstills_are_forgiven_after_each_contact_and_no_more() -> None:
    watch = GroundContact("hold", 2.0)
    for k in range(2 * MOST_STANDSTILLS):
        assert ticks(watch, 20.0 * k, 20.0 * k + 10.0) == []
        assert ticks(watch, 20.0 * k + 13.0, 20.0 * k + 13.8, contact_at=20.0 * k + 9.8) == []
    ticks(watch, 200.0, 202.0)
    late = [watch.tick(202.0 + 3.0 * k, controlled=True, follows=False, contact_at=201.8) for k in range(1, 6)]
    assert late.index("hold") == MOST_STANDSTILLS


@each("follows", [True, False])
def test_a_ground_that_comes_back_before_the_order_goes_on(follows: bool) -> None:
    watch = GroundContact("finish", LOST_S)
    ticks(watch, 0.0, 10.0, follows=True)
    ticks(watch, 10.0, 17.0, contact_at=10.0, follows=True)
    assert watch.state is ContactState.FINISHING
    if not follows:
        ticks(watch, 17.0, 18.0, contact_at=10.0)
        assert watch.state is ContactState.WAITING
    assert ticks(watch, 18.0, 40.0, follows=follows) == []
    assert watch.state is ContactState.WATCHED


@each(("action", "follows"), list(itertools.product(["return", "hold", "land", "finish"], [True, False])))
def test_without_control_nothing_is_ever_ordered(action: GroundLost, follows: bool) -> None:
    watch = GroundContact(action, LOST_S)
    assert ticks(watch, 0.0, 60.0, contact_at=-100.0, follows=follows, controlled=False) == []
    ticks(watch, 60.0, 62.0)
    assert ticks(watch, 62.0, 90.0, contact_at=61.8, controlled=False) == [], "a pilot took it in the silence"
    assert watch.state is ContactState.IDLE


def test_the_silence_counts_from_the_begin_of_control() -> None:
    """Control that begins while the last contact is old has its time, too."""
    watch = GroundContact("hold", LOST_S)
    assert ticks(watch, 100.0, 103.0, contact_at=0.0) == [] and watch.silence_s(103.0, 0.0) == 3.0
    ((at, _),) = ticks(watch, 103.0, 120.0, contact_at=0.0)
    assert watch.silence_s(120.0, 100.0) == 20.0
    assert at == pytest.approx(105.0, abs=0.21)


# -- The orders of one ground end, or go on, when another one gets the companion.


IDS = 255, 25


@pytest.mark.looptime
async def test_an_order_of_another_ground_is_not_confused_with_one_that_has_its_number(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    loop = asyncio.get_running_loop()
    ends = {"old": loop.create_future(), "new": loop.create_future()}
    fleet = cast(Any, SimpleNamespace(vehicles={}, origin=None))
    orders = GroundOrders("v1", "hold", 5.0, fleet, loop, lambda event: None)

    async def carry_out(number: int, order: str, given: dict[str, Any]) -> Outcome:
        return Outcome(True, "accepted", await ends[given["ends"]])

    def ask(ground: str, ends: str) -> asyncio.Task[dict[str, Any]]:
        return asyncio.create_task(orders.order(ground, orders.book.session, 3, 1e9, "gains", {"ends": ends}))

    monkeypatch.setattr(orders, "_carry_out", carry_out)
    orders.contact("one", IDS)
    ask("one", "old")
    await asyncio.sleep(6)
    orders._early = 7, {8: ClockOrder("pause", 1.0)}
    orders.contact("another", IDS)
    assert orders._early == (0, {}), "its numbers name no flight of the other one"
    asked = [ask("another", "new")]
    ends["old"].set_result("of the one before")
    await asyncio.sleep(1)
    asked.append(ask("another", "new"))
    await asyncio.sleep(1)
    ends["new"].set_result("its own")
    assert [(await one)["outcome"]["message"] for one in asked] == ["its own", "its own"]
