"""`skygcs-cli param` against a fake daemon and on files: what it asks, prints, writes and refuses."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from skygcs.cli import params
from skygcs.cli.main import app
from skygcs.core.mavlink.param_encoding import Param, ParamType
from skygcs.core.params.param_file import parse
from skygcs.core.protocols.parameter import ParamOutcome
from skygcs.runtime.param_metadata import VehicleMetadata
from skygcs.runtime.param_transfers import Loaded
from support.command_line import Served, said
from support.fake_daemon import FakeDaemon
from support.shipped_metadata import shipped_metadata
from support.table import each

HELD = (
    Param("COMPASS_OFS_X", 4.5),
    Param("FENCE_ENABLE", 0, ParamType.INT8),
    Param("SYSID_THISMAV", 1, ParamType.INT16),
    Param("WPNAV_SPEED", 500.0),
)


class FakeParams:
    """Holds what it is set to; keeps no WPNAV_SPEED above 1000."""

    def __init__(self) -> None:
        self.held = {p.name: p for p in HELD}
        self.set_calls: list[dict[str, float]] = []
        self.deaf: set[str] = set()
        """Names that it says it has set, and has not."""
        self.complete = True
        self.vouched = "read"
        self.refreshed = 0
        self.cancelled = 0

    async def get(self, name: str) -> ParamOutcome:
        param = self.held.get(name)
        if param is None:
            return ParamOutcome(False, "unknown", "it has no such parameter", name)
        return ParamOutcome(True, "accepted", str(param.value), name, param)

    async def set(self, values: Mapping[str, float], *, settle: bool, force: bool = False) -> dict[str, ParamOutcome]:
        self.set_calls.append(dict(values))
        outcomes = {}
        for name, value in values.items():
            ok = name in self.held and not (name == "WPNAV_SPEED" and value > 1000)
            if ok and name not in self.deaf:
                self.held[name] = replace(self.held[name], value=value)
            outcomes[name] = ParamOutcome(ok, "accepted" if ok else "denied", f"-> {value:g}" if ok else "no", name)
        return outcomes

    async def load(self, *, refresh: bool, burst: bool, bytes_per_s: float | None) -> Loaded:
        if not self.complete:
            return Loaded(False, "timeout", "nothing came", "vehicle", "read", (), None, 9, 30.0)
        params = tuple(self.held.values())
        self.refreshed += refresh
        if self.vouched == "count" and not refresh:
            old = (replace(HELD[0], value=99.0), *params[1:])
            return Loaded(True, "accepted", "4 parameters, as known", "cache", "count", old, 4, 1, 0.1)
        return Loaded(True, "accepted", f"{len(params)} parameters", "vehicle", "read", params, len(params), 4, 0.1)

    def status(self) -> dict[str, Any]:
        return {"known": len(self.held)}

    def cancel(self) -> int:
        self.cancelled += 1
        return 2


class Held(Served[FakeDaemon]):
    """alpha has parameters."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, FakeDaemon())
        self.alpha = self.daemon.vehicle("alpha")
        self.params = self.alpha.params = FakeParams()
        self.alpha.parts[VehicleMetadata] = shipped_metadata("ardupilot")

    def run(self, *words: object, code: int = 0, typed: str | None = None) -> str:
        return super().run("param", *words, code=code, typed=typed)


param = partial(said, "param")


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Held]:
    with Held(tmp_path) as served:
        yield served


def test_get_shows_each_and_fails_with_any(served: Held) -> None:
    assert served.run("get", "alpha", "wpnav_speed") == "ok   alpha  WPNAV_SPEED       500.0\n"
    assert "FAIL alpha  NO_SUCH" in served.run("get", "alpha", "WPNAV_SPEED", "NO_SUCH", code=1)


def test_set_takes_several_and_negative_values(served: Held) -> None:
    served.run("set", "alpha", "COMPASS_OFS_X", "-3.5", "FENCE_ENABLE", "1")
    assert served.params.set_calls == [{"COMPASS_OFS_X": -3.5, "FENCE_ENABLE": 1}]
    assert isinstance(served.params.set_calls[0]["FENCE_ENABLE"], int)
    assert "no" in served.run("set", "alpha", "WPNAV_SPEED", "2000", code=1)


@each("args", [("WPNAV_SPEED",), ("WPNAV_SPEED", "fast"), ("BAD NAME", "1"), ("A", "nan")])
def test_wrong_usage_of_set_sends_nothing(served: Held, args: tuple[str, ...]) -> None:
    served.run("set", "alpha", *args, code=2)
    assert served.params.set_calls == []


def test_a_value_outside_its_range_is_refused_unless_somebody_insists(served: Held) -> None:
    text = served.run("set", "alpha", "WPNAV_SPEED", "50000", "COMPASS_OFS_X", "3", code=1)
    assert "FAIL alpha  WPNAV_SPEED       refused: 50000 is outside its range of 10 to 2000 cm/s" in text
    assert served.params.set_calls == [{"COMPASS_OFS_X": 3}]
    served.run("set", "alpha", "WPNAV_SPEED", "5", "--force")
    assert served.params.set_calls[-1] == {"WPNAV_SPEED": 5}


def test_show_says_unit_range_meaning_and_reboot(served: Held) -> None:
    text = served.run("show", "alpha", "wpnav_speed", "FENCE_ENABLE", "SYSID_THISMAV")
    assert "metadata of ArduPilot" in text and "WPNAV_SPEED       500 cm/s  (range 10 to 2000 cm/s)" in text
    assert "FENCE_ENABLE      0 = Disabled" in text and "values: 0 Disabled, 1 Enabled" in text
    assert "Waypoint Horizontal Speed Target" in text and "MAVLink system ID" in text
    assert "FAIL it has no such parameter" in served.run("show", "alpha", "NO_SUCH", code=1)
    answer = json.loads(served.run("show", "alpha", "WPNAV_SPEED", "--json"))
    assert answer["metadata"]["alpha"]["parameters"]["WPNAV_SPEED"]["greatest"] == 2000
    served.params.held["WPNAV_SPEED"] = replace(served.params.held["WPNAV_SPEED"], value=5000.0)
    assert "WARNING: 5000 is outside its range" in served.run("show", "alpha", "WPNAV_SPEED")


def test_list_with_a_pattern(served: Held) -> None:
    text = served.run("list", "alpha", "*sysid*")
    assert "4 parameters (read in 0.1 s)" in text and "SYSID_THISMAV" in text and "WPNAV" not in text
    served.params.complete = False
    assert "FAIL nothing came" in served.run("list", "alpha", code=1)


@each("name", ["a.params", "a.param", "a.parm"])
def test_what_is_saved_differs_in_nothing_and_is_applied_as_nothing(served: Held, tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    served.run("save", "alpha", str(path))
    file = parse(path.read_text(), "saved")
    assert (file.kind == "qgc") == (name == "a.params") and file.sysids == {1} and len(file.entries) == 4
    assert served.run("diff", "alpha", str(path)) == "no difference\n"
    assert "0 to set, 2 equal, 2 left alone" in served.run("apply", "alpha", str(path))
    assert served.params.set_calls == []
    served.run("save", "alpha", str(path), code=2)
    served.run("save", "alpha", str(path), "--force")


def test_an_incomplete_list_is_not_saved(served: Held, tmp_path: Path) -> None:
    served.params.complete = False
    assert "not known" in served.run("save", "alpha", str(tmp_path / "a.param"), code=1)
    assert not (tmp_path / "a.param").exists()


def test_apply_sets_what_differs_and_a_dry_run_only_says_so(served: Held, tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    path.write_text("WPNAV_SPEED,600\nFENCE_ENABLE,1\nMAV_SYSID,7\nCOMPASS_OFS_X,9\n")
    text = served.run("apply", "alpha", str(path), "--dry-run")
    assert "WPNAV_SPEED       500 -> 600" in text and "left alone (see --include)" in text
    assert served.params.set_calls == []
    assert "alpha: read again, nothing differs from the file" in served.run("apply", "alpha", str(path))
    text = served.run("apply", "alpha", str(path), "--include", "identity")
    assert "not read again: its identity was changed" in text
    assert [list(call) for call in served.params.set_calls] == [["FENCE_ENABLE", "WPNAV_SPEED"], ["SYSID_THISMAV"]]


def test_apply_lists_what_differs_when_it_has_read_again(served: Held, tmp_path: Path) -> None:
    """A PX4 changes some parameters right after it has taken them."""
    path = tmp_path / "a.param"
    path.write_text("WPNAV_SPEED,600\nFENCE_ENABLE,1\n")
    served.params.deaf.add("WPNAV_SPEED")
    text = served.run("apply", "alpha", str(path), code=1)
    assert "ok   alpha  WPNAV_SPEED       -> 600" in text
    assert "alpha: read again, 1 still differs from the file:\n  WPNAV_SPEED       500 instead of 600" in text
    reported = json.loads(served.run("apply", "alpha", str(path), "--json", code=1))["alpha"]
    assert [(d["name"], d["before"], d["value"]) for d in reported["differs"]] == [("WPNAV_SPEED", 500.0, 600.0)]


def test_diff_and_apply_see_the_second_digit(served: Held, tmp_path: Path) -> None:
    """The attack: half a unit of the last digit counted as equal, so 0.5 was 0.48 and apply said "0 to set"."""
    path = tmp_path / "a.param"
    path.write_text("COMPASS_OFS_X,4.4\n")  # it holds 4.5
    assert "COMPASS_OFS_X" in served.run("diff", "alpha", str(path), code=1).split("[calibration]")[0]
    assert "1 to set" in served.run("apply", "alpha", str(path), "--include", "all", "--dry-run")
    path.write_text("COMPASS_OFS_X    4.500000\n")
    text = served.run("diff", "alpha", str(path), code=1)  # it has more
    assert "COMPASS_OFS_X" not in text and "rounded to 6 decimals, as MAVProxy writes them" in text


@each(
    ("text", "reported"),
    [
        ("# Onboard parameters for Vehicle 9\nWPNAV_SPEED,600\n", "the file is of vehicle 9"),
        ("WPNAV_SPEED,600\nFENCE_ENABLE,0.5\n", "line 2: FENCE_ENABLE: 0.5 is not whole"),
        ("WPNAV_SPEED,fast\n", "line 1: 'fast' is not a number"),
    ],
)
def test_of_a_wrong_file_nothing_is_sent(served: Held, tmp_path: Path, text: str, reported: str) -> None:
    path = tmp_path / "a.param"
    path.write_text(text)
    assert reported in served.run("apply", "alpha", str(path), code=1)
    assert served.params.set_calls == []


def test_another_vehicles_file_can_be_insisted_on(served: Held, tmp_path: Path) -> None:
    path = tmp_path / "a.param"
    path.write_text("# Onboard parameters for Vehicle 9\nWPNAV_SPEED,600\n")
    served.run("apply", "alpha", str(path), "--force")
    assert served.params.set_calls == [{"WPNAV_SPEED": 600}]


def test_what_is_known_by_number_only_is_read_before_anything_rests_on_it(served: Held, tmp_path: Path) -> None:
    served.params.vouched = "count"
    assert "only their number was checked; --refresh reads them" in served.run("list", "alpha")
    assert served.params.refreshed == 0
    served.run("save", "alpha", str(tmp_path / "a.param"))
    assert "COMPASS_OFS_X,4.5" in (tmp_path / "a.param").read_text()
    served.run("apply", "alpha", str(tmp_path / "a.param"), "--include", "all")
    served.run("diff", "alpha", str(tmp_path / "a.param"))
    assert served.params.refreshed == 3 and served.params.set_calls == []


def test_cancel(served: Held) -> None:
    assert served.run("cancel", "alpha") == "alpha: 2 requests stopped\n"


def test_diff_of_two_files_needs_no_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SKYGCS_SOCKET", str(tmp_path / "nobody"))
    first, second = tmp_path / "a.params", tmp_path / "b.parm"
    first.write_text("1\t1\tSYSID_THISMAV\t1\t4\n1\t1\tWPNAV_SPEED\t500.000000000000000000\t9\n")
    second.write_text("MAV_SYSID 2\nWPNAV_SPEED 500\n")
    text = param("diff", str(first), str(second), code=1)
    assert "SYSID_THISMAV" in text and "(there MAV_SYSID)  [identity]" in text and "WPNAV" not in text
    assert json.loads(param("diff", str(first), str(second), "--json", code=1))[0]["second"] == 2
    assert param("diff", str(first), str(second), "--include", "settings") == "no difference\n"
    assert "cannot be read" in param("diff", str(first), str(tmp_path / "c.param"), code=1)
    param("diff", str(first), str(second), "--include", "nonsense", code=2)


def test_a_bar_shows_how_far_and_how_long() -> None:
    data = {"received": 650, "count": 1300, "percent": 50, "remaining_s": 12.4}
    text = params.bar({"vehicle": "alpha", "text": "", "data": data})
    assert text == f"alpha  [{'#' * 15}{'.' * 15}] 650/1300  12 s left"


@each(("names", "code"), [(["WPNAV_SPEED"], 0), (["WPNAV_SPEED", "NO_SUCH"], 1)])
def test_call_exits_by_the_outcome_of_each_parameter(served: Held, names: list[str], code: int) -> None:
    params = json.dumps({"targets": "alpha", "names": names})
    result = CliRunner().invoke(app, ["--socket", str(served.socket), "call", "params.get", params])
    assert result.exit_code == code, result.output


def test_call_exits_by_how_reading_a_list_went(served: Held) -> None:
    args = ["--socket", str(served.socket), "call", "params.list", '{"targets": "alpha"}']
    assert CliRunner().invoke(app, args).exit_code == 0
    served.params.complete = False
    assert CliRunner().invoke(app, args).exit_code == 1
