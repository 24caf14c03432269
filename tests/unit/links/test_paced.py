"""Channels into a radio: sizes, flows, and a budget that is kept over a real pseudo-terminal."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from skygcs.config import models
from skygcs.config.radio import ThirdPartyKeys
from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.radio_link.admission import ThirdPartyRules
from skygcs.core.radio_link.capacity import RadioRates
from skygcs.core.radio_link.corrections import fragments_of
from skygcs.core.radio_link.transmit_queue import Outgoing, OwnMessage, Priority, TxQueue
from skygcs.links.paced import AirBudget, flow_of, third_party_rules, wire_bytes
from skygcs.links.serial import SerialLink
from support.frames import frame
from support.hosts import RecordingHost, own, until
from support.pseudo_tty import PtyRadio
from support.routed import DIALECT
from support.rtcm import rtcm_frame
from support.table import each

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
    assert queue.budget is not None and queue.budget.rate == 2880
    values = {"rssi": 180, "remrssi": 170, "txbuf": 5, "noise": 60, "remnoise": 60, "rxerrors": 0, "fixed": 0}
    for number, (sysid, compid) in enumerate([(51, 68), (1, 1)] * 6):
        (report,) = FrameParser(DIALECT).feed_datagram(frame("RADIO_STATUS", values, sysid=sysid, compid=compid))
        air.on_radio(report, 100 * number, number * 0.7)
    assert len(air.pacer.history) == 6
    assert queue.budget.rate < 400
    air.set_baud(115200, 4.0)
    assert air.pacer.base == 5760


def test_more_vehicles_leave_the_ground_a_smaller_part_of_a_round() -> None:
    queue: TxQueue[Outgoing] = TxQueue()
    air = AirBudget(queue, RadioRates(57600, 64.0), 0.0)
    assert queue.budget is not None
    alone = queue.budget.rate
    air.set_vehicles(10, 1.0)
    assert queue.budget.rate < alone / 3
    assert air.status(1.0)["round_s"] == pytest.approx(0.912, abs=0.001)


@each("role", ["radio", "peer"])
async def test_a_serial_radio_gets_no_more_than_its_budget_and_a_cable_all(tmp_path: Path, role: str) -> None:
    radio = PtyRadio(tmp_path / "ttyRADIO")
    radio.plug_in()
    host = RecordingHost()
    config = models.SerialLinkConfig(
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


# -- what others send


def line_bytes(entry: Outgoing) -> bytes:
    assert isinstance(entry, Frame)
    return entry.raw


class Line:
    """A channel's `AirBudget` and its time."""

    def __init__(self, rules: ThirdPartyRules | None = None) -> None:
        self.queue: TxQueue[Outgoing] = TxQueue()
        self.air = AirBudget(self.queue, RadioRates(57600, 64.0, 11), 0.0, rules, DIALECT)
        self.now = 0.0

    def offer(self, message: str, priority: Priority = Priority.FORWARDED, **values: Any) -> bool:
        return self.air.offer(frame(message, values, sysid=255, compid=190), priority, self.now)

    def run(self, for_s: float) -> list[tuple[float, Outgoing, Priority]]:
        """What goes in this time."""
        end = self.now + for_s
        sent = []
        while (at := self.air.next_send_time(self.now)) is not None and at <= end:
            self.now = max(self.now, at)
            if (popped := self.air.pop(self.now)) is not None:
                sent.append((self.now, *popped))
        self.now = end
        return sent


def test_what_is_forwarded_has_its_share_and_ours_the_rest() -> None:
    line = Line()
    for second in range(60):
        for number in range(20):
            line.offer("NAMED_VALUE_FLOAT", value=20.0 * second + number + 1, name=b"x")
            line.air.offer(own_message("PARAM_REQUEST_READ", param_index=number + 1), Priority.PROTOCOL, line.now)
        line.run(1.0)
    told = line.air.status(line.now)["classes"]
    share = line.air.third_party.budget
    assert 0.9 * share.rate * 60 <= told["forwarded"]["sent_bytes"] <= share.rate * 60 + share.burst
    assert told["forwarded"]["dropped"] > 0
    assert told["protocol"]["sent"] >= 60 * 20 - 20, "half of the radio is ours, and what others send waits for us"
    assert line.air.take_lost() == told["forwarded"]["dropped"] + told["protocol"]["refused"]
    assert line.air.take_lost() == 0


def test_requests_wait_for_the_room_of_their_answers_and_go_by_themselves() -> None:
    line = Line()
    for index in range(30):
        assert line.offer("PARAM_REQUEST_READ", target_system=3, param_index=index + 1)
    assert len(line.air) == 30
    share = line.air.third_party.budget
    sent = line.run(5.0)
    answered = sum(len(line_bytes(entry)) + 37 for _, entry, _ in sent)
    assert 0.8 * share.rate * 5 <= answered <= share.rate * 5 + share.burst + 60
    assert len(line.air) == 30 - len(sent) > 0
    line.run(10.0)
    assert len(line.air) == 0


def test_a_list_is_followed_by_the_next_when_its_values_have_come() -> None:
    line = Line()
    for vehicle in (1, 2):
        line.offer("PARAM_REQUEST_LIST", target_system=vehicle, target_component=1)
    assert len(line.run(3.0)) == 1
    values = [frame("PARAM_VALUE", {"param_count": 3, "param_index": index}, sysid=1) for index in range(3)]
    line.air.heard([f for raw in values for f in FrameParser(DIALECT).feed_datagram(raw)], line.now)
    (second,) = line.run(0.1)
    assert line_bytes(second[1])[10:12] == b"\x02\x01"


def test_what_is_refused_is_no_loss_and_what_is_forgotten_is_counted() -> None:
    line = Line()
    assert not line.offer("LOG_REQUEST_LIST", target_system=3)
    assert line.offer("NAMED_VALUE_FLOAT")
    assert line.air.take_lost() == 0
    for vehicle in (1, 2, 3):
        line.offer("PARAM_REQUEST_LIST", target_system=vehicle)
    assert line.air.clear() == 4
    assert line.air.next_send_time(line.now) is None


def test_a_stop_that_finds_its_class_full_goes_as_anything_else_does() -> None:
    line = Line()
    for number in range(300):
        line.air.offer(own_message("COMMAND_LONG", param1=float(number)), Priority.EMERGENCY, line.now)
    line.air.take_lost()
    assert line.offer("COMMAND_LONG", target_system=3, command=400, param2=21196.0)
    assert line.queue.waiting(Priority.FORWARDED) == 1
    assert line.air.take_lost() == 0


def test_what_was_ordered_before_a_stop_does_not_reach_the_vehicle_after_it() -> None:
    line = Line()
    for number in range(6):  # three go as orders, the others behind everything else
        for vehicle in (3, 4):
            line.offer("COMMAND_LONG", target_system=vehicle, command=22, param7=float(number))
    line.offer("PARAM_SET", target_system=3, param_value=1.0)
    line.air.offer(own_message("COMMAND_LONG", target_system=3, command=20), Priority.COMMAND, line.now)
    line.run(0.0)
    before = len(line.queue)
    assert line.offer("COMMAND_LONG", target_system=3, command=400, param2=21196.0)
    sent = [entry for _, entry, _ in line.run(10.0)]
    assert line.air.take_lost() == before + 1 - len(sent) > 0
    names = [entry for entry in sent if isinstance(entry, Frame)]
    assert names[0].fields()["command"] == 400
    assert {f.target()[0] for f in names[1:] if f.name == "COMMAND_LONG"} == {4}
    assert "PARAM_SET" in {f.name for f in names}


def test_a_stop_for_all_overtakes_what_was_ordered_of_anyone() -> None:
    line = Line()
    for number in range(6):
        for vehicle in (3, 4):
            line.offer("COMMAND_LONG", target_system=vehicle, command=22, param7=float(number))
    assert line.offer("COMMAND_LONG", target_system=0, command=400, param2=21196.0)
    names = [entry for _, entry, _ in line.run(10.0) if isinstance(entry, Frame)]
    stop = next(n for n, f in enumerate(names) if f.fields()["command"] == 400)
    assert not names[stop + 1 :]


@each("ours", [True, False])
def test_corrections_go_whole_within_their_share_and_after_commands(ours: bool) -> None:
    line = Line()
    sent: list[tuple[float, Outgoing, Priority]] = []
    for second in range(30):
        for values in fragments_of(rtcm_frame(1077, epoch=second, body_bytes=694), second):
            if ours:
                assert line.air.offer(own_message("GPS_RTCM_DATA", **values), Priority.CORRECTION, line.now)
            else:
                assert line.offer("GPS_RTCM_DATA", **values)
        sent += line.run(0.5)
        line.air.offer(own_message("COMMAND_LONG", **COMMAND), Priority.COMMAND, line.now)
        assert line.run(0.0)[0][2] is Priority.COMMAND
        sent += line.run(0.5)
    corrections = [entry for _, entry, priority in sent if priority is Priority.CORRECTION]
    told = line.air.status(line.now)["corrections"]
    assert told["messages"] * 4 <= len(corrections) <= told["messages"] * 4 + 3
    size = sum(wire_bytes(entry, signed=False) for entry in corrections)
    assert 0.9 * 0.4 * 497 * 30 <= size <= 0.4 * 498 * 30 + 207 + 200


def test_a_fleet_file_may_give_corrections_nothing() -> None:
    line = Line(ThirdPartyRules(corrections_bytes_per_s=0.0))
    for values in fragments_of(rtcm_frame(1077, body_bytes=100), 1):
        assert not line.offer("GPS_RTCM_DATA", **values)
    assert line.run(10.0) == []


def test_the_rules_are_those_of_the_fleet_file() -> None:
    keys = ThirdPartyKeys(param_lists="deny", rates={"TIMESYNC": 0.5, "110": 0.0}, bytes_per_s=77)
    rules = third_party_rules(keys, DIALECT)
    assert rules == ThirdPartyRules("deny", "one", "deny", "deny", {111: 0.5, 110: 0.0}, 77, None)
    with pytest.raises(KeyError):
        third_party_rules(ThirdPartyKeys(rates={"TIMESYNK": 1}), DIALECT)


async def test_over_a_real_port_what_waits_goes_when_the_vehicle_before_has_answered(tmp_path: Path) -> None:
    radio = PtyRadio(tmp_path / "ttyRADIO")
    radio.plug_in()
    host = RecordingHost()
    config = models.SerialLinkConfig(name="radio", device=str(radio.path), role="radio")
    link = SerialLink(config, host, asyncio.get_running_loop())
    await link.open()
    try:
        (channel,) = link.channels
        requests = [
            frame("PARAM_REQUEST_LIST", {"target_system": vehicle, "target_component": 1}, sysid=255)
            for vehicle in (1, 2)
        ]
        for raw in requests:
            assert channel.send(raw)
        assert channel.counters()["tx_waiting"] == 1
        assert await radio.read_exactly(len(requests[0])) == requests[0]
        radio.write(frame("PARAM_VALUE", {"param_count": 1, "param_index": 0}, sysid=1))
        assert await asyncio.wait_for(radio.read_exactly(len(requests[1])), 30) == requests[1]
        assert channel.counters()["tx_waiting"] == 0
        assert not channel.send(frame("LOG_REQUEST_LIST", {"target_system": 1}, sysid=255))
        assert channel.tx_dropped == 0, "what is refused by a rule was not lost"
        assert channel.counters()["tx_frames"] == 2
    finally:
        await link.close()
        radio.pull_out()
