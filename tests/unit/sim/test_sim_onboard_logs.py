"""The rules of the table in `skygcs.sim.onboard_logs`, each with both firmwares."""

from __future__ import annotations

from typing import Any

from skygcs.sim.onboard_logs import SIZES_BYTES, OnboardLogs
from support.table import each


class Wire:
    def __init__(self) -> None:
        self.sent: list[tuple[str, Any]] = []

    def send(self, name: str, fields: dict[str, Any], tail: bytes = b"") -> None:
        self.sent.append((name, (fields["id"], fields.get("ofs"), fields.get("count"))))

    def say(self, severity: int, text: str) -> None:
        self.sent.append(("STATUSTEXT", text))

    def take(self) -> list[tuple[str, Any]]:
        sent, self.sent = self.sent, []
        return sent


def vehicle(px4: bool) -> tuple[OnboardLogs, Wire]:
    wire: Any = Wire()
    return OnboardLogs(wire, 7, px4=px4, unix_s=10_000_000), wire


def ask(logs: OnboardLogs, name: str, *, armed: bool = False, ticks: int = 100, **fields: int) -> None:
    logs.hear(name, fields, armed=armed)
    for _ in range(ticks):
        logs.step(armed=armed)


def test_an_armed_arducopter_says_so_once_and_sends_nothing() -> None:
    logs, wire = vehicle(px4=False)
    ask(logs, "LOG_REQUEST_LIST", start=0, end=0xFFFF, armed=True)
    ask(logs, "LOG_REQUEST_DATA", id=1, ofs=0, count=90, armed=True)
    assert wire.take() == [("STATUSTEXT", "Disarm for log download")]
    logs, wire = vehicle(px4=True)
    ask(logs, "LOG_REQUEST_LIST", start=0, end=0xFFFF, armed=True)
    assert len(wire.take()) == len(SIZES_BYTES)


@each("px4", [True, False])
def test_numbers_begin_where_the_firmware_counts_from(px4: bool) -> None:
    logs, wire = vehicle(px4)
    ask(logs, "LOG_REQUEST_LIST", start=2, end=2)
    assert [entry[1][0] for entry in wire.take()] == [2]
    ask(logs, "LOG_REQUEST_LIST", start=0, end=1)
    assert [entry[1][0] for entry in wire.take()] == ([0, 1, 2] if px4 else [1])


def test_only_px4_wants_a_list_first() -> None:
    logs, wire = vehicle(px4=True)
    ask(logs, "LOG_REQUEST_DATA", id=0, ofs=0, count=90)
    assert wire.take() == []
    logs, wire = vehicle(px4=False)
    ask(logs, "LOG_REQUEST_DATA", id=1, ofs=0, count=90)
    assert wire.take() == [("LOG_DATA", (1, 0, 90))]


@each("px4", [True, False])
def test_a_request_while_it_sends(px4: bool) -> None:
    logs, wire = vehicle(px4)
    first = 0 if px4 else 1
    ask(logs, "LOG_REQUEST_LIST", start=0, end=0xFFFF)
    wire.take()
    ask(logs, "LOG_REQUEST_DATA", id=first, ofs=0, count=45_000, ticks=1)
    ask(logs, "LOG_REQUEST_DATA", id=first, ofs=9000, count=90, ticks=1000)
    offsets = [entry[1][1] for entry in wire.take()]
    assert offsets == ([*range(0, 1800, 90), 9000] if px4 else list(range(0, 45_000, 90)))


@each("px4", [True, False])
def test_behind_the_end(px4: bool) -> None:
    logs, wire = vehicle(px4)
    ask(logs, "LOG_REQUEST_LIST", start=0, end=0xFFFF)
    wire.take()
    ask(logs, "LOG_REQUEST_DATA", id=2 if px4 else 3, ofs=8, count=90)
    assert wire.take() == ([] if px4 else [("LOG_DATA", (3, 8, 0))])
    ask(logs, "LOG_REQUEST_DATA", id=99, ofs=0, count=90)
    assert wire.take() == []
