"""What becomes of others' frames before a radio: orders, emergencies, streams, repeats, rates, refusals."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any

import pytest

from skygcs.core.mavlink.frame import Frame, check
from skygcs.core.radio_link.admission import (
    MAX_SOURCES,
    PER_VEHICLE_BURST,
    REPORT_AFTER,
    SOURCE_GONE_S,
    AdmissionDecision,
    ThirdPartyRules,
    ThirdPartyTraffic,
)
from skygcs.core.radio_link.transmit_queue import BOUND, Priority, TxQueue
from skygcs.core.radio_link.turn_gate import FILE_SILENCE_S, LONGEST_FILE_S
from support.frames import dialect, frame
from support.table import each

QGC = 255 << 8 | 190
MAVROS = 1 << 8 | 240
RATE = 500.0


def parsed(raw: bytes) -> Frame:
    found, _ = check(raw, dialect().messages)
    assert found is not None
    return found


class Radio:
    """The traffic, and a queue that keeps what it lets through until `send` is called."""

    def __init__(self, rules: ThirdPartyRules | None = None, bytes_per_s: float = RATE) -> None:
        self.traffic = ThirdPartyTraffic(rules or ThirdPartyRules(), bytes_per_s, 0.0)
        self.queue: TxQueue[bytes] = TxQueue()
        self.queue.forwarded = self.traffic.budget
        self.now = 0.0

    def offer(self, name: str, source: int = QGC, version: int = 2, **values: Any) -> AdmissionDecision:
        raw = frame(name, values, sysid=source >> 8, compid=source & 0xFF, version=version)
        decision = self.traffic.judge(parsed(raw), self.now, self.queue.holds)
        if decision.outcome == "send":
            self.put(raw, decision)
        return decision

    def put(self, raw: bytes, found: AdmissionDecision) -> None:
        costs = {"size": len(raw), "flow": found.flow, "answer_bytes": found.answer_bytes}
        self.queue.offer(raw, found.priority, self.now, found.key, **costs)

    def poll(self) -> list[bytes]:
        released = self.traffic.poll(self.now)
        if released is None:
            return []
        self.put(released[0].raw, released[1])
        return [released[0].raw]

    def sent(self) -> list[tuple[bytes, Priority]]:
        """Everything that the queue gives now."""
        return list(iter(lambda: self.queue.pop(self.now), None))

    def counts(self, source: int = QGC) -> dict[str, Any]:
        name = f"{source >> 8}/{source & 0xFF}"
        (told,) = [s for s in self.traffic.status(self.now)["sources"] if s["source"] == name]
        return {"sent": told["sent"], **told["counts"]}


def command(target: int = 3, command: int = 22, confirmation: int = 0, **params: float) -> dict[str, Any]:
    return {"target_system": target, "target_component": 1, "command": command, "confirmation": confirmation, **params}


FORCED_DISARM = {"command": 400, "param2": 21196.0}


# -- orders and emergencies


@each("version", [1, 2])
def test_an_operators_order_goes_as_an_order_and_a_request_behind_it(version: int) -> None:
    radio = Radio()
    for name, values, priority in (
        ("COMMAND_LONG", command(), Priority.COMMAND),
        ("COMMAND_INT", {"target_system": 4, "command": 192}, Priority.COMMAND),
        ("SET_MODE", {"target_system": 5, "custom_mode": 4}, Priority.COMMAND),
        *(("COMMAND_LONG", command(command=asked), Priority.FORWARDED) for asked in (512, 519, 520)),
        ("COMMAND_LONG", command(target=6, command=526), Priority.COMMAND),  # STORAGE_FORMAT erases a card
    ):
        sent_as = version if name == "COMMAND_LONG" and values == command() else 2
        assert radio.offer(name, version=sent_as, **values).priority is priority, (name, values)


@pytest.fixture
def radio() -> Radio:
    return Radio()


def test_more_orders_to_one_vehicle_than_a_person_gives_wait_like_anything_else_in_their_order(radio: Radio) -> None:
    given = [radio.offer("COMMAND_LONG", **command(param1=float(n))).priority for n in range(1, 6)]
    assert given == [Priority.COMMAND] * int(PER_VEHICLE_BURST) + [Priority.FORWARDED] * 2
    assert radio.offer("COMMAND_LONG", **command(target=4)).priority is Priority.COMMAND, "others have their own rate"
    radio.now = 10.0
    late = radio.offer("COMMAND_LONG", **command(param1=9.0))
    assert late.priority is Priority.FORWARDED, "it is not to overtake what was ordered before it"
    orders = [raw for raw, _ in radio.sent() if parsed(raw).target()[0] == 3]
    values = [parsed(raw).payload[:4] for raw in orders]
    assert values == [frame("COMMAND_LONG", {"param1": float(n)})[10:14] for n in (1, 2, 3, 4, 5, 9)]
    assert radio.offer("COMMAND_LONG", **command(param1=10.0)).priority is Priority.COMMAND


def test_a_repeated_order_takes_its_own_place_and_off_between_two_ons_is_kept(radio: Radio) -> None:
    for confirmation in range(4):
        radio.offer("COMMAND_LONG", **command(confirmation=confirmation))
    assert radio.counts() == {"sent": 4, "repeated": 3}
    assert len(radio.queue) == 1
    for param1 in (1.0, 0.0, 1.0):
        radio.offer("COMMAND_LONG", **command(target=4, command=400, param1=param1))
    on_off_on = [parsed(raw).payload[:4].rstrip(b"\0") for raw, _ in radio.sent()][1:]
    assert on_off_on == [b"\0\0\x80?", b"", b"\0\0\x80?"]
    parameters = Radio()
    for value in (1.0, 2.0, 1.0, 1.0):
        parameters.offer("PARAM_SET", target_system=3, param_id=b"X", param_value=value)
    assert [raw[10:14] for raw, _ in parameters.sent()] == [b"\0\0\x80?", b"\0\0\0@", b"\0\0\x80?"]


@each("name", ["COMMAND_LONG", "COMMAND_INT"])
def test_who_stops_motors_in_the_air_goes_before_all_and_is_never_refused(name: str) -> None:
    rules = ThirdPartyRules(rates_hz={76: 0.0, 75: 0.0})
    radio = Radio(rules)
    stops = [radio.offer(name, target_system=3, **FORCED_DISARM)]
    assert radio.offer(name, target_system=3, command=185, param1=1.0).priority is Priority.EMERGENCY
    for number in range(40):
        radio.sent()
        stops.append(radio.offer(name, target_system=3, **FORCED_DISARM))
        assert radio.offer(name, target_system=10 + number, **FORCED_DISARM).priority is Priority.EMERGENCY
    assert {stop.outcome for stop in stops} == {"send"}
    given = [stop.priority for stop in stops]
    assert given.count(Priority.EMERGENCY) == PER_VEHICLE_BURST - 1
    assert given == sorted(given), "further ones go as orders, and as anything else when those are used up"
    assert set(given) == {Priority.EMERGENCY, Priority.COMMAND, Priority.FORWARDED}
    assert radio.offer(name, target_system=3, command=400, param1=1.0, param2=21196.0).outcome == "refuse", "it arms"


def test_an_order_after_a_stop_does_not_overtake_it(radio: Radio) -> None:
    for _ in range(30):  # each finds the one before gone
        last = radio.offer("COMMAND_LONG", **{**command(), **FORCED_DISARM})
        if last.priority is not Priority.FORWARDED:
            radio.sent()
    assert last.priority is Priority.FORWARDED
    assert radio.offer("COMMAND_LONG", **command(command=400, param1=1.0)).priority is Priority.FORWARDED


# -- streams, heartbeats


@each("name", ["SET_POSITION_TARGET_LOCAL_NED", "MANUAL_CONTROL", "RC_CHANNELS_OVERRIDE", "ODOMETRY"])
def test_of_a_stream_the_newest_waits_for_each_vehicle_and_source(name: str) -> None:
    radio = Radio()
    field = {"MANUAL_CONTROL": "target", "ODOMETRY": None}.get(name, "target_system")
    varied = {"MANUAL_CONTROL": "x", "RC_CHANNELS_OVERRIDE": "chan1_raw"}.get(name, "x")
    for number in range(30):
        for source in (QGC, MAVROS):
            for vehicle in (3, 4):
                values: dict[str, Any] = {varied: number + 1}
                radio.offer(name, source, **values, **({field: vehicle} if field else {}))
    sent = [raw for raw, _ in radio.sent()]
    assert len(sent) == (2 if field is None else 4)
    assert all(dialect().find(name).unpack(raw[10 : 10 + raw[1]])[varied] == 30 for raw in sent)


def test_others_heartbeats_go_seldom_and_those_of_our_own_system_not_at_all(radio: Radio) -> None:
    radio.traffic.own_sysid = 255
    for _ in range(60):
        radio.now += 1.0
        radio.offer("HEARTBEAT", QGC, type=6)
        radio.offer("HEARTBEAT", 254 << 8 | 190, type=6)
        radio.sent()
    assert radio.counts(QGC)["needless"] == 60
    assert 29 <= radio.counts(254 << 8 | 190)["sent"] <= 32
    radio.traffic.own_sysid = None  # ours does not go: theirs must
    radio.now += 1.0
    assert radio.offer("HEARTBEAT", QGC, type=6).outcome == "send"


# -- rates


def test_clock_messages_are_thinned_per_source_and_it_is_told_how_fast_they_came(radio: Radio) -> None:
    for _ in range(600):
        radio.now += 0.1
        radio.offer("TIMESYNC", MAVROS, tc1=int(radio.now * 1e9))
        if radio.now < 30:
            radio.offer("TIMESYNC", QGC, tc1=int(radio.now * 1e9))
    assert 12 <= radio.counts(MAVROS)["sent"] <= 14
    first, second = radio.traffic.notes
    assert (first.kind, first.source, first.msgid) == ("thinned", MAVROS, 111)
    assert second.source == QGC
    assert first.hz == pytest.approx(10, rel=0.3)
    assert radio.counts(MAVROS)["thinned"] > REPORT_AFTER


@each("number", [3, 50])
def test_some_at_once_are_no_rate_to_tell_of(number: int) -> None:
    radio = Radio()
    for n in range(number):
        radio.now += 0.001
        radio.offer("TIMESYNC", tc1=n + 1)
    assert not radio.traffic.notes


def test_a_rate_that_is_told_counts_those_that_go_too_and_a_usual_heartbeat_is_thinned_without_a_word() -> None:
    radio = Radio()
    for _ in range(30):
        radio.now += 1.0
        radio.offer("HEARTBEAT", QGC, type=6)
    assert radio.counts(QGC)["thinned"] >= 14 and not radio.traffic.notes
    for n in range(20):
        radio.now += 1.0
        radio.offer("PING", time_usec=n + 1)
    (note,) = radio.traffic.notes
    assert note.hz == pytest.approx(1.0, rel=0.2)


def test_a_dialogue_is_slowed_by_what_its_answers_cost_and_loses_nothing(radio: Radio) -> None:
    for _ in range(2):  # requested once more: nothing waits twice
        for index in range(30):
            radio.offer("PARAM_REQUEST_READ", target_system=3, param_index=index)
    assert radio.counts() == {"sent": 60, "repeated": 30}
    first = radio.sent()
    sent, size = len(first), len(first[0][0]) + 37
    assert sent == int(radio.traffic.budget.burst / size)
    assert len(radio.queue) == 30 - sent
    while (at := radio.queue.next_send_time(radio.now)) is not None:
        radio.now = at
        sent += len(radio.sent())
    assert sent == 30
    assert radio.now == pytest.approx((30 * size - radio.traffic.budget.burst) / radio.traffic.budget.rate, rel=0.1)


def test_a_flood_of_requests_loses_its_own_oldest(radio: Radio) -> None:
    for index in range(200):
        radio.offer("PARAM_REQUEST_READ", target_system=3, param_index=index)
    radio.offer("PARAM_REQUEST_READ", MAVROS, target_system=3, param_index=1)
    dropped = radio.queue.counters[Priority.FORWARDED].dropped
    assert dropped == 201 - BOUND[Priority.FORWARDED]
    sources = [parsed(raw).sysid for raw, _ in radio.sent()]
    assert MAVROS >> 8 in sources, "another program's request is not among the lost ones"


def test_a_fleet_files_rate_is_laid_over_the_built_in_one_and_zero_refuses() -> None:
    radio = Radio(ThirdPartyRules(rates_hz={111: 5.0, 110: 0.0, 82: 1.0}))
    for _ in range(100):
        radio.now += 0.1
        radio.offer("TIMESYNC", tc1=int(radio.now * 1e9))
        radio.offer("SET_ATTITUDE_TARGET", target_system=3, thrust=radio.now)
        radio.sent()
    assert radio.offer("FILE_TRANSFER_PROTOCOL", target_system=3).outcome == "refuse"
    assert radio.counts()["refused_rate"] == 1
    assert radio.traffic.notes[-1].kind == "rate"
    sent = radio.counts()["sent"]
    assert 48 + 10 <= sent <= 80 + 12


# -- refused


@each(
    ("name", "values"),
    [
        ("REQUEST_DATA_STREAM", {"req_stream_id": 0, "req_message_rate": 4, "start_stop": 1}),
        ("COMMAND_LONG", {"command": 511, "param1": 33.0, "param2": 20000.0}),
        ("COMMAND_INT", {"command": 511, "param1": 33.0}),
    ],
)
def test_nobody_else_sets_the_streams_that_are_planned(name: str, values: dict[str, Any]) -> None:
    radio = Radio()
    for _ in range(9):
        assert radio.offer(name, target_system=3, **values).outcome == "refuse"
    (note,) = radio.traffic.notes
    assert (note.kind, note.source, note.target) == ("streams", QGC, 3)
    assert radio.counts()["refused_streams"] == 9
    radio.traffic.set_unplanned({3})
    assert radio.offer(name, target_system=3, **values).outcome == "send"
    assert Radio(ThirdPartyRules(streams="allow")).offer(name, target_system=3, **values).outcome == "send"


def test_logs_are_not_downloaded_unless_the_fleet_file_says_so(radio: Radio) -> None:
    for name in ("LOG_REQUEST_LIST", "LOG_REQUEST_DATA", "LOG_ERASE"):
        assert radio.offer(name, target_system=3).outcome == "refuse"
    assert radio.counts() == {"sent": 0, "refused_logs": 3}
    assert len(radio.traffic.notes) == 1
    assert Radio(ThirdPartyRules(logs="allow")).offer("LOG_REQUEST_LIST", target_system=3).outcome == "send"


def file_request(system: int, opcode: int = 15, seq: int = 0) -> dict[str, Any]:
    return {"target_system": system, "target_component": 1, "payload": [seq, 0, 0, opcode, 0]}


def test_one_vehicle_at_a_time_sends_files_for_as_long_as_something_of_them_passes(radio: Radio) -> None:
    assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(1)).outcome == "send"
    for _ in range(20):  # a burst: nothing goes up, and parts come down
        radio.now += 2.0
        assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(2)).outcome == "refuse"
        radio.traffic.on_file_part(2, radio.now)
        radio.traffic.on_file_part(1, radio.now)
    assert radio.traffic.status(radio.now)["files"]["running"] == 1
    assert radio.counts()["refused_turn"] == 20
    assert [(note.kind, note.target) for note in radio.traffic.notes] == [("turn", 2)]
    assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(2, opcode=1)).outcome == "send", "it ends a session"
    radio.now += FILE_SILENCE_S + 0.1
    radio.traffic.on_file_part(1, radio.now)
    assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(2)).outcome == "send"
    assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(1, seq=9)).outcome == "refuse"


def test_a_file_without_end_gives_way_to_who_asks_after_a_while(radio: Radio) -> None:
    while radio.now < LONGEST_FILE_S:
        assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(1)).outcome != "refuse"
        radio.now += 2.0
    assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(2)).outcome != "refuse"
    assert radio.offer("FILE_TRANSFER_PROTOCOL", **file_request(1)).outcome == "refuse"


def test_files_of_all_or_of_none() -> None:
    allowed, denied = Radio(ThirdPartyRules(files="allow")), Radio(ThirdPartyRules(files="deny"))
    assert [allowed.offer("FILE_TRANSFER_PROTOCOL", **file_request(v)).outcome for v in (1, 2)] == ["send", "send"]
    assert denied.offer("FILE_TRANSFER_PROTOCOL", **file_request(1)).outcome == "refuse"
    assert denied.counts() == {"sent": 0, "refused_files": 1}


def test_corrections_are_somebody_elses(radio: Radio) -> None:
    assert radio.offer("GPS_RTCM_DATA", len=3, data=[1, 2, 3]).outcome == "correction"
    assert radio.counts() == {"sent": 0, "corrections": 1}


# -- parameter lists


def test_one_list_at_a_time_and_the_next_when_it_is_through(radio: Radio) -> None:
    ruled = [radio.offer("PARAM_REQUEST_LIST", target_system=v, target_component=1).outcome for v in (1, 2, 3)]
    assert ruled == ["send", "wait", "wait"]
    assert radio.offer("PARAM_REQUEST_LIST", target_system=1, target_component=1).outcome == "wait"
    assert radio.offer("PARAM_REQUEST_LIST", MAVROS, target_system=2, target_component=1).outcome == "wait"
    assert radio.traffic.status(0.0)["param_lists"]["waiting"] == [2, 3]
    assert [(n.kind, n.source, n.target) for n in radio.traffic.notes] == [("held", QGC, 2)]
    for index in range(5):
        assert radio.poll() == []
        radio.traffic.on_param_value(1, 1, index, 5, radio.now)
    (released,) = radio.poll()
    assert parsed(released).target()[0] == 2
    assert radio.traffic.status(radio.now)["param_lists"]["finished"] == 1


def test_a_list_of_all_vehicles_at_once_is_refused() -> None:
    assert Radio().offer("PARAM_REQUEST_LIST", target_system=0).outcome == "refuse"
    assert Radio(ThirdPartyRules(param_lists="deny")).offer("PARAM_REQUEST_LIST", target_system=1).outcome == "refuse"
    allowed = Radio(ThirdPartyRules(param_lists="allow"))
    assert {allowed.offer("PARAM_REQUEST_LIST", target_system=v).outcome for v in range(9)} == {"send"}


def test_who_has_gone_is_not_waited_for(radio: Radio) -> None:
    for vehicle in (1, 2, 3):
        source = QGC if vehicle < 3 else MAVROS
        radio.offer("PARAM_REQUEST_LIST", source, target_system=vehicle)
    radio.now = SOURCE_GONE_S + 1
    radio.offer("HEARTBEAT", MAVROS, type=18)
    (released,) = radio.poll()
    assert parsed(released).target()[0] == 3
    assert radio.traffic.status(radio.now)["param_lists"]["abandoned"] == 1


# -- sources


def test_more_sources_than_are_told_apart_share_one_rate(radio: Radio) -> None:
    for number in range(MAX_SOURCES * 3):
        radio.offer("PING", number << 8 | 7, seq=number)
    told = radio.traffic.status(0.0)["sources"]
    assert len(told) == MAX_SOURCES + 1
    (others,) = [s for s in told if s["source"] == "others"]
    assert others["sent"] == 1
    radio.now = 100.0
    radio.offer("PING", 250 << 8, seq=1)
    assert radio.counts(250 << 8)["sent"] == 1, "who has been silent makes room"


def test_in_the_queue_sources_are_served_alike(radio: Radio) -> None:
    for index in range(8):
        for vehicle in range(1, 9):
            radio.offer("MISSION_SET_CURRENT", QGC, target_system=vehicle, seq=index)
    for name in (b"A", b"B"):
        radio.offer("PARAM_SET", MAVROS, target_system=3, param_id=name, param_value=1.0)
    flows: list[Hashable] = []
    while (entry := radio.queue.pop(radio.now)) is not None or len(radio.queue):
        if entry is None:
            radio.now += 0.1
        elif entry[1] is Priority.FORWARDED:
            flows.append(parsed(entry[0]).sysid << 8 | parsed(entry[0]).compid)
    assert MAVROS in flows[:2]
    assert flows[:6].count(MAVROS) == 2
