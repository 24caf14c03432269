"""The stages of `up`: each that does not hold is named with what to do, and ends the way of its vehicle."""

from __future__ import annotations

from typing import Any

import pytest

from skygcs.errors import CompanionError
from skygcs.ext.companions.bring_up.ground_view import GroundView
from skygcs.ext.companions.bring_up.readiness import STAGES, BringUp, Candidate
from skygcs.ext.companions.bring_up.side_by_side import Progress, side_by_side
from support.fake_companion import FakeSession, companion

pytestmark = pytest.mark.looptime

PASSED = {"check": "gps", "verdict": "pass", "text": "3D fix", "todo": ""}
FAILED = {"check": "gps", "verdict": "fail", "text": "no GPS fix", "todo": "wait in the open"}


class FakeDaemon:
    def __init__(self, *names: str) -> None:
        self.vehicles = [{"name": n, "connected": True, "armed": False, "landed": "on_ground"} for n in names]
        self.reports: list[dict[str, Any]] = [{"ok": True, "in_air": False, "findings": [PASSED]}]
        self.links = [{"name": "wifi", "state": "up"}]

    async def call(self, method: str, /, **params: Any) -> Any:
        match method:
            case "vehicles.list":
                return self.vehicles
            case "links.list":
                return self.links
        report = self.reports.pop(0) if len(self.reports) > 1 else self.reports[0]
        return {"vehicles": {params["targets"]: report}}


async def brought_up(
    session: FakeSession, daemon: FakeDaemon | None, *, on_board: bool = True, wait_s: float = 30.0
) -> Progress:
    ground = GroundView(daemon, "no skygcs daemon at s")
    candidate = Candidate("alpha", "alpha", 1, companion() if on_board else None)
    async with ground.watching():
        work = BringUp(session.connect, ground, version="0.1.0", content="0123abcd4567", wait_s=wait_s).run
        return (await side_by_side([candidate], work, timeout_s=1000))["alpha"]


async def test_a_companion_that_is_well_goes_through_all_stages_and_its_service_is_started() -> None:
    session = FakeSession()
    progress = await brought_up(session, FakeDaemon("alpha"))
    assert (progress.ok, progress.message) == (True, "ready, 1 checks passed")
    assert tuple(progress.data["stages"]) == STAGES
    assert all(entry["ok"] for entry in progress.data["stages"].values())
    assert session.ran("systemctl --user start skygcs")


@pytest.mark.parametrize("content", ["0123abcd4567", ""])
async def test_the_same_code_and_unknown_code_go_on(content: str) -> None:
    assert (await brought_up(FakeSession(content=content), FakeDaemon("alpha"))).ok


async def test_a_service_that_runs_is_left_alone() -> None:
    session = FakeSession(state="active")
    assert (await brought_up(session, FakeDaemon("alpha"))).ok
    assert not session.ran("systemctl")


@pytest.mark.parametrize(
    ("facts", "stage", "words"),
    [
        ({"program": ""}, "version", "not installed there; skygcs-cli companions install alpha"),
        ({"version": "skygcs 0.0.9"}, "version", "skygcs 0.0.9 there, 0.1.0 here"),
        (
            {"content": "89ef89ef89ef"},
            "version",
            "0.1.0 there and here, but other code: 89ef89ef89ef there, 0123abcd4567",
        ),
        ({"free_kb": "1000"}, "disk", "1 MB free in /home/pi"),
        ({"unit": "none"}, "service", "is not installed there"),
    ],
)
async def test_what_is_missing_on_board_is_named_and_nothing_is_started(
    facts: dict[str, str], stage: str, words: str
) -> None:
    session = FakeSession(**facts)
    progress = await brought_up(session, FakeDaemon("alpha"))
    assert progress.ok is False and words in progress.message
    assert list(progress.data["stages"])[-1] == stage and not progress.data["stages"][stage]["ok"]
    assert not session.ran("start skygcs")


async def test_a_service_that_does_not_start_is_named_with_the_last_line_of_its_log() -> None:
    session = FakeSession()
    session.answer("start skygcs", 1, stderr="Job for skygcs.service failed.\n")
    session.answer("journalctl", 0, "fleet file: 1 problem\n")
    progress = await brought_up(session, FakeDaemon("alpha"))
    assert "start failed: Job for skygcs.service failed.; its log: fleet file: 1 problem" in progress.message


async def test_a_link_on_board_that_does_not_come_up_is_named_with_its_error() -> None:
    session = FakeSession()
    session.answer("links", 0, '[{"name": "autopilot", "state": "waiting", "last_error": "/dev/ttyACM0: no device"}]')
    progress = await brought_up(session, FakeDaemon("alpha"))
    assert progress.message.startswith("links: on the companion, link autopilot is not up: /dev/ttyACM0: no device")


@pytest.mark.parametrize(
    ("there", "words"),
    [
        ("[]", "neither the companion nor the ground hears its autopilot"),
        ('[{"name": "v9", "sysid": 9, "connected": true}]', "hears system id 9, not 1"),
        ('[{"name": "alpha", "sysid": 1, "connected": true}]', "the companion hears alpha, the ground does not"),
    ],
)
async def test_a_vehicle_that_is_not_heard_is_looked_for_on_board(there: str, words: str) -> None:
    session = FakeSession()
    session.answer("status", 0, there)
    progress = await brought_up(session, FakeDaemon())
    assert progress.ok is False and words in progress.message


async def test_a_vehicle_without_companion_begins_with_being_heard() -> None:
    progress = await brought_up(FakeSession(), FakeDaemon("alpha"), on_board=False)
    assert progress.ok and tuple(progress.data["stages"]) == ("heard", "preflight")


async def test_a_preflight_is_asked_again_until_it_passes() -> None:
    daemon = FakeDaemon("alpha")
    daemon.reports.insert(0, {"ok": False, "in_air": False, "findings": [FAILED]})
    assert (await brought_up(FakeSession(), daemon)).ok
    daemon.reports = [{"ok": False, "in_air": False, "findings": [FAILED, FAILED]}]
    progress = await brought_up(FakeSession(), daemon)
    assert progress.message.startswith("preflight: no GPS fix (and 1 more: skygcs-cli preflight alpha); wait in")


async def test_without_a_daemon_on_the_ground_nothing_is_heard() -> None:
    progress = await brought_up(FakeSession(), None)
    assert progress.ok is False and "no skygcs daemon at s" in progress.message
    assert progress.data["stages"]["service"]["ok"]


async def test_one_that_hangs_or_fails_leaves_the_others_alone() -> None:
    import asyncio

    async def work(target: Candidate, progress: Progress) -> str:
        progress.step = "waiting for it"
        if target.name == "slow":
            await asyncio.sleep(1e6)
        if target.name == "faulty":
            raise ZeroDivisionError("here")
        if target.name == "refused":
            raise CompanionError("disk", "full", "remove logs")
        return "done"

    names = ("slow", "faulty", "refused", "good")
    done = await side_by_side([Candidate(n, n, 1, None) for n in names], work, at_once=2, timeout_s=5)
    assert {name: progress.message for name, progress in done.items()} == {
        "slow": "waiting for it: not done within 5 s (--timeout)",
        "faulty": "internal error: ZeroDivisionError: here (set SKYGCS_DEBUG=1 to see where)",
        "refused": "disk: full; remove logs",
        "good": "done",
    }
    assert done["slow"].outcome()["elapsed_s"] == 5
