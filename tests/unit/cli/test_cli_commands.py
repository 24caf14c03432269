"""Every command against a fake daemon: what it asks, what it prints, how it exits."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from skygcs.cli import orders
from skygcs.cli.main import app
from skygcs.cli.origin import zero_in_the_air
from skygcs.events import Event
from skygcs.rpc.client import EVENT_KINDS
from support.command_line import Served, said
from support.fake_daemon import FakeDaemon, FakeOutcome
from support.table import each

DONE, FAILED, USAGE, UNREACHABLE = 0, 1, 2, 3


class Fleet(Served[FakeDaemon]):
    def __init__(self, folder: Path, **server: Any) -> None:
        super().__init__(folder, FakeDaemon(), **server)

    def order(self, *args: str) -> tuple[str, dict[str, Any]]:
        """What alpha was ordered."""
        self.run(*args)
        return self.daemon.vehicle("alpha").orders[-1]


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[Fleet]:
    with Fleet(tmp_path) as fleet:
        yield fleet


def test_a_range_names_the_ids_that_no_vehicle_has(fleet: Fleet) -> None:
    """After the outcomes, and to a person only."""
    assert "no vehicle has the system ids 4-60\n" in fleet.run("land", "1-60")
    assert "system ids" not in fleet.run("land", "1-3")
    assert "system ids" not in fleet.run("land", "1-60", "--json")


def test_orders_take_targets_first_and_negative_numbers(fleet: Fleet) -> None:
    assert fleet.order("arm", "1,3", "--wait", "2")[1] == {"force": False, "wait_s": 2.0}
    assert fleet.order("disarm", "all", "--force")[1] == {"force": True}
    usual = {"height_m": 5.0, "arm": True, "wait_s": 0.0, "force": False}
    assert fleet.order("takeoff", "all", "5") == ("takeoff", usual)
    assert fleet.order("takeoff", "alpha", "--no-arm")[1] == {**usual, "height_m": None, "arm": False}
    assert fleet.order("takeoff", "alpha", "5", "--force")[1] == {**usual, "force": True}
    assert [fleet.order(o, "1-2")[0] for o in ("land", "rtl", "hold")] == ["land", "rtl", "hold"]
    assert fleet.order("mode", "alpha", "AUTO.LOITER") == ("set_mode", {"name": "AUTO.LOITER", "force": False})
    place = fleet.order("goto", "alpha", "43.1", "-79.2", "10", "--yaw", "-90")[1]
    assert (place["lat_deg"], place["lon_deg"], place["height_m"], place["yaw_deg"]) == (43.1, -79.2, 10, -90)
    assert fleet.order("goto", "alpha", "-43.1", "-79.2")[1]["height_m"] is None
    assert fleet.order("goto", "alpha", "--enu", "-5,3,2", "--force")[1]["enu_m"] == [-5, 3, 2]
    assert fleet.order("reboot", "alpha") == ("reboot", {"force": False})
    here = {"lat_deg": -43, "lon_deg": -79, "force": False}
    assert fleet.order("home", "alpha")[1] == {"lat_deg": None, "lon_deg": None, "alt_amsl_m": None, "force": False}
    assert fleet.order("home", "alpha", "-43", "-79", "180")[1] == {**here, "alt_amsl_m": 180}
    assert fleet.order("home", "alpha", "-43", "-79")[1] == {**here, "alt_amsl_m": None}
    assert fleet.order("interval", "alpha", "ATTITUDE", "10")[1] == {"message": "ATTITUDE", "rate_hz": 10}
    assert fleet.order("interval", "alpha", "30", "default")[1] == {"message": 30, "rate_hz": None}
    assert fleet.order("stream", "alpha", "POSITION", "4")[1] == {"stream": "POSITION", "rate_hz": 4}
    raw = fleet.order("command", "alpha", "DO_SET_SERVO", "1", "-5.5", "nan")[1]
    assert (raw["command"], raw["params"], raw["int_frame"]) == ("DO_SET_SERVO", [1, -5.5, None], None)
    raw = fleet.order("command", "alpha", "192", "--frame", "6", "--x", "-437806000", "--y", "5", "--z", "10")[1]
    assert (raw["command"], raw["int_frame"], raw["x"], raw["y"], raw["z"]) == (192, 6, -437806000, 5, 10)


def test_the_origin_of_a_flying_vehicle_shows_where_zero_is() -> None:
    state = {"name": "alpha", "landed": "in_air", "position": {"alt_rel_m": 12.04}}
    assert list(zero_in_the_air({"alt_amsl_m": 192.1}, state)) == [
        "up is 0 where alpha flies: 192.1 m above sea level, 12.0 m above its home; "
        "heights near the ground are negative"
    ]
    assert list(zero_in_the_air({"alt_amsl_m": 180.0}, state | {"landed": "on_ground"})) == []


def test_the_origin_is_shown_set_taken_and_reported(fleet: Fleet) -> None:
    asked = fleet.daemon.fleet.origin_asked
    assert "no origin" in fleet.run("origin")
    assert fleet.json("origin", "get") == {"origin": None, "generation": 0}
    line = fleet.run("origin", "set", "-43.5", "-79.25", "-1.5", "--heading", "30")
    assert "-43.5000000, -79.2500000, -1.50 m above sea level; x to 30.0°, y to 300.0° (frame 1)" in line
    assert "keeps its heading" not in line
    assert fleet.json("origin", "set", "-43.5", "-79.25", "180")["origin"]["x_heading_deg"] == 30.0
    assert "the x axis keeps its heading of 30.0°" in fleet.run("origin", "set", "-43.5", "-79.25", "181")
    assert "x east, y north" in fleet.run("origin", "set", "-43.5", "-79.25", "180", "--heading", "90", "--force")
    assert asked == [("set", False), ("set", False), ("set", False), ("set", True)]
    assert fleet.json("origin", "from", "bravo", "--heading")["origin"]["alt_amsl_m"] == 102.0
    assert asked[-1] == ("from", "bravo", True, False)
    assert "flies" not in fleet.run("origin", "from", "bravo")  # on the ground
    assert fleet.run("origin", "push", "1,2", "--home").split()[:2] == ["ok", "alpha"]
    assert asked[-1] == ("push", True, False)
    assert "zero coordinate" in fleet.run("origin", "set", "0", "0", "0", code=FAILED)
    fleet.run("origin", "set", "91", "0", "0", code=USAGE)
    fleet.run("origin", "set", "nan", "1", "0", code=USAGE)
    fleet.run("origin", "from", "nobody", code=FAILED)
    fleet.daemon.vehicle("bravo").outcome = FakeOutcome(False, "denied", "denied: ArduPilot has an origin already")
    assert "ArduPilot has an origin already" in fleet.run("origin", "push", "all", code=FAILED)


def test_an_order_exits_1_if_any_vehicle_does_not_do_it_and_says_why(fleet: Fleet) -> None:
    fleet.daemon.vehicle("carol").outcome = FakeOutcome(False, "denied", "denied: Arm: Throttle too high")
    shown = fleet.run("arm", "all", code=FAILED).splitlines()
    assert [line.split()[:2] for line in shown] == [["ok", "alpha"], ["ok", "bravo"], ["FAIL", "carol"]]
    assert "Arm: Throttle too high" in shown[2]
    outcomes = fleet.json("arm", "2,3", code=FAILED)["outcomes"]
    assert [o["ok"] for o in outcomes.values()] == [True, False]


@each(
    ("args", "code", "text"),
    [
        (["arm", "9"], FAILED, "no vehicle '9'; there are: alpha, bravo, carol"),
        (["takeoff", "all", "-5"], USAGE, "cli: height: "),
        (["arm"], USAGE, "TARGETS"),
        (["goto", "all", "43"], USAGE, "LAT LON"),
        (["goto", "all", "43", "x"], USAGE, "LON"),
        (["goto", "all", "43", "-79", "1", "2"], USAGE, "LAT LON HEIGHT"),
        (["goto", "all", "--enu", "1,2"], USAGE, "E,N,U"),
        (["goto", "all", "1", "2", "--enu", "1,2,3"], USAGE, "not both"),
        (["goto", "all", "1", "2", "--yow", "3"], USAGE, "--yow"),
        (["goto", "all", "143", "2"], USAGE, "skygcs-cli: lat: "),
        (["home", "all", "43"], USAGE, "LAT LON [ALT]"),
        (["home", "all", "1", "2", "3", "4"], USAGE, "LAT LON ALT"),
        (["command", "all", "SERVO"], USAGE, "DO_SET_SERVO"),
        (["message", "send", "COMMAND_LONG", "command=400", "param1=1"], USAGE, "--to TARGETS"),
        (["message", "send", "manual_control", "z=1000"], USAGE, "MANUAL_CONTROL has a target field: give --to"),
        (["message", "send", "COMMAND_LONG", "--to", "1", "--link", "radio"], USAGE, "not both"),
        (["nonsense"], USAGE, "nonsense"),
        (["interval", "all", "NONSENSE", "1"], USAGE, "NONSENSE"),
        (["call", "daemon.inf"], USAGE, "did you mean daemon.info"),
        (["call", "vehicles.takeoff", '{"targets": "all", "height_m": NaN}'], USAGE, "NaN is not a finite number"),
        (["call", "vehicles.takeoff", '{"targets": "all", "height_m": 1e999}'], USAGE, "not a finite number"),
        (["takeoff", "all", "nan"], USAGE, "'nan' is not a finite number"),
        (["takeoff", "all", "inf"], USAGE, "'inf' is not a finite number"),
        (["takeoff", "all", "high"], USAGE, "'high' is not a number"),
        (["takeoff", "all", "5", "--wait", "inf"], USAGE, "not a finite number"),
        (["arm", "all", "--wait", "-1"], USAGE, "cli: wait: "),
        (["goto", "all", "1", "2", "--yaw", "nan"], USAGE, "not a finite number"),
        (["stream", "all", "POSITION", "inf"], USAGE, "not a finite number"),
        (["command", "all", "192", "--frame", "6", "--z", "nan"], USAGE, "not a finite number"),
        (["watch", "--rate", "nan"], USAGE, "not a finite number"),
        (["message", "watch", "--rate", "inf"], USAGE, "not a finite number"),
        (["command", "alpha", "DO_REPOSITION", "--frame", "6", "--x", "43"], USAGE, "give both"),
        (["command", "alpha", "DO_REPOSITION", "--x", "43", "--y", "5"], USAGE, "give --frame"),
        (["call", "vehicles.command", '{"targets": 1, "command": 192, "int_frame": 6, "x": 1}'], USAGE, "both x and y"),
        (["call", "vehicles.command", '{"targets": 1, "command": 192, "z": 1}'], USAGE, "give int_frame"),
        (["command", "alpha", "DO_REPOSITION", "--frame", "NONSENSE"], USAGE, "GLOBAL_RELATIVE_ALT"),
        (["stream", "all", "NONSENSE", "1"], USAGE, "POSITION"),
        (["arm", "2-1"], USAGE, "did you mean 1-2?"),
        (["message", "send", "ATTITUDE", "--target", "all"], USAGE, "no such option: --target"),
        (["takeoff", "all", "--hieght=3"], USAGE, "no such option: --hieght"),
        (["goto", "all", "1", "2", "--yow", "3"], USAGE, "did you mean --yaw?"),
        (["interval", "all", "ATTITUDE", "1", "--force"], USAGE, "no such option: --force"),
        (["call", "daemon.info", "{"], USAGE, "not JSON"),
        (["call", "daemon.info", "[]"], USAGE, "object"),
        (["message", "send", "ATTITUDE", "rol=1"], USAGE, "rol"),
        (["message", "send", "ATTITUDE", "roll"], USAGE, "name=value"),
        (["message", "last", "alpha", "HEARTBEAT"], FAILED, "has not sent HEARTBEAT yet"),
        (["watch", "--fields", "batery.volts"], USAGE, "batery"),
        (["watch", "--rate", "50"], USAGE, "20"),
        (["links", "remove", "nope"], FAILED, "no link nope"),
        (["message", "send", "UTIAS"], USAGE, "skygcs-cli message list lists them"),
        (["message", "send", "ATITUDE"], USAGE, "did you mean ATTITUDE"),
        (["message", "send", "STATUSTEXT", "severity=300"], USAGE, "is uint8_t: 0 to 255, not 300"),
        (["message", "send", "STATUSTEXT", "severity=INFO"], USAGE, "did you mean MAV_SEVERITY_INFO?"),
        (["message", "send", "ATTITUDE_QUATERNION_COV", "q=1"], USAGE, "is float[4]: give a list of numbers, not 1"),
        (["message", "send", "ATTITUDE_QUATERNION_COV", "q=a,b,c,d"], USAGE, "not 'a,b,c,d'"),
        (["message", "send", "ATTITUDE", "roll=x"], USAGE, "is float, not 'x'"),
        (["links", "add", "bad name", "type=memory"], USAGE, "a link's name is made of"),
        (["events", "--kind", "foo"], USAGE, "no kind foo; there are: vehicle_discovered, "),
        (["events", "--kind", "fault"], DONE, "no event of kind fault yet"),
        (["message", "list", "zzz"], DONE, "no message of the dialect has 'zzz' in its name"),
        (["links", "add", "x", "port=1"], USAGE, "links.x.type: is missing"),
    ],
)
def test_mistakes_are_reported_in_words_with_the_right_exit_code(
    fleet: Fleet, args: list[str], code: int, text: str
) -> None:
    assert text in fleet.run(*args, code=code)


def test_status_shows_and_answers_json(fleet: Fleet) -> None:
    assert len(fleet.run("status").splitlines()) == 4
    assert [s["name"] for s in fleet.json("status", "2-3")] == ["bravo", "carol"]
    fleet.daemon.fleet.vehicles.clear()
    assert "no vehicle heard yet" in fleet.run("status")
    assert fleet.json("status") == []


def test_watch_prints_a_line_per_update_where_there_is_no_terminal(fleet: Fleet) -> None:
    lines = fleet.run("watch", "--count", "4", "--rate", "20").splitlines()
    assert [line.split()[0] for line in lines] == ["alpha", "bravo", "carol", "alpha"]
    lines = fleet.run("watch", "alpha", "--count", "1", "--telemetry", "battery.volts,position.alt_rel_m").splitlines()
    assert lines[0].startswith("alpha battery.volts=15.8 position.alt_rel_m=")
    update = json.loads(fleet.run("watch", "1", "--fields", "gps.fix", "--count", "1", "--json"))
    assert update["gps"]["fix"] == "3D" and "battery" not in update


def test_events_show_the_past_and_follow_what_happens(fleet: Fleet) -> None:
    for i in range(5):
        fleet.daemon.emit("mode", "bravo", f"mode {i}")
    assert [line.split()[-1] for line in fleet.run("events", "-n", "2").splitlines()] == ["3", "4"]
    assert "discovered" in fleet.run("events", "--kind", "vehicle_discovered")
    assert json.loads(fleet.run("events", "-n", "1", "--json"))["text"] == "mode 4"


def test_messages_are_watched_sent_and_looked_up(fleet: Fleet) -> None:
    fleet.later(0.3, lambda: fleet.daemon.hear("ATTITUDE", roll=0.25))
    assert "alpha ATTITUDE" in fleet.run("message", "watch", "ATTITUDE", "--count", "1")
    fleet.later(0.3, lambda: fleet.daemon.hear("ATTITUDE", sysid=2, roll=0.25))
    shown = json.loads(fleet.run("message", "watch", "--from", "bravo", "--count", "1", "--json"))
    assert (shown["vehicle"], shown["fields"]["roll"]) == ("bravo", 0.25)
    assert "sent HEARTBEAT" in fleet.run("message", "send", "HEARTBEAT", "type=MAV_TYPE_GCS", "--to", "all")
    assert fleet.daemon.sent[-1] == ("HEARTBEAT", {"type": 6}, "all", None)
    fleet.run("message", "send", "COMMAND_LONG", "command=400", "--to", "alpha")
    fleet.run("message", "send", "COMMAND_LONG", "command=400", "target_system=0")
    assert [entry[2] for entry in fleet.daemon.sent[-2:]] == ["alpha", None]
    fleet.run("message", "send", "ATTITUDE_QUATERNION_COV", "q=1,0,nan,0")
    assert str(fleet.daemon.sent[-1][1]["q"]) == "[1, 0, nan, 0]"
    fleet.run("message", "send", "ATTITUDE", "roll=-0.5", "pitch=nan", "--link", "radio")
    assert fleet.daemon.sent[-1][1]["roll"] == -0.5
    assert "was not sent" in fleet.run("message", "send", "ATTITUDE", "--link", "dead", code=FAILED)
    assert "bravo got it as well" in fleet.run("message", "send", "ATTITUDE", "--to", "alpha,carol")
    last = fleet.run("message", "last", "alpha", "ATTITUDE")
    assert "pitch" in last and "ATTITUDE of 1/1, " in last
    asked = fleet.run("message", "request", "alpha", "ATTITUDE").splitlines()
    assert asked[0].startswith("ok") and asked[1].startswith("alpha ATTITUDE roll=")
    heard = fleet.run("components").splitlines()
    assert heard[1].split() == ["alpha", "1/191", "ONBOARD_COMPUTER", "ONBOARD_CONTROLLER", "42", "0.3", "s"]
    assert fleet.run("message", "list", "heartbeat").startswith("    0 HEARTBEAT: ")
    assert fleet.json("message", "list", "HIGH_LATENCY2")[0]["id"] == 235


def test_a_vehicle_is_renumbered_and_forgotten(fleet: Fleet) -> None:
    assert "alpha is system 22 now" in fleet.run("sysid", "alpha", "22")
    assert "bravo has it" in fleet.run("sysid", "alpha", "2", code=FAILED)
    assert "alpha is system 23 now" in fleet.run("sysid", "alpha", "23", "--force")
    for wrong in ("0", "251"):
        assert "sysid" in fleet.run("sysid", "alpha", wrong, code=USAGE)
    fleet.daemon.vehicle("carol").connected = False
    assert fleet.json("forget", "carol")["outcomes"]["carol"]["ok"]
    fleet.run("forget", "alpha,bravo", code=FAILED)
    fleet.run("forget", "all", "--force")
    assert not fleet.daemon.fleet.vehicles


def test_links_are_listed_added_changed_and_removed(fleet: Fleet) -> None:
    assert "/dev/ttyUSB0" in fleet.run("links")
    assert fleet.json("links")[0]["name"] == "radio"
    assert "qgc" in fleet.run("links", "add", "qgc", "type=udp_client", "host=10.0.0.5", "port=14550")
    assert fleet.daemon.links["qgc"] == {"type": "udp_client", "host": "10.0.0.5", "port": 14550}
    fleet.run("links", "add", "few", "type=memory", "allow_msg_id_in=HEARTBEAT,30", "block_msg_id_out=ATTITUDE")
    wanted = {"type": "memory", "allow_msg_id_in": ["HEARTBEAT", 30], "block_msg_id_out": ["ATTITUDE"]}
    assert fleet.daemon.links.pop("few") == wanted
    fleet.run("links", "change", "qgc", "type=udp_server", "port=1")
    assert fleet.daemon.links["qgc"]["type"] == "udp_server"
    assert [link["name"] for link in fleet.json("links", "remove", "qgc")] == ["radio"]
    fleet.run("links", "remove", "radio")
    assert "no links" in fleet.run("links", "list")


def test_the_kinds_of_events_are_those_that_events_document() -> None:
    assert set(EVENT_KINDS) == set((Event.__doc__ or "").partition("Kinds in use:")[2].split())


def test_any_method_can_be_called_and_all_are_listed(fleet: Fleet) -> None:
    assert json.loads(fleet.run("call", "vehicles.get", '{"target": 2}'))["name"] == "bravo"
    fleet.daemon.vehicle("alpha").outcome = FakeOutcome(False, "denied", "no")
    fleet.run("call", "vehicles.arm", '{"targets": "alpha"}', code=FAILED)
    assert "vehicles.takeoff" in fleet.run("discover")
    assert fleet.json("discover")["openrpc"].startswith("1.")
    assert fleet.json("info")["daemon"]["version"]
    assert "recorder.recording  true" in fleet.run("info").splitlines()


def test_no_daemon_at_the_socket_is_exit_code_3(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYGCS_SOCKET", "restored after the test")
    for args in (["status"], ["arm", "all"], ["watch"], ["links"], ["message", "list"], ["call", "daemon.info"]):
        text = said(*args, "--socket", tmp_path / "nobody", code=UNREACHABLE)
        assert "no skygcs daemon at" in text and "skygcs run" in text


def test_a_token_file_that_cannot_be_read_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYGCS_TOKEN_FILE", "restored after the test")
    assert "token file" in said("status", "--token-file", tmp_path / "none", code=FAILED)


@each("address", ["tcp://127.0.0.1:abc", "http://127.0.0.1:80", "tcp://:5", "tcp://h:99999"])
def test_a_wrong_address_is_a_usage_error(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYGCS_SOCKET", "restored after the test")
    assert "tcp://HOST:PORT" in said("status", "--socket", address, code=USAGE)


def test_a_token_that_is_missing_or_wrong_is_reported_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SKYGCS_SOCKET", "restored after the test")
    monkeypatch.setenv("SKYGCS_TOKEN_FILE", "")
    with Fleet(tmp_path, tcp_port=0, token="open sesame") as fleet:
        assert fleet.server.tcp_address is not None
        address = f"tcp://127.0.0.1:{fleet.server.tcp_address[1]}"
        missing = said("status", "--socket", address, code=FAILED)
        assert "the daemon requires a token: --token-file FILE" in missing
        token = tmp_path / "token"
        token.write_text("open barley")
        for command in ("status", "watch"):
            wrong = said(command, "--socket", address, "--token-file", token, code=FAILED)
            assert f"the token in {token} is wrong" in wrong


def test_json_is_taken_wherever_it_stands(fleet: Fleet) -> None:
    assert json.loads(fleet.run("--json", "status", "2"))[0]["name"] == "bravo"
    assert json.loads(fleet.run("--json", "message", "list", "HEARTBEAT"))[0]["id"] == 0
    assert json.loads(fleet.run("call", "vehicles.get", '{"target": 2}', "--json"))["name"] == "bravo"


@each("args", [["--help"], ["goto", "-h"], ["message", "send", "--help"], ["links", "-h"], ["tlog", "-h"]])
def test_help_is_there_without_a_daemon(args: list[str]) -> None:
    assert "Usage" in said(*args)


def test_an_unforeseen_error_is_one_line(fleet: Fleet, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("skygcs.cli.status.status_table", broken)
    assert "internal error: ZeroDivisionError: a bug" in fleet.run("status", code=FAILED)


def test_every_command_is_in_the_reference() -> None:
    page = (Path(__file__).parents[3] / "docs" / "reference" / "cli.md").read_text(encoding="utf-8")
    commands = typer.main.get_group(app).commands
    names = [f"{name} {sub}" for name, group in commands.items() for sub in getattr(group, "commands", {})]
    assert len(commands) > 30 and len(names) > 40
    assert [name for name in commands if f"`{name}" not in page] == []
    # each command of a group is in an item of the group, also in short forms: `mission pause`, `resume TARGETS`
    rows = page.split("\n- ")
    missing = [n for n in names if not any(f"`{n.split()[0]}" in r and f"{n.split()[1]}" in r for r in rows)]
    assert missing == []


def test_a_stop_holds_by_default(fleet: Fleet) -> None:
    assert fleet.order("stop", "all") == ("stop", {"action": "hold"})
    assert fleet.order("stop", "alpha", "land") == ("stop", {"action": "land"})
    fleet.run("stop", "alpha", "fall", code=USAGE)


def test_a_script_kills_nothing_without_the_word_for_as_many_as_it_hits(fleet: Fleet) -> None:
    for words in ([], ["--confirm", "kill-1"]):
        said = fleet.run("stop", "all", "kill", *words, code=FAILED)
        assert "alpha, bravo and carol" in said and "kill-3" in said
    assert not any(v.orders for v in fleet.daemon.fleet.vehicles.values())
    assert fleet.order("stop", "all", "kill", "--confirm", "kill-3") == ("stop", {"action": "kill"})


@pytest.mark.parametrize(("typed", "code", "ordered"), [("kill-1\n", DONE, 1), ("no\n", FAILED, 0), ("\n", FAILED, 0)])
def test_a_person_sees_which_vehicles_fall_and_types_the_word(
    fleet: Fleet, monkeypatch: pytest.MonkeyPatch, typed: str, code: int, ordered: int
) -> None:
    monkeypatch.setattr(orders, "_has_terminal", lambda: True)
    assert "the motors of alpha" in fleet.run("stop", "alpha", "kill", code=code, typed=typed)
    assert len(fleet.daemon.vehicle("alpha").orders) == ordered
