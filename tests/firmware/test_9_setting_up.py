"""What is done with vehicles on the bench: their onboard logs, and calibration. The last file: a calibration changes
parameters, and an ArduCopter's is ended by a reboot only."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from pymavlink import DFReader

from support.firmware_field import Field

ULog = pytest.importorskip("pyulog", reason="pip install pyulog: the reader of PX4's logs").ULog

LEAST_BYTES = 300_000
"""On disk when the link is cut: by then the log has come in part."""


CLI_S = 600.0
"""For a command: 10 MB of log beside other work of the computer took more than two minutes."""

OF_A_FLIGHT_BYTES = 1_500_000
"""The log of a flight of half a minute has 3 MB (ArduCopter) or 10 MB (PX4)."""


def on_board(field: Field, name: str) -> list[Path]:
    """The logs in the vehicle's own folder, oldest first."""
    folder = field.folder / "vehicles" / name
    found = folder.glob("log/*/*.ulg") if field.px4 else folder.glob("logs/*.BIN")
    return sorted(found)


def logged(field: Field, path: Path) -> dict[str, float]:
    """What the reader of the autopilot's own project finds in a log: messages, seconds, and the greatest height."""
    if field.px4:
        ulog = ULog(str(path))
        (position,) = (d.data for d in ulog.data_list if d.name == "vehicle_local_position")
        times = position["timestamp"]
        counted = sum(len(d.data["timestamp"]) for d in ulog.data_list)
        return {"messages": counted, "s": (times[-1] - times[0]) / 1e6, "up m": float(-position["z"].min())}
    reader = DFReader.DFReader_binary(str(path))
    count, times_us, up_m = 0, [], 0.0
    while (message := reader.recv_msg()) is not None:
        count += 1
        if message.get_type() == "CTUN":
            times_us.append(message.TimeUS)
            up_m = max(up_m, message.Alt)
    reader.data_map.close()
    reader.filehandle.close()
    return {"messages": count, "s": (times_us[-1] - times_us[0]) / 1e6, "up m": up_m}


def cli(field: Field, *words: str) -> dict[str, Any]:
    """The outcomes of a command."""
    done = field.daemon.cli(*words, "--json", timeout_s=CLI_S)
    assert done.stdout, done.stderr
    answer: dict[str, Any] = json.loads(done.stdout)
    outcomes: dict[str, Any] = answer.get("outcomes", answer)
    return outcomes


def same(field: Field, name: str, file: dict[str, Any]) -> int:
    """Compares a log that came with the vehicle's own, which may have grown since; the bytes that are equal."""
    content = Path(file["path"]).read_bytes()
    assert len(content) == file["size_bytes"] > 0
    assert any(own.read_bytes()[: len(content)] == content for own in on_board(field, name)), file
    return len(content)


def flown(field: Field) -> None:
    """Each has a log of a flight, which ends a few seconds after it."""
    if not field.px4:  # or the log grows after the flight (AP_Logger_Backend.cpp, ShouldLog: have_logged_armed)
        field.order("params.set", "all", params={"LOG_DISARMED": 0, "LOG_FILE_DSRMROT": 1})
    field.takeoff()
    time.sleep(10)
    field.land()


def closed(field: Field, name: str) -> str:
    """The id of the log of the last flight, once it grows no more. An ArduCopter may log while disarmed, too."""

    def last() -> dict[str, Any]:
        logs: list[dict[str, Any]] = cli(field, "log", "list", name)[name]["logs"]
        return max((log for log in logs if log["size_bytes"] > OF_A_FLIGHT_BYTES), key=lambda log: log["id"])

    found = [last()]

    def the_same() -> bool:
        time.sleep(2.0)
        found.append(last())
        return found[-1] == found[-2]

    field.wait(the_same, 60, "the log of its last flight grows no more")
    return str(found[-1]["id"])


def test_onboard_logs_come_byte_for_byte(field: Field, figures: dict[str, Any]) -> None:
    flown(field)
    listed = cli(field, "log", "list", "all")
    figures["listed"] = {name: len(listed[name]["logs"]) for name in field.names}
    for name in field.names:
        assert len(listed[name]["logs"]) == len(on_board(field, name)) > 0
        number = closed(field, name)
        began = time.monotonic()
        outcome = cli(field, "log", "get", name, number)[name]
        took_s = time.monotonic() - began
        assert outcome["ok"], outcome
        (file,) = outcome["files"]
        figures[name] = {"bytes": same(field, name, file), "bytes/s": round(file["size_bytes"] / took_s)}
        figures[name] |= logged(field, Path(file["path"]))
        assert figures[name]["up m"] > 5 and figures[name]["s"] > 10
        again = cli(field, "log", "get", name, number)[name]["files"]
        assert [(f["path"], f["resumed_at"]) for f in again] == [(file["path"], file["size_bytes"])]
    together = cli(field, "log", "get", "all")
    assert all(together[name]["ok"] for name in field.names), together


def test_a_log_that_was_broken_off_is_resumed(field: Field, figures: dict[str, Any]) -> None:
    flown(field)
    name, sysid = field.one, field.sysids[0]
    number = closed(field, name)
    folder = field.daemon.logs / "onboard" / name

    def part() -> int:
        return max((p.stat().st_size for p in folder.glob("*.part")), default=0)

    command = field.daemon.command("log", "get", name, number)
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as client:
        field.wait(lambda: part() > LEAST_BYTES, 60, "a part of the log is on disk")
        field.relay.cut_up, field.relay.cut_down = {sysid}, {sysid}
        client.wait(60)
        figures["client ended with"] = client.returncode
    figures["part bytes"] = part()
    assert client.returncode == 1 and part() > 0
    field.relay.clear()
    field.wait(field.connected, 30, "it is heard again")
    outcome = cli(field, "log", "get", name, number)[name]
    figures["message"] = outcome["message"]
    assert outcome["ok"], outcome
    (file,) = outcome["files"]
    figures |= {"resumed at": file["resumed_at"], "bytes": same(field, name, file)}
    assert file["resumed_at"] > 0 and part() == 0
    assert logged(field, Path(file["path"]))["up m"] > 5


def test_no_vehicle_is_calibrated_that_is_armed(ground: Field, figures: dict[str, Any]) -> None:
    ground.order("vehicles.arm", ground.one)
    try:
        for sensor in ("gyro", "level", "compass", "accel"):
            answer = ground.daemon.call("vehicles.calibrate", targets=ground.one, sensor=sensor)
            outcome = answer["outcomes"][ground.one]
            figures[sensor] = outcome["message"]
            assert outcome["result"] == "refused" and not outcome["ok"]
    finally:
        ground.order("vehicles.disarm", ground.one)


def test_gyro_and_level_are_calibrated(ground: Field, figures: dict[str, Any]) -> None:
    for sensor in ("gyro", "level"):
        began = time.monotonic()
        outcomes = cli(ground, "calibrate", "all", sensor)
        figures[sensor] = {name: outcomes[name]["message"] for name in ground.names}
        figures[f"{sensor} s"] = time.monotonic() - began
        assert all(outcomes[name]["ok"] for name in ground.names), outcomes


class Calibrating(threading.Thread):
    """A calibration of the first vehicle that waits for somebody."""

    def __init__(self, field: Field, sensor: str) -> None:
        super().__init__(name=f"calibration of {sensor}", daemon=True)
        self.began = time.monotonic()
        self._field = field
        self._sensor = sensor
        self.outcome: dict[str, Any] = {}
        self.start()

    def run(self) -> None:
        answer = self._field.daemon.call("vehicles.calibrate", targets=self._field.one, sensor=self._sensor)
        self.outcome = answer["outcomes"][self._field.one]

    def statuses(self) -> list[dict[str, Any]]:
        """What it has shown since it began."""
        events = self._field.watcher.events_since(self.began, "calibration", vehicle=self._field.one)
        return [event["data"] for event in events]

    def waits_for(self, condition: Any, what: str) -> None:
        self._field.wait(lambda: self.outcome or any(map(condition, self.statuses())), 60, what)
        assert not self.outcome, self.outcome


def arms_again(field: Field) -> None:
    """It is as before; an ArduCopter after a reboot."""
    if not field.px4:
        began = time.monotonic()
        field.order("vehicles.reboot", field.one)
        field.wait(lambda: field.watcher.events_since(began, "reboot", vehicle=field.one), 60, "it has rebooted")
    field.order("vehicles.arm", field.one, wait_s=100)
    field.order("vehicles.disarm", field.one)


def test_a_compass_calibration_is_cancelled(ground: Field, figures: dict[str, Any]) -> None:
    running = Calibrating(ground, "compass")
    running.waits_for(lambda status: status["percent"] is not None, "it shows how far it is")
    figures["shown"] = running.statuses()[-1]
    began = time.monotonic()
    outcome = ground.daemon.call("vehicles.calibrate_cancel", targets=ground.one)["outcomes"][ground.one]
    running.join(30)
    figures |= {"cancel": outcome["message"], "ended s": time.monotonic() - began, "result": running.outcome["message"]}
    assert outcome["ok"] and running.outcome["result"] == "cancelled", (outcome, running.outcome)
    ground.wait(lambda: ground.state(ground.one)["calibration"] is None, 10, "none is under way")
    arms_again(ground)


def test_accel_asks_for_its_poses(ground: Field, figures: dict[str, Any]) -> None:
    running = Calibrating(ground, "accel")
    if ground.px4:  # it lies level, finds that, and wants the others
        running.waits_for(lambda s: "level" not in s["pending"] and len(s["pending"]) == 5, "level is done")
    else:
        running.waits_for(lambda status: status["confirm"] and status["pose"] == "level", "it asks for the first pose")
        ground.order("vehicles.calibrate_confirm", ground.one)
        running.waits_for(lambda status: status["confirm"] and status["pose"] == "left", "it asks for the next pose")
    figures["shown"] = running.statuses()[-1]
    outcome = ground.daemon.call("vehicles.calibrate_cancel", targets=ground.one)["outcomes"][ground.one]
    running.join(150)
    figures |= {"cancel": outcome["message"], "result": running.outcome["message"]}
    assert running.outcome["result"] == "cancelled", running.outcome
    arms_again(ground)
