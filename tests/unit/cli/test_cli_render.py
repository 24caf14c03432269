"""What people see."""

from __future__ import annotations

import io
import time
from typing import Any

import pytest
from rich.console import Console

from skygcs.cli import links, messages, render, status
from skygcs.cli.demo import Demo
from support.fake_daemon import FakeDaemon
from support.table import each


def text_of(table: Any, width: int = 250) -> str:
    stream = io.StringIO()
    Console(file=stream, width=width, color_system=None).print(table)
    return stream.getvalue()


def state(**changes: Any) -> dict[str, Any]:
    made = FakeDaemon().vehicle("alpha").state(0.0)
    return {**made, "links": {"radio": {"loss_ratio": 0.013}, "lte": {"loss_ratio": 0.5}}, **changes}


def test_the_status_table_shows_what_one_asks_first() -> None:
    lines = text_of(status.status_table([state(), state(name="bravo", sysid=2, armed=True)])).splitlines()
    for column in ("name", "autopilot", "mode", "armed", "alt", "battery", "gps", "link", "loss", "age", "last text"):
        assert column in lines[0]
    for cell in ("alpha", "px4 1.14.3", "AUTO.LOITER", " no ", "87 % 15.8 V", "3D 11 sat", "radio", "1.3 %", "0.4 s"):
        assert cell in lines[1], cell
    assert "Ready (12 s ago)" in lines[1] and "ground" in lines[1]
    assert "ARMED" in lines[2]


def test_places_in_the_world_frame_have_a_column_once_there_is_one() -> None:
    here = state(position={"alt_rel_m": 9.0, "enu_m": [12.34, -5.0, -0.04]})
    assert "x, y, up" in text_of(status.status_table([state(), here]))
    assert "12.3, -5.0, 0.0" in text_of(status.status_table([state(), here]))
    assert "x, y, up" not in text_of(status.status_table([state(position={"alt_rel_m": 9.0, "enu_m": None})]))


@each(
    ("companion", "word"),
    [
        ({"link": "up", "age_s": 0.2}, "up"),
        ({"link": "down", "since_s": 12.0, "age_s": 0.2}, "DOWN 12 s"),
        ({"link": None, "age_s": 0.2}, "heard"),
        ({"link": None, "age_s": 73.0}, "silent 73 s"),
        ({"link": None, "age_s": None}, "not heard"),
    ],
)
def test_the_computer_on_a_vehicle_has_a_column_once_one_has_it(companion: dict[str, Any], word: str) -> None:
    lines = text_of(status.status_table([state(), state(name="bravo", sysid=2, companion=companion)])).splitlines()
    column = lines[0].index("companion")
    assert lines[1][column:].startswith(" ") and lines[2][column:].startswith(word)
    assert "companion" not in text_of(status.status_table([state()]))


@each(
    ("parts", "word"),
    [
        ({"authority": {"held": True, "commander": "north"}}, "here"),
        ({"authority": {"held": False, "commander": "south"}}, "south"),
        ({"authority": {"held": False, "commander": None}}, "nobody"),
        ({"authority": None}, ""),
        ({"site": "south", "lease": {"holder": "north", "revision": 3, "remaining_s": 2.0}}, "north"),
        ({"site": "south", "lease": None}, ""),
    ],
)
def test_a_shared_vehicle_shows_who_commands_it(parts: dict[str, Any], word: str) -> None:
    column = status.STATUS_COLUMNS.index("commander")
    assert status.status_cells(state(**parts))[column] == word
    shown = text_of(status.status_table([state(), state(name="bravo", sysid=2, **parts)]))
    assert ("commander" in shown) == bool(word) and (not word or f" {word} " in shown)


@each("width", [80, 100, 140, 200])
def test_a_narrow_terminal_lacks_columns_but_what_it_shows_is_whole(width: int) -> None:
    states = [state(), state(name="bravo", sysid=2, armed=True, duplicate_sysid=True, landed="in_air")]
    lines = text_of(status.status_table(states, width=width), width).splitlines()
    assert not any("…" in line for line in lines)
    for cell in ("bravo", "AUTO.LOITER", "ARMED DUPLICATE ID", "87 % 15.8 V", "0.4 s"):
        assert cell in lines[2], cell
    assert ("last text" in lines[0]) == (width > 120)
    shown = [*FakeDaemon().links.status(), {"name": "lte", "type": "tcp_client", "state": "down", "since_s": 9.0}]
    lines = text_of(links.links_table(shown, width), width).splitlines()
    assert not any("…" in line for line in lines)
    for cell in ("radio", "up 42 s", "/dev/ttyUSB0", "1200", "1/1 1.0 %"):
        assert cell in lines[1], cell
    assert ("unknown" in lines[0]) == (width > 120)


def test_a_lost_vehicle_and_a_failsafe_are_said_in_words() -> None:
    cells = status.status_cells(state(connected=False, last_heartbeat_age_s=73.0, armed=True, failsafe=True))
    assert "lost 73 s" in cells and "ARMED FAILSAFE" in cells


def test_two_vehicles_under_one_id_and_a_recording_are_said_in_words() -> None:
    assert "no DUPLICATE ID" in status.status_cells(state(duplicate_sysid=True))
    assert "ARMED REPLAY" in status.status_cells(state(armed=True, replayed=True))
    assert "no" in status.status_cells(state(duplicate_sysid=False, replayed=False))
    styles = [style for style in status._styles(state(duplicate_sysid=True)).values() if "red" in style]
    assert styles == ["bold red"]


def test_vehicles_of_other_sites_stand_behind_ours_with_their_site_and_total_age() -> None:
    silent = {"name": "south/alpha", "site": "south", "connected": False, "last_heartbeat_age_s": None}
    found = status.by_site([state(**silent), state(name="zulu", sysid=9), state(name="south/b", site="south", sysid=1)])
    assert [one["name"] for one in found] == ["zulu", "south/alpha", "south/b"]
    lines = text_of(status.status_table(found)).splitlines()
    assert lines[0].split()[:2] == ["name", "site"]
    assert lines[2].split()[:2] == ["south/alpha", "south"] and "lost ?" in lines[2]


def test_a_vehicle_of_which_only_a_heartbeat_is_known_has_its_row() -> None:
    bare = {"name": "v7", "sysid": 7, "autopilot": "px4", "connected": True, "armed": None, "mode": None}
    unknown = dict.fromkeys(("gps", "position", "battery", "home", "firmware", "landed", "last_heartbeat_age_s"))
    cells = status.status_cells({**bare, **unknown, "status_texts": [], "links": {}})
    assert cells[:7] == ("v7", "", "", "7", "px4", "?", "?")
    text_of(status.status_table([{**bare, **unknown}]))


def test_markup_in_a_status_text_is_only_text() -> None:
    odd = state(status_texts=[{"severity": "info", "text": "[red]boo[/] [/nonsense]", "age_s": 1.0}])
    assert "[red]boo[/] [/nonsense]" in text_of(status.status_table([odd]))


def test_chosen_fields_are_columns() -> None:
    shown = text_of(status.status_table([state()], ["battery.volts", "position.vel_enu_mps.0", "home.lat_deg", "x.y"]))
    assert shown.split() == [
        *("name", "battery.volts", "position.vel_enu_mps.0", "home.lat_deg", "x.y"),
        *("alpha", "15.8", "0.1", "-", "-"),
    ]


@each(("seconds", "text"), [(None, "?"), (0.04, "0.0 s"), (9.94, "9.9 s"), (12, "12 s"), (300, "5 min"), (7300, "2 h")])
def test_durations_are_short(seconds: float | None, text: str) -> None:
    assert render.duration(seconds) == text


def outcome(**changes: Any) -> dict[str, Any]:
    sent = {"attempts": 1, "elapsed_s": 0.42, "status_texts": []}
    return {"ok": True, "result": "accepted", "message": "armed", **sent, **changes}


def test_every_vehicle_has_a_line_with_its_outcome_and_reason() -> None:
    refused = outcome(
        ok=False, message="denied: Arm: Throttle too high", attempts=3, status_texts=["Throttle too high", "Check RC"]
    )
    assert render.outcome_lines({"alpha": outcome(), "carolina": refused}) == [
        "ok   alpha     armed (0.4 s)",
        "FAIL carolina  denied: Arm: Throttle too high (0.4 s, 3 transmissions)",
        "               Check RC",
    ]
    unsent = outcome(ok=False, message="refused: too far", attempts=0, elapsed_s=0.0)
    assert render.outcome_lines({"v7": unsent}) == ["FAIL v7  refused: too far"]
    assert render.outcome_lines({}) == []


def test_a_long_reason_that_many_share_is_reported_once_per_reason() -> None:
    modes = ", ".join(f"AUTO.MODE{i}" for i in range(30))
    reasons = {"a": f"no mode 'X'; there are {modes}", "b": f"no mode 'X'; there are {modes.replace('AUTO.', '')}"}
    answers = {f"{kind}{i}": outcome(ok=False, message=reasons[kind], attempts=0) for i in range(2) for kind in "ab"}
    lines = render.outcome_lines(answers)
    assert lines == [
        f"FAIL a0  {reasons['a']}",
        f"FAIL b0  {reasons['b']}",
        "FAIL a1  no mode 'X' … as a0",
        "FAIL b1  no mode 'X' … as b0",
    ]
    short = outcome(ok=False, message="denied", attempts=0)
    assert render.outcome_lines({"a": short, "b": short}) == ["FAIL a  denied", "FAIL b  denied"]


def test_a_shared_reason_is_cut_between_words_and_only_where_that_is_shorter() -> None:
    reason = "refused: it is heard only in a recording and cannot take orders"
    for rest, second in (
        ("", reason),
        (" from here", "refused: it is heard only in a recording and cannot take … as a"),
    ):
        answer = outcome(ok=False, message=reason + rest, attempts=0)
        assert render.outcome_lines({"a": answer, "b": answer}) == [f"FAIL a  {reason}{rest}", f"FAIL b  {second}"]


def test_on_a_terminal_long_lines_are_wrapped_between_words_below_their_text() -> None:
    modes = ", ".join(f"AUTO.MODE{i}" for i in range(30))
    lines = render.outcome_lines({"alpha": outcome(ok=False, message=f"no; {modes}", attempts=0)}, 60)[0].splitlines()
    assert all(len(line) <= 60 for line in lines) and lines[1].startswith(" " * 12 + "AUTO.MODE")
    assert " ".join(lines).split() == ["FAIL", "alpha", "no;", *modes.split()]
    assert render.wrapped("a" * 70 + " b", 60, 2) == "a" * 70 + "\n  b"
    assert render.wrapped("a b", None) == "a b"
    assert render.wrapped("a\n  b c", 4) == "a\n  b\nc"


def test_what_drives_is_on_the_ground_and_has_no_height() -> None:
    """A Rover that stood "180.0 m ground" at its home."""
    for kind, shown in (("GROUND_ROVER", "ground"), ("QUADROTOR", "180.0 m ground")):
        assert status.height_word(state(type=kind, landed="on_ground", position={"alt_rel_m": 180.0})) == shown


def test_a_height_that_rounds_to_nothing_has_no_sign() -> None:
    cells = status.status_cells(state(position={"alt_rel_m": -0.04}))
    assert cells[status.STATUS_COLUMNS.index("alt")] == "0.0 m ground"


def test_a_long_last_text_is_cut_instead_of_wrapped() -> None:
    texts = [{"severity": "info", "level": 6, "text": "all is well, " * 8, "age_s": 1.0}]
    lines = text_of(status.status_table([state(status_texts=texts)], width=140), 140).splitlines()
    assert len(lines) == 2
    assert lines[1].startswith("alpha") and lines[1].rstrip().endswith("…")


def test_events_and_messages_are_one_line_and_show_what_was_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    event = {"time_unix_s": 3661.0, "kind": "mode", "vehicle": "alpha", "text": "AUTO.LAND", "data": {}}
    assert render.event_line(event) == "01:01:01 mode               alpha: AUTO.LAND"
    assert render.event_line({**event, "text": "alpha lands", "dropped": 3}).endswith(
        "alpha lands  [3 events lost before this one]"
    )
    fields = {"a": None, "b": [1, 0.5], "c": "t"}
    message = {"vehicle": None, "sysid": 255, "compid": 190, "name": "X", "fields": fields}
    assert messages.message_line(message) == "255/190 X a=- b=[1, 0.5] c=t"


def test_links_have_a_row_per_channel_and_say_why_they_are_down() -> None:
    daemon = FakeDaemon()
    up = daemon.links.status()[0]
    down = {"name": "lte", "type": "tcp_client", "role": "gcs", "state": "down", "since_s": 3.0}
    down["last_error"] = "refused " * 40
    off = {"name": "spare", "type": "serial", "role": "peer", "state": "disabled", "since_s": 9.0, "last_error": "old"}
    lines = text_of(links.links_table([{**up, "channels": up["channels"] * 2}, down, off])).splitlines()
    for cell in ("radio", "serial", "up 42 s", "/dev/ttyUSB0", "1200", "57 B", "1/1 1.0 %"):
        assert cell in lines[1]
    assert "radio" not in lines[2]
    assert "lte" in lines[3] and "down 3.0 s" in lines[3] and "refused" not in lines[3]
    assert lines[4].split() == ["spare", "serial", "peer", "disabled"]
    assert max(len(line.rstrip()) for line in lines[:5]) < 130  # no error widens the table
    assert " ".join(lines[5:]).split() == ["lte:", *["refused"] * 40]


def test_a_bound_link_shows_its_vehicles_and_frames_for_others() -> None:
    up = FakeDaemon().links.status()[0]
    kite = {**up, "name": "p1", "role": "gcs", "vehicles": ["kite"], "translated_sysid": 1}
    many = {**up, "name": "p2", "role": "gcs", "vehicles": [1, 2, 3, 4, 5], "translated_sysid": None}
    many["channels"] = [{**up["channels"][0], "out_of_bounds": 7}]
    lines = [line.rstrip() for line in text_of(links.links_table([kite, many])).splitlines()]
    assert "gcs: kite as 1  " in lines[1]
    assert "gcs: 1, 2, 3 +2  " in lines[2]
    assert lines[3:] == ["p2: 7 frames for other vehicles than those of this link were dropped"]


def test_an_event_names_its_vehicle_although_a_word_of_the_text_holds_the_name() -> None:
    event = {"time_unix_s": 0.0, "kind": "mission", "vehicle": "ac", "text": "reached item 1", "dropped": 0}
    assert render.event_line(event).endswith("ac: reached item 1")
    assert render.event_line({**event, "text": "ac is here"}).endswith("  ac is here")


def terminal(width: int) -> Console:
    return Console(file=io.StringIO(), force_terminal=True, width=width, highlight=False, color_system=None)


def test_a_live_view_is_drawn_at_most_so_often_and_ends_with_the_last_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    screen = terminal(40)
    drawn: list[tuple[int, int]] = []
    monkeypatch.setattr(render, "console", lambda: screen)
    monkeypatch.setattr(render.time, "monotonic", lambda: now)

    def draw(columns: int) -> str:
        drawn.append((columns, updates))
        return f"picture {updates}"

    updates = 0
    with render.LiveView(draw) as view:
        for _ in range(100):  # 2 s of 50 updates each
            updates += 1
            now += 0.02
            view.refresh()
    assert {columns for columns, _ in drawn} == {40}
    assert len(drawn) <= 2 + 2 * render.SCREEN_HZ
    assert drawn[-1] == (40, 100) and "picture 100" in screen.file.getvalue()  # type: ignore[attr-defined]


def test_a_view_without_a_terminal_draws_nothing() -> None:
    with render.LiveView(lambda columns: pytest.fail("drawn"), enabled=False) as view:
        view.refresh(now=True)


def test_square_brackets_in_a_cell_are_no_markup() -> None:
    text = text_of(render.table(("a", "[b]"), [("[red]x", ("[/red]", "bold"))]), 80)
    assert "[b]" in text and "[red]x" in text and "[/red]" in text


def test_the_demo_draws_whole_columns_in_a_narrow_terminal() -> None:
    demo = Demo(terminal(80))
    demo.states = {name: state(name=name, sysid=i) for i, name in enumerate(("alpha", "bravo", "charlie"), 1)}
    text = text_of(demo.view(80), 80)
    assert "charlie" in text and "87 % 15.8 V" in text and "…" not in text
