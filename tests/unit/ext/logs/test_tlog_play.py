"""`tlog play`: what goes out, when, and what never does."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from skygcs.ext.logs.player import Player
from skygcs.tlog.files import opened_log
from skygcs.tlog.format import encode_record
from skygcs.tlog.selection import Selection
from support.command_line import ran
from support.flight_log import T0_US, FlightLog
from support.frames import dialect, frame, heartbeat

DONE, FAILED, USAGE, INTERRUPTED = 0, 1, 2, 130


class Ear:
    """A UDP socket that somebody plays to."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 << 20)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.address: tuple[str, int] = self.socket.getsockname()

    def heard(self) -> list[bytes]:
        found = []
        while True:
            try:
                found.append(self.socket.recv(300))
            except BlockingIOError:
                return found


@pytest.fixture
def ear() -> Iterator[Ear]:
    ear = Ear()
    yield ear
    ear.socket.close()


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    path = tmp_path / "flight.tlog"
    path.write_bytes(FlightLog(2, 2.0).content(20.0))
    return path


run = partial(ran, "tlog", "play")


class Clock:
    """Time that passes by sleeping only."""

    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        self.now += seconds


def play(
    path: Path, ear: Ear, speed: float = 1.0, selection: Selection | None = None, everything: bool = False
) -> float:
    """How long it took, by a clock of its own."""
    clock = Clock()
    player = Player(ear.address, speed, everything, clock, clock.sleep)
    with opened_log(path, dialect()) as log:
        player.play(log, selection or Selection())
    player.close()
    return clock.now - 1000.0


def test_vehicles_are_played_in_order_and_in_time(flight: Path, ear: Ear) -> None:
    assert play(flight, ear) == pytest.approx(19.5, abs=0.01)
    found = ear.heard()
    assert len(found) == 2 * (20 * 2 + 40 * 2)
    assert {raw[5] for raw in found} == {1, 2}
    assert play(flight, ear, speed=10.0) == pytest.approx(1.95, abs=0.01)
    assert ear.heard() == found
    assert play(flight, ear, speed=0.0) < 0.1
    assert ear.heard() == found


def test_a_part_begins_at_once(flight: Path, ear: Ear) -> None:
    assert play(flight, ear, selection=Selection(begin=10.0, end=15.0)) == pytest.approx(4.5, abs=0.01)
    assert len(ear.heard()) == 2 * (5 * 2 + 10 * 2)


def test_no_order_and_no_ground_station_is_played_unasked(tmp_path: Path, ear: Ear) -> None:
    order = frame("COMMAND_LONG", {"target_system": 1, "command": 400, "param1": 1.0}, sysid=255, compid=190)
    bad = bytearray(heartbeat(1))
    bad[-1] ^= 1
    pieces = [heartbeat(1), order, heartbeat(255, 190, type=6, autopilot=8), bytes(bad), heartbeat(1)]
    log = tmp_path / "in.tlog"
    log.write_bytes(b"".join(encode_record(T0_US + n, raw) for n, raw in enumerate(pieces)))
    reported = run(log, f"127.0.0.1:{ear.address[1]}", "--speed", "0")
    assert ear.heard() == [heartbeat(1), heartbeat(1)]
    assert reported.stdout == f"{log}: 2 frames sent, up to 0.0 s\n"
    assert "3 frames not played: wrong CRCs, orders" in reported.stderr and "wrong CRC" in reported.stderr
    run(log, ear.address[1], "--speed", "0", "--all")
    assert ear.heard() == [pieces[0], pieces[1], pieces[2], pieces[4]]


def test_a_vehicle_is_its_autopilot_and_who_relays_orders_under_its_system_id_is_not(tmp_path: Path, ear: Ear) -> None:
    """Mission Planner relays as 1/190, and a companion may order all: with target 0, which names no vehicle."""

    def order(compid: int, target: int) -> bytes:
        return frame("COMMAND_LONG", {"target_system": target, "command": 400, "param1": 1.0}, sysid=1, compid=compid)

    camera = heartbeat(1, compid=100, type=30, autopilot=8)
    station = heartbeat(1, compid=230, type=6, autopilot=8)
    answer = frame("COMMAND_ACK", {"command": 400, "target_system": 0}, sysid=1)
    played = [heartbeat(1), answer, camera, heartbeat(1, compid=2), frame("ATTITUDE", sysid=1, compid=191)]
    held_back = [
        *(order(190, 0), order(190, 1), order(191, 0), order(191, 1), order(1, 1), frame("SYS_STATUS", compid=190)),
        *(station, frame("ATTITUDE", sysid=1, compid=230)),
    ]
    log = tmp_path / "in.tlog"
    pieces = [*played, *held_back]
    log.write_bytes(b"".join(encode_record(T0_US + n, raw) for n, raw in enumerate(pieces)))
    run(log, f"127.0.0.1:{ear.address[1]}", "--speed", "0")
    assert ear.heard() == played
    run(log, f"127.0.0.1:{ear.address[1]}", "--speed", "0", "--vehicle", "1/2")
    assert ear.heard() == [heartbeat(1, compid=2)]


def test_a_loop_goes_on_until_ctrl_c(flight: Path, ear: Ear, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds = iter(range(3))

    def play(player: Player, log: object, selection: object) -> int:
        player.played.rounds += 1
        player.played.sent += 5
        if next(rounds) == 2:
            raise KeyboardInterrupt
        return 5

    monkeypatch.setattr(Player, "play", play)
    reported = run(flight, ear.address[1], "--loop", code=INTERRUPTED)
    assert "ended by Ctrl-C: 15 frames sent, up to 0.0 s, round 3" in reported.stderr


def test_a_raw_capture_is_played_by_its_senders_clocks(tmp_path: Path, ear: Ear) -> None:
    log = tmp_path / "in.raw"
    frames = [heartbeat(1), *(frame("ATTITUDE", {"time_boot_ms": 5000 + 500 * n}, seq=n) for n in range(5))]
    log.write_bytes(b"".join(frames))
    assert play(log, ear) == pytest.approx(2.0, abs=0.01)
    assert ear.heard() == frames


def test_what_can_not_be_played_says_why(flight: Path, ear: Ear) -> None:
    assert "nothing to play" in run(flight, ear.address[1], "--vehicle", "9", code=FAILED).stderr
    for address in ("nowhere", "127.0.0.1:0", "127.0.0.1:99999", ":x"):
        assert "is not [HOST:]PORT" in run(flight, address, code=USAGE).output, address
    assert "--speed" in run(flight, "--speed", "-1", code=USAGE).output
    assert "no.such.host.invalid:14550" in run(flight, "no.such.host.invalid:14550", code=FAILED).stderr
