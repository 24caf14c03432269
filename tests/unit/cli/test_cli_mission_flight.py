"""`mission` and `fence` with a daemon: what is asked of it, what is printed and written."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli.main import app
from skygcs.core.mission.formats import read_plan
from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.mission.plan import MissionPlan, PlannedHome
from support.command_line import Served
from support.fake_daemon import FakeDaemon, FakeOutcome
from support.table import each

DONE, FAILED, USAGE, UNREACHABLE = 0, 1, 2, 3
PLAN = MissionPlan(
    mission=(MissionItem.from_params(22, 3, (0.0, 0.0, 0.0, None, 43.78, -79.46, 10.0), True),),
    rally=(MissionItem.from_params(5100, 3, (0.0, 0.0, 0.0, 0.0, 43.78, -79.46, 10.0), True),),
    home=PlannedHome(43.78, -79.46, 180.0),
)
WPL = "QGC WPL 110\n0 1 0 16 0 0 0 0 43.78 -79.46 180 1\n1 0 3 22 0 0 0 0 43.78 -79.46 10 1\n"


class Site(Served[FakeDaemon]):
    def __init__(self, folder: Path) -> None:
        self.folder = folder
        super().__init__(folder, FakeDaemon())

    def when_followed(self, happen: Callable[[], None]) -> None:
        """Do it as soon as somebody follows the events."""

        def look() -> None:
            if self.daemon.followed:
                happen()
            else:
                self.loop.call_later(0.05, look)

        self.loop.call_soon_threadsafe(look)

    def asked(self, name: str = "alpha") -> tuple[str, dict[str, Any]]:
        return self.daemon.vehicle(name).orders[-1]

    def file(self, name: str, text: str) -> Path:
        path = self.folder / name
        path.write_text(text)
        return path


@pytest.fixture
def site(tmp_path: Path) -> Iterator[Site]:
    with Site(tmp_path) as site:
        yield site


def test_a_plan_is_uploaded_with_the_lists_that_it_holds(site: Site) -> None:
    site.run("mission", "upload", "all", site.file("a.waypoints", WPL))
    order, arguments = site.asked()
    assert order == "upload_plan"
    assert arguments["kinds"] == (MissionType.MISSION,) and arguments["force"] is False
    assert [item.command for item in arguments["plan"].mission] == [22]
    assert site.asked("bravo")[0] == "upload_plan"


def test_only_the_fence_of_a_plan_is_uploaded_by_fence_upload(site: Site) -> None:
    site.run("fence", "upload", "alpha", site.file("a.waypoints", WPL), "--force")
    assert site.asked()[1]["kinds"] == (MissionType.FENCE,)
    assert site.asked()[1]["force"] is True


def test_a_file_that_is_no_plan_is_refused_without_a_daemon(site: Site) -> None:
    path = site.file("a.waypoints", "QGC WPL 120\n")
    result = CliRunner().invoke(app, ["--socket", str(site.folder / "none"), "mission", "upload", "all", str(path)])
    assert result.exit_code == FAILED and "line 1: version 120" in result.output
    good = site.file("b.waypoints", WPL)
    result = CliRunner().invoke(app, ["--socket", str(site.folder / "none"), "mission", "upload", "all", str(good)])
    assert result.exit_code == UNREACHABLE


def test_a_refused_upload_is_reported_per_vehicle_and_fails(site: Site) -> None:
    site.daemon.vehicle("alpha").outcome = FakeOutcome(False, "refused", "refused: mission item 2: too far")
    said = site.run("mission", "upload", "alpha", site.file("a.waypoints", WPL), code=FAILED)
    assert "FAIL" in said and "mission item 2: too far" in said


@each(("name", "lists"), [("a.plan", ()), ("a.waypoints", ("--only", "mission"))])
def test_what_is_downloaded_is_written_in_the_format_of_its_name(site: Site, name: str, lists: tuple[str, ...]) -> None:
    site.daemon.vehicle("alpha").stored_plan = PLAN
    path = site.folder / name
    assert "written to" in site.run("mission", "download", "alpha", path, *lists)
    assert read_plan(path.read_bytes(), name).plan.mission == PLAN.mission
    said = site.run("mission", "download", "alpha", path, *lists, code=FAILED)
    assert "exists; --force overwrites it" in said
    site.run("mission", "download", "alpha", path, *lists, "--force")


def test_without_a_file_the_items_are_reported(site: Site) -> None:
    site.daemon.vehicle("alpha").stored_plan = PLAN
    said = site.run("mission", "download", "alpha")
    assert "mission    1     22  frame  3  0 0 0 - 43.78 -79.46 10" in said
    answer = json.loads(site.run("mission", "download", "alpha", "--json"))
    assert answer["rally"][0]["command"] == 5100
    assert read_plan(answer["plan"].encode(), "x").plan == PLAN


def test_a_failed_download_writes_nothing(site: Site) -> None:
    site.daemon.vehicle("alpha").outcome = FakeOutcome(False, "timeout", "mission: no answer")
    path = site.folder / "a.plan"
    assert "no answer" in site.run("mission", "download", "alpha", path, code=FAILED)
    assert not path.exists()


@each(
    ("args", "order"),
    [
        (("mission", "clear", "alpha"), ("clear_plan", {"kinds": (MissionType.MISSION,), "force": False})),
        (("fence", "clear", "alpha", "--force"), ("clear_plan", {"kinds": (MissionType.FENCE,), "force": True})),
        (("mission", "start", "alpha", "--first", "3"), ("start_mission", {"first": 3, "arm": True, "force": False})),
        (("mission", "start", "alpha", "--no-arm"), ("start_mission", {"first": 1, "arm": False, "force": False})),
        (("mission", "pause", "alpha"), ("hold", {})),
        (("mission", "resume", "alpha"), ("resume_mission", {"force": False})),
        (("mission", "current", "alpha", "4"), ("set_mission_item", {"item": 4, "force": False})),
    ],
)
def test_orders_ask_for_what_they_say(site: Site, args: tuple[str, ...], order: tuple[str, dict[str, Any]]) -> None:
    assert "ok" in site.run(*args)
    assert site.asked() == order


def test_item_0_is_usage(site: Site) -> None:
    site.run("mission", "current", "alpha", "0", code=USAGE)


def test_status_shows_item_and_transfer_of_each_vehicle(site: Site) -> None:
    reported = site.daemon.vehicle("alpha").missions.told
    reported.update(item=3, reached=2, state="active", transfer={"what": "fence upload", "percent": 40, "sent": 9})
    reported["counts"]["mission"] = 12
    said = site.run("mission", "status")
    assert "alpha       item 3 of 12  reached 2  active  fence upload 40 %" in said
    assert "bravo       no current item reported yet" in said
    site.daemon.vehicle("bravo").missions.told["counts"]["mission"] = 0
    assert "bravo       no mission" in site.run("mission", "status", "bravo")
    site.daemon.vehicle("bravo").missions.told |= {"item": 1, "state": "no mission", "counts": {"mission": None}}
    assert site.run("mission", "status", "bravo") == "bravo       no mission\n"
    assert json.loads(site.run("mission", "status", "alpha", "--json"))[0]["item"] == 3


def test_watch_shows_the_status_and_then_what_concerns_missions(site: Site) -> None:
    def happen() -> None:
        emit = site.daemon.emit
        emit("mission", "bravo", "reached item 9")
        emit("command", "alpha", "arm: accepted", order="arm")
        emit("command", "alpha", "mission upload: in progress 10 %", order="mission upload")
        emit("mission", "alpha", "reached item 2 of 4", reached=2)

    site.when_followed(happen)
    lines = site.run("mission", "watch", "alpha", "--count", "2").splitlines()
    wanted = ["       no current item reported yet", ": mission upload: in progress 10 %", ": reached item 2 of 4"]
    assert [line.rpartition("alpha")[2] for line in lines] == wanted


def test_fence_status_shows_what_is_held_and_breaches(site: Site) -> None:
    alpha = site.daemon.vehicle("alpha")
    alpha.missions.told["counts"]["fence"] = 5
    said = site.run("fence", "status", "alpha")
    assert "5 fence items" in said and "1.2 m from home" in said and "breach" not in said
    assert "polygons and circles not read yet" in site.run("fence", "status", "bravo")
    alpha.fence |= {"breached": True, "breaches": 2, "follows_list": False, "last_text": "Circle fence breached"}
    said = site.run("fence", "status", "alpha", code=FAILED)
    assert "not enforced" in said and "2 breaches since boot" in said and 'last text "Circle fence breached"' in said
    reported = json.loads(site.run("fence", "status", "alpha", "--json", code=FAILED))
    assert reported["outcomes"]["alpha"]["fence_items"] == 5


def test_a_fence_is_set_by_what_is_given(site: Site) -> None:
    site.run("fence", "set", "alpha", "--radius", "40", "--action", "return")
    assert site.asked() == ("set_fence", {"radius_m": 40.0, "height_m": None, "action": "return", "force": False})
    assert "give --radius" in site.run("fence", "set", "alpha", code=USAGE)
    site.run("fence", "set", "alpha", "--action", "explode", code=USAGE)
    site.run("fence", "set", "alpha", "--radius", "-1", code=USAGE)
    site.run("fence", "set", "alpha", "--height", "nan", code=USAGE)


def test_a_fence_is_tested_only_after_the_propellers_are_confirmed_off(site: Site) -> None:
    said = site.run("fence", "test", "alpha", code=FAILED)
    assert "Take the propellers off" in said and "--yes" in said
    assert site.daemon.vehicle("alpha").orders == []
    said = site.run("fence", "test", "alpha", "--yes", "--radius", "3")
    assert site.asked() == ("test_fence", {"radius_m": 3.0, "action": "return", "timeout_s": 120.0})
    assert "recorded in logs/fence-test-alpha.json" in said
    reported = json.loads(site.run("fence", "test", "alpha", "--yes", "--json"))
    assert reported["outcomes"]["alpha"]["record"]["file"]


def test_a_plan_with_a_wrong_version_is_a_wrong_parameter_of_the_rpc(site: Site) -> None:
    call = json.dumps({"targets": "all", "plan": "QGC WPL 1", "name": "x.txt"})
    assert "x.txt: line 1: version 1" in site.run("call", "missions.upload", call, code=USAGE)
