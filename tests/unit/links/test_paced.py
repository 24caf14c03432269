"""Channels into a radio: sizes, flows, and a budget that is kept over a real pseudo-terminal."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from skygcs.config import models
from skygcs.core.airtime import Priority, TxQueue
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.pacing import RadioRates
from skygcs.links.base import Outgoing, OwnMessage
from skygcs.links.paced import AirBudget, flow_of, wire_bytes
from skygcs.links.serial import SerialLink
from support.frames import frame
from support.hosts import RecordingHost, own, until
from support.pseudo_tty import PtyRadio
from support.routed import DIALECT

COMMAND = {"target_system": 7, "target_component": 1, "command": 400, "param1": 1.0, "confirmation": 1}


def own_message(name: str, **values: object) -> OwnMessage:
    info = DIALECT.by_name[name]
    return OwnMessage(info, info.pack(values), 255, 25)


def test_a_message_is_as_long_as_it_is_on_the_wire() -> None:
    for message in (own_message("COMMAND_LONG", **COMMAND), own_message("HEARTBEAT", type=6), own_message("PING")):
        assert wire_bytes(message, signed=False) == len(message.encode(0, 2))
        assert wire_bytes(message, signed=True) == len(message.encode(0, 2)) + 13
    assert wire_bytes(b"123", signed=True) == 3, "what is forwarded goes as it came"


def test_a_message_of_ours_is_for_the_system_it_names() -> None:
    assert flow_of(own_message("COMMAND_LONG", **COMMAND)) == 7
    assert flow_of(own_message("HEARTBEAT", type=6)) == 0


def test_the_budget_follows_the_reports_of_its_own_radio_only() -> None:
    queue: TxQueue[Outgoing] = TxQueue()
    air = AirBudget(queue, RadioRates(57600), 0.0)
    assert queue.budget is not None and queue.budget.bytes_per_s == 2880
    values = {"rssi": 180, "remrssi": 170, "txbuf": 5, "noise": 60, "remnoise": 60, "rxerrors": 0, "fixed": 0}
    for number, (sysid, compid) in enumerate([(51, 68), (1, 1)] * 6):
        (report,) = FrameParser(DIALECT).feed_datagram(frame("RADIO_STATUS", values, sysid=sysid, compid=compid))
        air.on_radio(report, 100 * number, number * 0.7)
    assert len(air.pacer.history) == 6
    assert queue.budget.bytes_per_s < 400
    air.set_baud(115200, 4.0)
    assert air.pacer.base == 5760


def test_more_vehicles_leave_the_ground_a_smaller_part_of_a_round() -> None:
    queue: TxQueue[Outgoing] = TxQueue()
    air = AirBudget(queue, RadioRates(57600, 64.0), 0.0)
    assert queue.budget is not None
    alone = queue.budget.bytes_per_s
    air.set_vehicles(10, 1.0)
    assert queue.budget.bytes_per_s < alone / 3
    assert air.status(1.0)["round_s"] == pytest.approx(0.912, abs=0.001)


@pytest.mark.parametrize("role", ["radio", "peer"])
async def test_a_serial_radio_gets_no_more_than_its_budget_and_a_cable_all(tmp_path: Path, role: str) -> None:
    radio = PtyRadio(tmp_path / "ttyRADIO")
    radio.plug_in()
    host = RecordingHost()
    config = models.SerialLink(
        name="radio",
        device=str(radio.path),
        role=role,
        air_speed_kbps=64.0,
        nodes=16,  # type: ignore[arg-type]
    )
    link = SerialLink(config, host, asyncio.get_running_loop())
    await link.open()
    try:
        (channel,) = link.channels
        for number in range(100):
            channel.send(frame("COMMAND_LONG", {**COMMAND, "param2": float(number)}))
        channel.send(own("HEARTBEAT"), Priority.EMERGENCY)
        if role == "peer":
            await until(lambda: channel.tx_frames == 101)
            return
        assert channel.air is not None
        before = channel.tx_bytes
        assert before <= channel.air.pacer.burst_bytes()
        await until(lambda: channel.tx_bytes > before)
        assert channel.tx_bytes < 1000, "the rest waits"
        assert channel.counters()["tx_waiting"] > 80
    finally:
        await link.close()
        radio.pull_out()
    assert channel.tx_dropped > 0, "what waited is counted"
