"""Which channel supplies a vehicle's state: the table of `core.routing.state_source`, row by row."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.routing.state_source import KNOWN_BY, MAX_CHANNELS, SourceReport, StateSource
from support.routed import DIALECT, message

AIR, WIFI, PEER = 1, 2, 3
ARDUPILOT, PX4 = 3, 12
HOME = (43.78, -79.46, 190.0)


def parsed(data: bytes) -> Frame:
    (frame,) = FrameParser(DIALECT).feed_datagram(data)
    return frame


class Machine:
    """A vehicle with a clock and a place, whose frames are numbered per radio."""

    def __init__(self, booted_at: float = 0.0, east_m: float = 0.0, **shown: int) -> None:
        self.booted_at = booted_at
        self.east_m = east_m
        self.shown = {"type": 2, "autopilot": ARDUPILOT, "base_mode": 0x81, "custom_mode": 4, **shown}
        self.seq = 0

    def _say(self, name: str, **values: Any) -> Frame:
        self.seq = (self.seq + 1) & 0xFF
        return parsed(message(name, 1, 1, self.seq, **values))

    def heartbeat(self, **shown: int) -> Frame:
        return self._say("HEARTBEAT", **{**self.shown, **shown}, system_status=4, mavlink_version=3)

    def attitude(self, now: float) -> Frame:
        return self._say("ATTITUDE", time_boot_ms=self._boot_ms(now))

    def position(self, now: float, speed_mps: float = 0.0) -> Frame:
        lon = HOME[1] + self.east_m / (111_320.0 * math.cos(math.radians(HOME[0])))
        return self._say(
            "GLOBAL_POSITION_INT",
            time_boot_ms=self._boot_ms(now),
            lat=round(HOME[0] * 1e7),
            lon=round(lon * 1e7),
            alt=round(HOME[2] * 1e3),
            vx=round(speed_mps * 100),
        )

    def _boot_ms(self, now: float) -> int:
        return round((now - self.booted_at) * 1000) % 2**32


class Net:
    """Channels of one vehicle; ``counted`` are the channels of the frames that counted."""

    def __init__(self, **source: Any) -> None:
        self.now = 1000.0
        self.state = StateSource(AIR, "air", source.pop("known", None), self.now, **source)
        self.links = {AIR: "air", WIFI: "wifi", PEER: "udp"}
        self.counted: list[int] = []
        self.reports: list[SourceReport] = []

    def hear(self, channel_id: int, frame: Frame, of: int | None = None) -> bool:
        counts = self.state.accepts(channel_id, self.links[channel_id], frame, self.now, of=of)
        if counts:
            self.counted.append(channel_id)
        self._take()
        return counts

    def second(self, machine: Machine, *channels: int, seconds: int = 1, heartbeats: bool = True) -> None:
        """A heartbeat, an attitude and a position a second on these channels."""
        for _ in range(seconds):
            self.now += 1.0
            for channel_id in channels:
                if heartbeats:
                    self.hear(channel_id, machine.heartbeat())
                self.hear(channel_id, machine.attitude(self.now))
                self.hear(channel_id, machine.position(self.now))
            self.tick()

    def tick(self) -> None:
        self.state.tick(self.now)
        self.state.choose(lambda channel_id: None, self.now)
        self._take()

    def kinds(self) -> list[str]:
        return [r.kind for r in self.reports]

    def _take(self) -> None:
        self.reports += self.state.reports
        self.state.reports.clear()


def both(net: Net, one: Machine, other: Machine, seconds: int, channel: int = WIFI) -> None:
    """Two machines, each on its channel."""
    for _ in range(seconds):
        net.second(one, AIR)
        net.now -= 1.0
        net.second(other, channel)


def test_the_present_channel_stays_while_it_is_heard() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI, seconds=60)
    assert set(net.counted) == {AIR} and net.kinds() == []


def test_another_one_takes_over_when_it_is_silent_and_back() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI, seconds=5)
    since = net.now
    while net.state.present_id == AIR:
        net.second(vehicle, WIFI)
    assert 2.0 < net.now - since <= 4.0
    net.second(vehicle, AIR, WIFI, seconds=5)
    assert net.state.present_id == WIFI, "it stays"
    net.second(vehicle, AIR, seconds=5)
    assert net.state.present_id == AIR
    assert net.kinds() == ["switched", "switched"]
    assert (net.reports[0].channel_id, net.reports[0].present_id) == (WIFI, AIR)


def test_a_vehicle_that_moved_in_the_meantime_is_the_same() -> None:
    net, vehicle = Net(), Machine()
    net.hear(AIR, vehicle.heartbeat())
    net.hear(AIR, vehicle.position(net.now, speed_mps=15.0))
    vehicle.east_m = 60.0
    net.now += 4.0
    net.hear(WIFI, vehicle.heartbeat())
    assert net.hear(WIFI, vehicle.position(net.now, speed_mps=15.0))
    assert net.kinds() == ["switched"]


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(Machine(booted_at=600.0), id="another clock"),
        pytest.param(Machine(east_m=500.0), id="elsewhere"),
        pytest.param(Machine(autopilot=PX4), id="another firmware"),
    ],
)
def test_another_machine_takes_over_only_when_the_vehicle_is_lost_and_as_a_new_start(other: Machine) -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, seconds=5)
    since = net.now
    while net.state.present_id == AIR:
        net.second(other, WIFI)
    assert 5.0 < net.now - since <= 6.0
    assert net.kinds() == ["replaced"]
    both(net, vehicle, other, 6)
    assert net.state.present_id == WIFI
    assert net.kinds() == ["replaced", "duplicate"], "the first one comes back"


def test_a_satellite_channel_is_given_longer() -> None:
    net, vehicle = Net(), Machine()
    other = Machine(booted_at=600.0)
    net.hear(AIR, vehicle._say("HIGH_LATENCY2", type=2, autopilot=ARDUPILOT))
    for _ in range(15):
        net.second(other, WIFI)
        assert net.state.present_id == AIR
    for _ in range(8):
        net.second(other, WIFI)
    assert net.state.present_id == WIFI


def test_without_a_clock_of_its_own_another_channel_waits_until_the_vehicle_is_lost() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, seconds=5)
    for _ in range(5):
        net.now += 1.0
        assert not net.hear(WIFI, vehicle.heartbeat())
    net.now += 1.0
    assert net.hear(WIFI, vehicle.heartbeat())
    assert net.kinds() == ["switched"]


@pytest.mark.parametrize(("other", "kinds"), [(Machine(), []), (Machine(booted_at=600.0), ["replaced"])])
def test_one_that_took_over_unseen_is_compared_as_soon_as_it_shows_a_clock(other: Machine, kinds: list[str]) -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, seconds=5)
    net.now += 6.0
    net.hear(WIFI, other.heartbeat())
    net.hear(WIFI, other.attitude(net.now))
    net.hear(WIFI, other.attitude(net.now))
    assert net.kinds() == ["switched", *kinds]


def test_a_closed_channel_is_followed_at_once_unless_the_other_one_contradicts() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, seconds=5)
    net.state.closed(AIR)
    net.now += 0.3
    assert net.hear(WIFI, vehicle.heartbeat())
    net, bench = Net(), Machine(booted_at=900.0)
    both(net, vehicle, bench, 6)
    net.state.closed(AIR)
    net.now += 0.3
    assert not net.hear(WIFI, bench.heartbeat())
    net.second(bench, WIFI, seconds=6)
    assert net.state.present_id == WIFI and "replaced" in net.kinds()


def test_what_was_known_before_there_was_a_second_channel_counts() -> None:
    vehicle = Machine()
    for other, taken in ((Machine(), True), (Machine(booted_at=700.0), False)):
        known = [(vehicle.heartbeat(), 997.0), (vehicle.position(997.0), 997.0)]
        assert all(frame.msgid in KNOWN_BY for frame, _ in known)
        state = StateSource(None, "", known, 1000.0)
        state.accepts(WIFI, "wifi", other.attitude(1000.0), 1000.0)
        state.accepts(WIFI, "wifi", other.heartbeat(), 1000.0)
        assert state.accepts(WIFI, "wifi", other.attitude(1000.1), 1000.1) is taken


@pytest.mark.parametrize(
    ("rival", "why"),
    [
        (Machine(booted_at=600.0), "boot time"),
        (Machine(east_m=200.0), "position"),
        (Machine(custom_mode=0), "mode"),
        (Machine(base_mode=1), "mode"),
        (Machine(autopilot=PX4), "firmware"),
        (Machine(type=1), "firmware"),
    ],
)
def test_contradicting_frames_change_nothing_and_are_a_duplicate_while_they_come(rival: Machine, why: str) -> None:
    net, vehicle = Net(), Machine()
    both(net, vehicle, rival, 3, PEER)
    assert net.kinds() == []
    both(net, vehicle, rival, 20, PEER)
    assert set(net.counted) == {AIR}
    assert net.kinds() == ["duplicate"] and net.state.duplicate
    assert (net.reports[0].channel_id, net.reports[0].present_id) == (PEER, AIR)
    assert why in net.reports[0].why
    net.second(vehicle, AIR, seconds=7)
    assert net.kinds() == ["duplicate", "duplicate_over"] and not net.state.duplicate


def test_positions_alone_are_a_duplicate() -> None:
    """Forged ones, without a heartbeat, of the right clock."""
    net, vehicle, rival = Net(), Machine(), Machine(east_m=30.0)
    for n in range(200):
        net.now += 0.1
        if n % 10 == 0:
            net.hear(AIR, vehicle.heartbeat())
            net.tick()
        net.hear(AIR, vehicle.position(net.now))
        assert not net.hear(PEER, rival.position(net.now))
    assert net.kinds() == ["duplicate"]
    assert net.reports[0].why == "position differ"


def test_one_forged_heartbeat_is_reported_and_a_delayed_one_is_not() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, seconds=5)
    net.hear(PEER, Machine(base_mode=1).heartbeat())
    net.second(vehicle, AIR, seconds=10)
    assert net.kinds() == ["ignored"]
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI, seconds=5)
    old = vehicle.heartbeat()
    vehicle.shown["custom_mode"] = 17
    net.second(vehicle, AIR)
    net.hear(WIFI, old)
    net.second(vehicle, AIR, WIFI, seconds=10)
    assert net.kinds() == []


def test_a_heartbeat_of_another_component_elsewhere_is_reported_once_a_minute_and_is_no_duplicate() -> None:
    net, vehicle = Net(), Machine()
    for _ in range(130):
        net.second(vehicle, AIR)
        assert not net.hear(PEER, Machine(autopilot=8, type=18).heartbeat())
    assert net.kinds() == ["ignored"] * 3 and not net.state.duplicate


def test_two_peers_of_one_port_without_a_clock_are_taken_for_two_vehicles() -> None:
    net, vehicle = Net(), Machine()
    net.links[PEER] = "air"
    for _ in range(8):
        net.now += 1.0
        net.hear(AIR, vehicle.heartbeat())
        net.hear(PEER, vehicle.heartbeat())
        net.tick()
    assert net.kinds() == ["duplicate"]
    net = Net()
    net.links[PEER] = "air"
    net.second(vehicle, AIR, PEER, seconds=60)
    assert net.kinds() == [], "wifi and a telephone to one port: its clock and its place are one"


def test_answers_to_us_count_from_a_channel_that_agrees_only() -> None:
    net, vehicle, rival = Net(), Machine(), Machine(booted_at=600.0)
    ack = parsed(message("COMMAND_ACK", 1, 1, 9, command=400))
    net.second(vehicle, AIR, WIFI, seconds=3)
    assert net.hear(WIFI, ack)
    assert not net.hear(AIR, ack, of=WIFI), "it was read already"
    both(net, vehicle, rival, 3, PEER)
    assert not net.hear(PEER, ack)
    assert net.hear(AIR, ack, of=PEER), "what came first did not count"


def test_a_deaf_channel_is_left_until_an_answer_comes_over_it() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI, seconds=15)
    net.state.uplink_lost()
    net.second(vehicle, AIR, WIFI)
    assert net.state.present_id == WIFI and net.state.link_status(AIR, net.now)["deaf"]
    assert net.state.to_probe(net.now) == [AIR] and net.state.to_probe(net.now + 1.0) == []
    net.hear(AIR, parsed(message("TIMESYNC", 1, 1, 9, tc1=0, ts1=5)))
    assert net.state.link_status(AIR, net.now)["deaf"], "a question of its own is no answer"
    answer = parsed(message("TIMESYNC", 1, 1, 10, tc1=77, ts1=5))
    net.hear(AIR, answer, of=WIFI)
    assert net.state.link_status(AIR, net.now)["deaf"], "a copy of what came elsewhere is none"
    net.hear(AIR, answer)
    assert not net.state.link_status(AIR, net.now)["deaf"] and net.state.to_probe(net.now + 5.0) == []


def test_a_frame_that_came_first_elsewhere_counts_when_the_present_channel_has_it() -> None:
    net, vehicle = Net(), Machine()
    for _ in range(20):
        net.now += 1.0
        for frame in (vehicle.heartbeat(), vehicle.position(net.now)):
            assert not net.hear(WIFI, frame)
            assert net.hear(AIR, frame, of=WIFI)
        net.tick()
    assert net.kinds() == []


def test_an_echo_is_never_followed() -> None:
    net, vehicle = Net(), Machine()
    for n in range(300):
        net.now += 1.0
        if n % 2:
            for frame in (vehicle.heartbeat(), vehicle.attitude(net.now), vehicle.position(net.now)):
                net.hear(AIR, frame)
                net.hear(PEER, frame, of=AIR)
                net.hear(PEER, frame, of=AIR)
        net.tick()
    assert net.state.present_id == AIR and net.kinds() == []


def test_a_channel_that_hears_clearly_less_for_long_gives_way_to_one_that_agrees() -> None:
    net, vehicle = Net(), Machine()
    for n in range(120):
        if n % 3 == 0:
            net.second(vehicle, AIR, WIFI)
        else:
            net.second(vehicle, WIFI)
        if net.state.present_id == WIFI:
            break
    assert net.now - 1000.0 <= 45 and net.kinds() == ["switched"]
    net, rival = Net(), Machine(booted_at=600.0)
    for n in range(120):
        if n % 3 == 0:
            both(net, vehicle, rival, 1)
        else:
            net.second(rival, WIFI)
    assert net.state.present_id == AIR


def test_equally_lossy_channels_do_not_alternate() -> None:
    net, vehicle = Net(), Machine()
    for n in range(1800):
        net.second(vehicle, *(c for c, lost in ((AIR, n * 7919 % 10 < 2), (WIFI, n * 104729 % 10 < 2)) if not lost))
    assert net.kinds() == []


def test_the_32_bit_wrap_of_a_clock_is_no_other_clock() -> None:
    booted_at = 1000.0 - 2**32 / 1000
    net, vehicle = Net(), Machine(booted_at)
    net.hear(AIR, vehicle.heartbeat())
    net.hear(AIR, vehicle.attitude(999.9))
    net.second(vehicle, WIFI, seconds=4)
    assert net.kinds() == ["switched"]


def test_channels_are_bounded_and_one_that_agrees_is_kept() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI, seconds=3)
    for n in range(200):
        rival = Machine(booted_at=600.0)
        net.links[10 + n] = "udp"
        net.hear(10 + n, rival.attitude(net.now))
        net.hear(10 + n, rival.heartbeat())
    assert len(net.state._heard) <= MAX_CHANNELS and WIFI in net.state._heard
    net.second(vehicle, WIFI, seconds=4)
    assert net.state.present_id == WIFI


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.sampled_from([AIR, WIFI, PEER]),
            st.integers(0, 3),
            st.sampled_from([0.0, 0.1, 1.0, 3.0, 7.0]),
            st.sampled_from([None, AIR, WIFI]),
        ),
        max_size=60,
    )
)
def test_whatever_comes_one_channel_supplies_and_a_contradicting_one_not_while_it_is_heard(
    steps: list[tuple[int, int, float, int | None]],
) -> None:
    net, vehicle, rival = Net(), Machine(), Machine(booted_at=600.0, east_m=300.0, custom_mode=0)
    net.second(vehicle, AIR, seconds=2)
    for channel_id, what, pause_s, of in steps:
        net.now += pause_s
        machine = rival if channel_id == PEER else vehicle
        frame = (machine.heartbeat, lambda m=machine: m.attitude(net.now), lambda m=machine: m.position(net.now))[
            what % 3
        ]()
        present, silent_s = net.state.present_id, net.now - net.state._present.heard_at
        counts = net.hear(channel_id, frame, of=of if of != channel_id else None)
        assert not counts or net.state.present_id == channel_id
        if channel_id == PEER and present in (AIR, WIFI):
            assert not counts or silent_s > 5.0
        if what == 3:
            net.tick()


def test_changes_that_are_too_many_to_report_take_place_and_are_told_with_the_next_report() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI, seconds=15)
    for number in range(20):
        net.state.take_over((WIFI, AIR)[number % 2], net.now)
    net._take()
    changes = [r for r in net.reports if r.kind == "switched"]
    assert len(changes) == 20 and [r.quiet for r in changes] == [False] * 6 + [True] * 14
    net.now += 60.0
    net.state.take_over(WIFI, net.now)
    net._take()
    assert not net.reports[-1].quiet and net.reports[-1].count == 14
