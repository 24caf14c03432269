"""Vehicles that are ordered to return together, and whose ways home conflict, leave one after another."""

from __future__ import annotations

import asyncio
from pathlib import Path
from unittest import mock

import pytest

from skygcs.runtime import returns
from skygcs.runtime.vehicle_actor import VehicleActor
from skygcs.sim.conditions import conditions_of
from skygcs.sim.firmware_modes import CopterMode
from support.flown import GOING_HOME, PAIRS, Flown, aloft, flown
from support.planned import MARGIN_M, least_distance
from support.returning import all_down, swapped

COSTS = "returns of several vehicles one after another, each from its take-off to its landing"

WINDY = conditions_of(wind_mps=6.0)


@PAIRS
async def test_two_that_have_changed_places_come_home_apart(tmp_path: Path, kind: dict[str, int]) -> None:
    """They passed at .10 m (PX4) and .21 m (ArduCopter)."""
    async with aloft(tmp_path, conditions=WINDY, **kind) as gcs:
        await swapped(gcs)
        since = gcs.now
        mode = "rtl" if "ardupilot" in kind else "Return"  # one order, by whatever name of its mode
        outcomes = (await gcs("vehicles.mode", targets="all", mode=mode))["outcomes"]
        assert all(outcome["ok"] for outcome in outcomes.values()), "it is never refused"
        assert outcomes["v1"]["message"] == "it holds until v2 is out of its way home, and returns then"
        await all_down(gcs)
        assert least_distance(gcs, since)[0] > MARGIN_M
        assert any("it climbs by" in text for name in ("v1", "v2") for text in gcs.texts(since, "command", name))


@pytest.mark.parametrize("kind", [{"px4": 3}, {"px4": 0, "ardupilot": 3}], ids=["px4", "ardupilot"])
async def test_one_that_waits_where_another_one_flies_through_gets_out_of_its_way(
    tmp_path: Path, kind: dict[str, int]
) -> None:
    """It held there until the other one had flown into it (random flight 54). Its climb is a way, too."""
    async with aloft(tmp_path, **kind) as gcs:
        for name, x, y, up in (("v3", 10.0, 25.0, 18.0), ("v2", 20.0, 0.0, 10.0)):
            await gcs.done("vehicles.goto", targets=name, enu_m=[x, y, up], force=True)
        await asyncio.sleep(18.0)
        await gcs.fly("position", "v1")
        (x, y, up), t = gcs.place("v1"), 80.0
        along = [x, 0.0, 3 * 40.0 / t**2, -2 * 40.0 / t**3]
        await gcs("trajectory.load", target="v1", pieces=[{"duration_s": t, "x": along, "y": [y], "up": [up]}])
        await gcs.done("trajectory.start", targets="v1", force=True)
        since = gcs.now
        outcome = await gcs.outcome("vehicles.rtl", "v2")
        assert "it holds until v1 is out of its way home" in outcome["message"]
        await gcs.until(lambda: any("it climbs by" in text for text in gcs.texts(since, "command", "v2")))
        refused = await gcs.outcome("vehicles.goto", "v3", enu_m=[30.0, -25.0, 18.0])
        assert refused["result"] == "refused" and "near v2" in refused["message"], refused
        await gcs.until(lambda: gcs.place("v1")[0] > 35.0, 80.0)
        assert least_distance(gcs, since)[0] > MARGIN_M


@PAIRS
async def test_one_does_not_stop_before_another_that_follows_it(tmp_path: Path, kind: dict[str, int]) -> None:
    """It held at once, and the other one passed it at 1.3 m (random flight 58)."""
    async with aloft(tmp_path, **kind) as gcs:
        x, y, up = gcs.place("v1")
        await gcs.done("vehicles.goto", targets="all", enu_m=[x - 60.0, y, up])
        await gcs.until(lambda: gcs.place("v1")[0] < x - 12.0, 20.0)
        since = gcs.now
        outcome = await gcs.outcome("vehicles.rtl", "v1")
        assert outcome["message"].startswith("it flies on while v2 flies to where it would stop"), outcome
        await gcs.until(lambda: gcs.sim("v1").motion.on_ground, 150.0)
        assert least_distance(gcs, since)[0] > MARGIN_M
        assert gcs.place("v1")[0] == pytest.approx(x, abs=2.0)


async def test_one_before_another_that_flies_on_flies_on_too_and_is_given_up_if_it_is_not_heard(tmp_path: Path) -> None:
    """It held at once, as both were to hold, and v2 came as near as 1.7 m. What was not heard waited for good."""
    async with aloft(tmp_path, px4=3) as gcs:
        x, y, up = gcs.place("v1")
        await gcs.done("vehicles.goto", targets="v1,v2", enu_m=[x - 57.5, y, up])
        await gcs.until(lambda: gcs.place("v1")[0] < x - 15.0, 20.0)
        await gcs.done("vehicles.goto", targets="v3", enu_m=[gcs.place("v2")[0], y, up], force=True)
        since = gcs.now
        outcomes = (await gcs("vehicles.rtl", targets="v1,v2"))["outcomes"]
        assert [o["message"].split(" fl")[1] for o in outcomes.values()] == ["ies on while v2", "ies on while v3"]
        gcs.muted.add(1)
        await asyncio.sleep(0.6)
        assert not gcs.commands(since, "v1")
        await gcs.until(lambda: any("it is not heard: it flies on" in t.text for t in gcs.told), 200.0)
        gcs.muted.clear()
        await asyncio.sleep(20.0)
        assert not gcs.commands(since, "v1"), "nobody has ordered that now"
        assert least_distance(gcs, since)[0] > MARGIN_M


@pytest.mark.deep
async def test_the_watchdog_brings_them_home_the_same_way(tmp_path: Path) -> None:
    settings = {"operator_timeout_s": 20.0, "operator_lost": "rtl"}
    async with aloft(tmp_path, px4=1, ardupilot=1, settings=settings, conditions=WINDY) as gcs:
        await swapped(gcs)
        await gcs.fly("position", "v1,v2")
        since = gcs.now
        await all_down(gcs)
        assert least_distance(gcs, since)[0] > MARGIN_M
        assert any("rtl for v1, v2" in t.text for t in gcs.told if t.kind == "warning")


@pytest.mark.deep  # flies home what nothing is in the way of
async def test_one_alone_and_those_in_nobodys_way_leave_at_once_as_before(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=1, ardupilot=2) as gcs:
        for name in ("v1", "v2", "v3"):
            await gcs.step(0.0, 20.0, 0.0, name=name)
        await asyncio.sleep(12.0)
        since = gcs.now
        outcomes = (await gcs("vehicles.rtl", targets="v1"))["outcomes"]
        assert outcomes["v1"]["message"] == "returning to launch"
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        assert {outcome["message"] for outcome in outcomes.values()} == {"returning to launch"}
        assert {int(s.values["command"]) for i in (1, 2, 3) for s in gcs.commands(since, f"v{i}")} == {20}
        await all_down(gcs)


@pytest.mark.deep
async def test_one_that_is_taken_by_its_own_failsafe_is_not_in_our_hands(tmp_path: Path) -> None:
    """While it waits its battery becomes critical: nothing holds it, and the other leaves when it is clear."""
    async with aloft(tmp_path, px4=0, ardupilot=2, conditions=WINDY) as gcs:
        await swapped(gcs)
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        waits = next(name for name, outcome in outcomes.items() if "it holds until" in outcome["message"])
        since = gcs.now
        gcs.other_sets_mode(int(CopterMode.RTL), sysid=int(waits[1:]))  # as its failsafe does
        await gcs.until(lambda: gcs.sim(waits).mode == CopterMode.RTL, 5.0)
        await gcs.until(
            lambda: any("does not wait any more: it is in RTL" in t for t in gcs.texts(since, "command", waits))
        )
        assert not gcs.commands(gcs.now, waits)
        await all_down(gcs)


@pytest.mark.deep
async def test_what_waits_for_one_that_does_not_move_is_given_up_with_a_word(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=2, conditions=WINDY) as gcs:
        await swapped(gcs)
        since, name, other = gcs.now, "v1", "v2"
        await gcs("vehicles.rtl", targets="all")
        gcs.other_sets_mode(CopterMode.LOITER)  # its pilot takes it, and stays above the other's home
        await gcs.until(lambda: any("does not return" in t for t in gcs.texts(since, "command", other)), 150.0)
        (text,) = [t for t in gcs.texts(since, "command", other) if "does not return" in t]
        assert f"{name} stays in its way home" in text and f"skygcs-cli rtl {other}" in text
        quiet = gcs.now
        await asyncio.sleep(20.0)
        assert not gcs.commands(quiet, other) and gcs.is_safe(other)
        await gcs.done("vehicles.rtl", targets=other)  # insisted on
        assert gcs.sim(other).mode in GOING_HOME


@pytest.mark.deep  # flies several up again
async def test_another_order_takes_one_that_waits(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=2, conditions=WINDY) as gcs:
        await swapped(gcs)
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        waiting = [name for name, outcome in outcomes.items() if "it holds until" in outcome["message"]]
        await gcs.done("vehicles.land", targets=waiting[0])
        since = gcs.now
        other = {"v1": "v2", "v2": "v1"}[waiting[0]]
        await gcs.until(lambda: any("does not return" in t for t in gcs.texts(since, "command", other)), 150.0)
        assert not gcs.commands(since, waiting[0]) and not gcs.sim(waiting[0]).armed
        assert gcs.is_safe(other) and gcs.sim(other).armed, "the first has landed on its home"


@pytest.mark.deep
async def test_preflight_asks_for_return_heights_that_differ(tmp_path: Path) -> None:
    async with flown(tmp_path, px4=1, ardupilot=2, takeoff=False) as gcs:
        for sim, height_m in zip(gcs.sims, (15.0, 15.0, 30.0), strict=True):
            sim.params.set("RTL_RETURN_ALT", height_m)
            sim.params.set("RTL_ALT", 100.0 * height_m)
        reports = await gcs("preflight.run", targets="all")
        asked = {
            name: finding["text"]
            for name, report in reports["vehicles"].items()
            for finding in report["findings"]
            if finding["check"] == "return heights"
        }
        assert asked.keys() == {"v2"} and "RTL_ALT 2000 (20 m)" in asked["v2"], asked


async def test_three_in_each_others_ways_come_home_apart_although_the_order_is_repeated(tmp_path: Path) -> None:
    async with aloft(tmp_path, px4=0, ardupilot=3, conditions=WINDY) as gcs:
        homes = [gcs.place_of_home(f"v{n}") for n in (1, 2, 3)]
        for n, (x, _, _) in enumerate((*homes[1:], homes[0]), 1):  # each above the home of the next
            await gcs.done("vehicles.goto", targets=f"v{n}", enu_m=[x, 12.0 * n, 10.0 + 4.0 * n], force=True)
        await asyncio.sleep(15.0)
        for n, (x, y, _) in enumerate((*homes[1:], homes[0]), 1):
            await gcs.done("vehicles.goto", targets=f"v{n}", enu_m=[x, y, 10.0], force=True)
            await asyncio.sleep(12.0)
        since = gcs.now
        await gcs("vehicles.rtl", targets="all")
        await gcs.until(lambda: any(t.text.startswith("rtl: returning") for t in gcs.told), 90.0)
        await gcs("vehicles.rtl", targets="v2,v3")
        await all_down(gcs, 500.0)
        assert least_distance(gcs, since)[0] > MARGIN_M


@pytest.mark.parametrize("targets", ["v1", "v1,v3"])
async def test_one_that_hovers_in_the_way_home_is_flown_over(tmp_path: Path, targets: str) -> None:
    """It was not ordered to return, so that nobody looked at it: v1 flew through it."""
    async with aloft(tmp_path, px4=0, ardupilot=3, conditions=WINDY) as gcs:
        await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 30.0, 10.0], force=True)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[0.0, 15.0, 15.0], force=True)
        await asyncio.sleep(20.0)
        since = gcs.now
        outcome = (await gcs("vehicles.rtl", targets=targets))["outcomes"]["v1"]
        assert outcome["ok"] and outcome["message"].startswith("it holds until v2 is out of its way home"), outcome
        await gcs.until(lambda: not gcs.sim("v1").armed, 120.0)
        assert any("above v2, and returns then" in text for text in gcs.texts(since, "command", "v1"))
        assert least_distance(gcs, since)[0] > MARGIN_M


@pytest.mark.parametrize("by_pilot", [False, True])
async def test_one_alone_is_given_up_above_another_and_returns_when_it_is_ordered_again(
    tmp_path: Path, by_pilot: bool
) -> None:
    """A pilot who hovers there counted as one that moves, for 300 s; a double click sent it home into the other one."""
    async with aloft(tmp_path, px4=1, ardupilot=1) as gcs:
        await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 20.0, 10.0], force=True)
        await asyncio.sleep(12.0)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[0.0, 0.0, 6.0], force=True)  # above the home of v1
        await asyncio.sleep(12.0)
        if by_pilot:
            gcs.other_sets_mode(CopterMode.LOITER, sysid=2)
            await asyncio.sleep(2.0)
        since = gcs.now
        for _ in range(2):
            outcome = (await gcs("vehicles.rtl", targets="v1"))["outcomes"]["v1"]
            assert outcome["ok"] and "; ordered again (skygcs-cli rtl v1), it returns at once" in outcome["message"]
            assert gcs.now - since < returns.SAME_S
        await gcs.until(lambda: any("does not return" in t for t in gcs.texts(since, "command", "v1")), 150.0)
        assert gcs.now - since >= returns.STUCK_S, "v2 may be ordered away until then"
        (text,) = [t for t in gcs.texts(since, "command", "v1") if "does not return" in t]
        assert "v2 stays in its way home" in text and "skygcs-cli rtl v1" in text
        assert gcs.is_safe("v1")
        outcome = (await gcs("vehicles.rtl", targets="v1"))["outcomes"]["v1"]
        assert outcome["message"] == "returning to launch" and gcs.sim("v1").mode in GOING_HOME, "insisted on"


async def test_one_that_waits_is_insisted_on_by_orders_that_come_again_and_again(tmp_path: Path) -> None:
    """Each began the time of a double click anew, so a script that ordered it every half second never sent it home."""
    async with aloft(tmp_path, px4=1, ardupilot=1) as gcs:
        await gcs.done("vehicles.goto", targets="v1", enu_m=[0.0, 20.0, 10.0], force=True)
        await asyncio.sleep(12.0)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[0.0, 0.0, 6.0], force=True)  # above the home of v1
        await asyncio.sleep(12.0)
        since, told = gcs.now, list[str]()
        while gcs.now - since < 1.2 * returns.SAME_S:
            told.append((await gcs("vehicles.rtl", targets="v1"))["outcomes"]["v1"]["message"])
            await asyncio.sleep(returns.SAME_S / 3)
        assert told[-1] == "returning to launch" and told[0] != told[-1], told


async def test_one_alone_is_sent_home_at_once_if_nothing_is_seen_in_its_way(tmp_path: Path) -> None:
    """At 10 m/s it was held for one parked beside its home, and given up a second later: its way counted as wide as it
    needs to stop."""
    async with aloft(tmp_path, px4=0, ardupilot=2, conditions=WINDY) as gcs:
        home = gcs.place_of_home("v1")
        await gcs.done("vehicles.goto", targets="v2", enu_m=[home[0] + 2.0, -8.0, 10.0], force=True)
        await gcs.done("vehicles.goto", targets="v1", enu_m=[home[0], 40.0, 10.0], force=True)
        await asyncio.sleep(15.0)
        await gcs.done("vehicles.goto", targets="v2", enu_m=[home[0] + 2.0, 0.0, 10.0], force=True)
        await asyncio.sleep(8.0)
        await gcs.done("vehicles.land", targets="v2")
        await gcs.until(lambda: not gcs.sim("v2").armed, 60.0)
        await gcs.step(0.0, 150.0, 0.0)
        await asyncio.sleep(6.0)
        outcome = (await gcs("vehicles.rtl", targets="v1"))["outcomes"]["v1"]
        assert outcome["message"] == "returning to launch" and gcs.sim("v1").mode in GOING_HOME


def faults(gcs: Flown) -> list[str]:
    """Those that a test has made: `flown` allows none."""
    texts = [t.text for t in gcs.told if t.kind == "fault"]
    gcs.told[:] = [t for t in gcs.told if t.kind != "fault"]
    return texts


async def test_a_fault_in_the_decision_brings_them_home_one_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It sent nobody home."""
    async with aloft(tmp_path, px4=0, ardupilot=2) as gcs:
        monkeypatch.setattr(returns, "departing", mock.Mock(side_effect=ZeroDivisionError("of a test")))
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        assert outcomes["v1"]["message"] == "returning to launch", outcomes
        assert outcomes["v2"]["message"] == "it holds until v1 is out of its way home, and returns then"
        await gcs.until(lambda: not gcs.sim("v1").armed, 100.0)
        assert gcs.sim("v2").mode not in GOING_HOME
        await all_down(gcs)
        (text,) = faults(gcs)
        assert "they return one at a time" in text


async def test_a_fault_in_the_order_to_one_that_waited_keeps_it_in_the_air_no_longer_than_the_fault(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It held for good, and nobody was told."""
    async with aloft(tmp_path, ardupilot=2) as gcs:
        await swapped(gcs)
        await gcs("vehicles.rtl", targets="all")
        with monkeypatch.context() as faulty:
            faulty.setattr(VehicleActor, "rtl", mock.AsyncMock(side_effect=ZeroDivisionError("of a test")))
            await gcs.until(lambda: faults(gcs), 60.0)
        await all_down(gcs)


async def test_a_fault_before_the_decision_sends_each_home_by_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async with aloft(tmp_path, px4=2) as gcs:
        monkeypatch.setattr(returns, "is_placed", mock.Mock(side_effect=ZeroDivisionError("of a test")))
        outcomes = (await gcs("vehicles.rtl", targets="all"))["outcomes"]
        assert {outcome["message"] for outcome in outcomes.values()} == {"returning to launch"}
        (text,) = faults(gcs)
        assert "each returns at once" in text
