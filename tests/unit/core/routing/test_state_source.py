"""Which channel supplies a vehicle's state: the table of `core.routing.state_source`, row by row."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mavlink.frame import Frame
from skygcs.core.mavlink.parser import FrameParser
from skygcs.core.routing.state_source import KNOWN_BY, MAX_CHANNELS, SourceReport, StateSource
from support.examples import examples
from support.routed import DIALECT, message
from support.table import each

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

    def say(self, name: str, **values: Any) -> Frame:
        self.seq = (self.seq + 1) & 0xFF
        return parsed(message(name, 1, 1, self.seq, **values))

    def heartbeat(self, **shown: int) -> Frame:
        return self.say("HEARTBEAT", **{**self.shown, **shown}, system_status=4, mavlink_version=3)

    def attitude(self, now: float) -> Frame:
        return self.say("ATTITUDE", time_boot_ms=self._boot_ms(now))

    def position(self, now: float, speed_mps: float = 0.0) -> Frame:
        lon = HOME[1] + self.east_m / (111_320.0 * math.cos(math.radians(HOME[0])))
        place = {"lat": round(HOME[0] * 1e7), "lon": round(lon * 1e7), "alt": round(HOME[2] * 1e3)}
        return self.say("GLOBAL_POSITION_INT", time_boot_ms=self._boot_ms(now), **place, vx=round(speed_mps * 100))

    def all(self, now: float) -> tuple[Frame, Frame, Frame]:
        return self.heartbeat(), self.attitude(now), self.position(now)

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
        counts = self.state.accepts(channel_id, self.links.get(channel_id, "udp"), frame, self.now, of=of)
        if counts:
            self.counted.append(channel_id)
        self._take()
        return counts

    def second(self, machine: Machine, *channels: int, seconds: int = 1, heartbeats: bool = True) -> None:
        """A heartbeat, an attitude and a position a second on these channels."""
        for _ in range(seconds):
            self.now += 1.0
            for channel_id in channels:
                for frame in machine.all(self.now)[not heartbeats :]:
                    self.hear(channel_id, frame)
            self.tick()

    def tick(self) -> None:
        self.state.tick(self.now)
        self.state.choose(lambda channel_id: None, self.now)
        self._take()

    def later(self, seconds: float = 4.25) -> None:
        """What is noted by then of frames of now."""
        self.state.tick(self.now + seconds)
        self._take()

    def take_over(self, channel_id: int) -> None:
        self.state.take_over(channel_id, self.now)
        self._take()

    def kinds(self) -> list[str]:
        return [r.kind for r in self.reports]

    def _take(self) -> None:
        self.reports += self.state.reports
        self.state.reports.clear()


def one_on_air(seconds: int = 5) -> tuple[Net, Machine]:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, seconds=seconds)
    return net, vehicle


def one_on_two(seconds: int = 3) -> tuple[Net, Machine]:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI, seconds=seconds)
    return net, vehicle


def both(net: Net, one: Machine, other: Machine, seconds: int, channel: int = WIFI) -> None:
    """Two machines, each on its channel."""
    for _ in range(seconds):
        net.second(one, AIR)
        net.now -= 1.0
        net.second(other, channel)


def test_another_one_takes_over_when_it_is_silent_and_back() -> None:
    net, vehicle = one_on_two(5)
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


@each("other", [Machine(booted_at=600.0), Machine(east_m=500.0), Machine(autopilot=PX4)])
def test_another_machine_takes_over_only_when_the_vehicle_is_lost_and_as_a_new_start(other: Machine) -> None:
    net, vehicle = one_on_air()
    since = net.now
    while net.state.present_id == AIR:
        net.second(other, WIFI)
    assert 5.0 < net.now - since <= 6.0
    assert net.kinds() == ["replaced"]
    both(net, vehicle, other, 6)
    assert net.state.present_id == WIFI
    assert net.kinds() == ["replaced", "duplicate"], "the first one comes back"


def test_a_satellite_channel_is_given_longer() -> None:
    net, vehicle, other = Net(), Machine(), Machine(booted_at=600.0)
    link = net.state.links()[AIR]
    ordinary_s = link.silent_limit_s
    for frame, times in ((vehicle.heartbeat(), 1), (vehicle.say("HIGH_LATENCY2", type=2, autopilot=ARDUPILOT), 4)):
        net.hear(AIR, frame)
        assert link.silent_limit_s == times * ordinary_s
    net.second(other, WIFI, seconds=15)
    assert net.state.present_id == AIR
    net.second(other, WIFI, seconds=8)
    assert net.state.present_id == WIFI
    net, vehicle = Net(), Machine()
    net.hear(AIR, vehicle.say("HIGH_LATENCY2", type=2, autopilot=ARDUPILOT))
    net.hear(AIR, vehicle.heartbeat())
    assert net.state.links()[AIR].silent_limit_s == ordinary_s, "its heartbeats came again"


def test_without_a_clock_of_its_own_another_channel_waits_until_the_vehicle_is_lost() -> None:
    net, vehicle = one_on_air()
    for silent_s in range(1, 7):
        net.now += 1.0
        assert net.hear(WIFI, vehicle.heartbeat()) is (silent_s == 6)
    assert net.kinds() == ["switched"]


@each(("other", "kinds"), [(Machine(), []), (Machine(booted_at=600.0), ["replaced"])])
def test_one_that_took_over_unseen_is_compared_as_soon_as_it_shows_a_clock(other: Machine, kinds: list[str]) -> None:
    net, _ = one_on_air()
    net.now += 6.0
    for frame in (other.heartbeat(), other.attitude(net.now), other.attitude(net.now)):
        net.hear(WIFI, frame)
    assert net.kinds() == ["switched", *kinds]


def test_a_closed_channel_is_followed_at_once_unless_the_other_one_contradicts() -> None:
    net, vehicle = one_on_air()
    net.state.closed(AIR)
    net.now += 0.3
    assert net.hear(WIFI, vehicle.heartbeat())
    assert net.state.heard_elsewhere_at() == -math.inf and set(net.state.links()) == {WIFI}, "it is forgotten"
    net.state.closed(AIR)
    net, bench = Net(), Machine(booted_at=900.0)
    both(net, vehicle, bench, 6)
    net.state.closed(AIR)
    net.now += 0.3
    assert not net.hear(WIFI, bench.heartbeat())
    net.second(bench, WIFI, seconds=6)
    assert net.state.present_id == WIFI and "replaced" in net.kinds()


def test_what_was_known_before_there_was_a_second_channel_counts() -> None:
    vehicle = Machine()
    for other, last_at, taken in (
        (Machine(), 997.0, True),
        (Machine(booted_at=700.0), 997.0, False),
        (Machine(booted_at=700.0), 994.0, True),  # it is lost
    ):
        known = [(vehicle.heartbeat(), last_at), (vehicle.position(last_at), last_at)]
        assert all(frame.msgid in KNOWN_BY for frame, _ in known)
        state = StateSource(None, "", known, 1000.0)
        state.accepts(WIFI, "wifi", other.attitude(1000.0), 1000.0)
        state.accepts(WIFI, "wifi", other.heartbeat(), 1000.0)
        assert state.accepts(WIFI, "wifi", other.attitude(1000.1), 1000.1) is taken


RIVALS = [
    *[(Machine(booted_at=600.0), "boot time"), (Machine(east_m=200.0), "position"), (Machine(custom_mode=0), "mode")],
    *[(Machine(base_mode=1), "mode"), (Machine(autopilot=PX4), "firmware"), (Machine(type=1), "firmware")],
]


@each(("rival", "why"), RIVALS)
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
    net, vehicle = one_on_air()
    net.hear(PEER, Machine(base_mode=1).heartbeat())
    net.second(vehicle, AIR, seconds=10)
    assert net.kinds() == ["ignored"]
    net, vehicle = one_on_two(5)
    old = vehicle.heartbeat()
    vehicle.shown["custom_mode"] = 17
    net.second(vehicle, AIR)
    net.hear(WIFI, old)
    net.second(vehicle, AIR, WIFI, seconds=10)
    assert net.kinds() == []


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
    net, vehicle = one_on_two()
    ack = parsed(message("COMMAND_ACK", 1, 1, 9, command=400))
    assert net.hear(WIFI, ack)
    assert not net.hear(AIR, ack, of=WIFI), "it was read already"
    both(net, vehicle, Machine(booted_at=600.0), 3, PEER)
    assert not net.hear(PEER, ack)
    assert net.hear(AIR, ack, of=PEER), "what came first did not count"


def test_a_deaf_channel_is_left_until_an_answer_comes_over_it() -> None:
    net, vehicle = one_on_two(15)
    net.state.uplink_lost()
    net.second(vehicle, AIR, WIFI)
    assert net.state.present_id == WIFI and net.state.link_status(AIR, net.now)["deaf"]
    assert net.state.to_probe(net.now) == [AIR] and net.state.to_probe(net.now + 1.0) == []
    answer = parsed(message("TIMESYNC", 1, 1, 10, tc1=77, ts1=5))
    for frame, of, deaf in (
        (parsed(message("TIMESYNC", 1, 1, 9, tc1=0, ts1=5)), None, True),  # a question of its own
        (answer, WIFI, True),  # a copy of what came elsewhere
        (answer, None, False),
    ):
        net.hear(AIR, frame, of=of)
        assert net.state.link_status(AIR, net.now)["deaf"] is deaf
    assert net.state.to_probe(net.now + 5.0) == []


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
        for frame in vehicle.all(net.now) if n % 2 else ():
            for channel_id, of in ((AIR, None), (PEER, AIR), (PEER, AIR)):
                net.hear(channel_id, frame, of=of)
        net.tick()
    assert net.state.present_id == AIR and net.kinds() == []


def test_a_channel_that_hears_clearly_less_for_long_gives_way_to_one_that_agrees() -> None:
    net, vehicle, seconds = Net(), Machine(), 0
    while net.state.present_id == AIR and seconds < 120:
        net.second(vehicle, *((WIFI,) if seconds % 3 else (AIR, WIFI)))
        seconds += 1
    assert seconds <= 45 and net.kinds() == ["switched"]
    net, rival = Net(), Machine(booted_at=600.0)
    for _ in range(40):
        both(net, vehicle, rival, 1)
        net.second(rival, WIFI, seconds=2)
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
    net, vehicle = one_on_two()
    for n in range(200):
        rival = Machine(booted_at=600.0)
        net.hear(10 + n, rival.attitude(net.now))
        net.hear(10 + n, rival.heartbeat())
    assert len(net.state._heard) <= MAX_CHANNELS and WIFI in net.state._heard
    net.second(vehicle, WIFI, seconds=4)
    assert net.state.present_id == WIFI


STEPS = st.tuples(
    st.sampled_from([AIR, WIFI, PEER]),
    st.integers(0, 3),
    st.sampled_from([0.0, 0.1, 1.0, 3.0, 7.0]),
    st.sampled_from([None, AIR, WIFI]),
)


@settings(max_examples=examples(200), deadline=None)
@given(st.lists(STEPS, max_size=60))
def test_whatever_comes_one_channel_supplies_and_a_contradicting_one_not_while_it_is_heard(steps) -> None:
    net, vehicle = one_on_air(2)
    rival = Machine(booted_at=600.0, east_m=300.0, custom_mode=0)
    for channel_id, what, pause_s, of in steps:
        net.now += pause_s
        frame = (rival if channel_id == PEER else vehicle).all(net.now)[what % 3]
        present, silent_s = net.state.present_id, net.now - net.state._present.heard_at
        counts = net.hear(channel_id, frame, of=of if of != channel_id else None)
        assert not counts or net.state.present_id == channel_id
        if channel_id == PEER and present in (AIR, WIFI):
            assert not counts or silent_s > 5.0
        if what == 3:
            net.tick()


def test_changes_that_are_too_many_to_report_take_place_and_are_told_with_the_next_report() -> None:
    net, _ = one_on_two(15)
    for number in range(20):
        net.take_over((WIFI, AIR)[number % 2])
    changes = [r for r in net.reports if r.kind == "switched"]
    assert [r.quiet for r in changes] == [False] * 6 + [True] * 14
    net.now += 60.0
    net.take_over(WIFI)
    assert not net.reports[-1].quiet and net.reports[-1].count == 14


# The limits, each from both sides


def heard_twice(other: Machine, vehicle: Machine | None = None, **position: float) -> Net:
    """The vehicle on one channel and another machine on the second, both at one moment."""
    net = Net()
    vehicle = vehicle or Machine()
    for channel_id, machine in ((AIR, vehicle), (WIFI, other)):
        net.hear(channel_id, machine.heartbeat())
        net.hear(channel_id, machine.position(net.now, **position))
    return net


def test_clocks_within_3_s_and_places_within_reach_are_those_of_one_vehicle() -> None:
    wrap_s = 2**32 / 1000
    for booted_at, one in ((3.0, True), (-3.0, True), (3.25, False), (-3.25, False), (3.0 - wrap_s, True)):
        assert heard_twice(Machine(booted_at)).state.may_be(WIFI) is one, booted_at
    # 10 m, and 0.3 s of motion at this speed and at 5 m/s²
    near = ((10.2, 0.0, True), (10.3, 0.0, False), (-10.3, 0.0, False), (13.2, 10.0, True), (13.3, 10.0, False))
    for east_m, speed_mps, one in near:
        net = heard_twice(Machine(east_m=east_m), speed_mps=speed_mps)
        assert net.state.may_be(WIFI) is one, (east_m, speed_mps)
        assert net.state.is_original(WIFI) is one
    assert not heard_twice(Machine(type=13)).state.may_be(WIFI)
    assert Net().state.may_be(WIFI), "nothing is known of it"


def test_a_place_is_compared_over_the_time_between_both() -> None:
    """2 s later the vehicle may be 10 m + 2.3 s · 10 m/s + 2.5 · 2.3² m away; with other clocks 1.5 s count more."""
    for east_m, one in ((46.2, True), (46.3, False)):
        net, vehicle = Net(), Machine()
        net.hear(AIR, vehicle.position(net.now, speed_mps=10.0))
        net.now += 2.0
        vehicle.east_m = east_m
        net.hear(WIFI, vehicle.position(net.now))
        assert net.state.may_be(WIFI) is one, east_m
    for east_m, why in ((15.6, "boot time differ"), (15.7, "boot time and position differ")):
        net, vehicle, rival = Net(), Machine(), Machine(booted_at=600.0, east_m=east_m)
        for _ in range(6):
            net.now += 1.0
            net.hear(AIR, vehicle.position(net.now))
            net.hear(WIFI, rival.position(net.now))
        assert [(r.kind, r.why) for r in net.reports] == [("duplicate", why)]


def test_speed_and_height_count_in_all_directions() -> None:
    def agrees(first: dict[str, int], second: dict[str, int]) -> bool:
        net = Net()
        for channel_id, values in ((AIR, first), (WIFI, second)):
            fields = {"time_boot_ms": 1_000_000, "lat": 437800000, "lon": -794600000, "alt": 190000, **values}
            net.hear(channel_id, parsed(message("GLOBAL_POSITION_INT", 1, 1, 9, **fields)))
        return net.state.may_be(WIFI)

    for alt, one in ((200_200, True), (200_300, False), (179_800, True), (179_700, False)):
        assert agrees({}, {"alt": alt}) is one, alt
    for moving in ({"vx": 1000}, {"vy": -1000}, {"vz": 1000}, {"vx": 800, "vz": -600}):
        assert [agrees(moving, {"alt": alt}) for alt in (203_200, 203_300)] == [True, False], moving
    for nowhere in ({"lat": 0, "lon": 0}, {"lat": 900_000_001}):
        assert agrees({}, nowhere), "it is not a place"
    for somewhere in ({"lat": 0}, {"lon": 0}, {"lat": 900_000_000}, {"lat": -900_000_000}):
        assert not agrees({}, somewhere), somewhere


def test_another_channel_takes_over_when_the_present_one_was_silent_for_longer_than_the_timeout() -> None:
    for lost_s, silent_s, taken in ((5.0, 5.0, False), (5.0, 5.25, True), (8.0, 8.0, False), (8.0, 8.25, True)):
        net, rival = Net(lost_s=lost_s), Machine(booted_at=600.0)
        net.hear(AIR, Machine().attitude(net.now))
        net.hear(WIFI, rival.attitude(net.now))
        net.now += silent_s
        assert net.hear(WIFI, rival.heartbeat()) is taken, (lost_s, silent_s)
        assert net.kinds() == (["replaced"] if taken else [])
        if taken:
            assert net.reports[0].why == f"silent for {silent_s:.1f} s"
            assert (net.reports[0].channel_id, net.reports[0].present_id) == (WIFI, AIR)
    # It has to hear the autopilot itself
    net = Net()
    net.hear(WIFI, Machine().heartbeat())
    net.now += 5.25
    assert not net.hear(WIFI, Machine().attitude(net.now))


def test_a_duplicate_is_three_contradictions_over_4_s_and_over_5_s_after_the_last() -> None:
    rival = Machine(booted_at=600.0)

    def contradict(net: Net, *pauses_s: float) -> list[str]:
        for pause_s in pauses_s:
            net.now += pause_s
            net.hear(AIR, Machine().attitude(net.now))
            net.hear(WIFI, rival.attitude(net.now))
        return net.kinds()

    assert contradict(Net(), 1.0, 2.0, 2.0) == ["duplicate"]
    assert contradict(Net(), 1.0, 2.0, 1.75) == []
    assert contradict(Net(), 1.0, 4.0) == [], "two are too few"
    assert contradict(Net(), 1.0, 4.25, 2.0) == [], "after a pause it begins anew"
    net = Net()
    contradict(net, 1.0, 2.0, 2.0)
    assert (net.reports[0].channel_id, net.reports[0].present_id, net.reports[0].count) == (WIFI, AIR, 2)
    assert net.reports[0].why == "boot time differ"
    for pause_s, kinds in ((4.0, ["duplicate"]), (0.75, ["duplicate"]), (0.5, ["duplicate", "duplicate_over"])):
        net.now += pause_s
        net.hear(AIR, Machine().attitude(net.now))
        net.state.tick(net.now)
        net._take()
        assert net.kinds() == kinds
    assert net.reports[-1].present_id == AIR


def test_contradictions_while_the_present_channel_is_silent_are_none() -> None:
    for silent_s, noted in ((2.5, ["ignored"]), (2.75, [])):
        net, rival = Net(), Machine(booted_at=600.0)
        net.hear(AIR, Machine().attitude(net.now))
        net.now += silent_s
        net.hear(WIFI, rival.attitude(net.now))
        net.later()
        assert net.kinds() == noted, silent_s


def test_an_old_position_is_not_compared_with_another_channels() -> None:
    for old_s, noted in ((3.0, ["position"]), (3.25, [])):
        net, vehicle, rival = Net(), Machine(), Machine(east_m=900.0)
        net.hear(AIR, vehicle.position(net.now))
        net.now += old_s
        net.hear(AIR, vehicle.heartbeat())
        net.hear(WIFI, rival.position(net.now))
        net.later()
        assert [r.why for r in net.reports] == noted, old_s


def test_what_was_ignored_is_reported_once_a_minute_with_its_number() -> None:
    net, bench = Net(), Machine(autopilot=8, type=18)
    for at in (0.0, 1.0, 59.75, 60.0):
        net.now = 1000.0 + at
        net.hear(AIR, Machine().heartbeat())
        net.hear(WIFI, bench.heartbeat())
    reports = [(r.kind, r.why, r.channel_id, r.present_id, r.count) for r in net.reports]
    assert reports == [("ignored", "firmware", WIFI, AIR, count) for count in (0, 3)]
    assert not net.state.duplicate, "another component"


def test_three_heartbeats_that_were_only_copies_show_a_ground_stations_channel() -> None:
    for copies, original in ((2, False), (3, True)):
        net, vehicle = Net(), Machine()
        for _ in range(copies):
            net.hear(WIFI, vehicle.heartbeat())
            net.hear(AIR, vehicle.heartbeat(), of=WIFI)
        assert [net.state.is_original(c) for c in (WIFI, AIR, PEER)] == [original, False, False]
        for of, why in ((None, "one of its own"), (WIFI, "and a copy"), (WIFI, "and two copies")):
            net.hear(AIR, vehicle.heartbeat(), of=of)
            assert not net.state.is_original(WIFI), why
    net.take_over(WIFI)
    assert net.reports[-1].why == "a ground station's link, which returns its frames"


def test_a_channel_that_agrees_but_had_no_heartbeat_of_the_autopilot_is_nothing_of_its_own() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR)
    net.second(vehicle, AIR, WIFI, heartbeats=False)
    assert not net.state.is_original(WIFI)
    net.now += 6.0
    assert not net.hear(WIFI, vehicle.attitude(net.now))


def test_setpoints_also_go_over_another_channel_while_the_present_one_is_in_doubt() -> None:
    net, vehicle = one_on_air(3)
    net.now += 2.5
    assert net.state.stand_in(net.now) is None, "there is no other one"
    net.second(vehicle, AIR, WIFI, seconds=3)
    assert net.state.stand_in(net.now) is None, "there is no doubt"
    net.now += 2.5
    assert net.state.stand_in(net.now) == WIFI
    net.state.closed(AIR)
    assert net.state.stand_in(net.now) is None, "there is none to be in doubt"


def test_the_first_channel_needs_no_trial_and_loss_is_shown_to_four_places() -> None:
    net, vehicle = Net(), Machine()
    net.second(vehicle, AIR, WIFI)
    assert [net.state.link_status(c, net.now)["health"] for c in (AIR, WIFI)] == ["good", "trial"]
    assert net.state.link_status(AIR, net.now)["recent_loss"] is None
    for number in range(60):
        net.now += 1.0
        counters = {AIR: (20 * number, 10 * number), WIFI: (30 * number, 0)}
        net.state.choose(counters.get, net.now)
    assert [net.state.link_status(c, net.now)["recent_loss"] for c in (AIR, WIFI)] == [0.3333, 0.0]


def test_what_channels_had_is_counted_and_shown() -> None:
    net, vehicle = one_on_two()
    net.now += 0.5
    net.hear(WIFI, vehicle.heartbeat(), of=AIR)
    assert net.state.counts(AIR) == {0: 3, 30: 3, 33: 3} and net.state.counts(WIFI)[0] == 4
    assert net.state.counts(PEER) == {} and net.state.link_status(PEER, net.now) == {}
    assert net.state.heard_elsewhere_at() == net.now and Net().state.heard_elsewhere_at() == -math.inf
    assert set(net.state.links()) == {AIR, WIFI}
    shown = net.state.link_status(AIR, net.now)
    assert (shown["chosen"], shown["since_s"], shown["deaf"], shown["changes"]) == (True, 3.5, False, 0)
    assert net.state.link_status(WIFI, net.now)["chosen"] is False
    net.take_over(WIFI)
    shown = net.state.link_status(WIFI, net.now + 2.0)
    assert (shown["chosen"], shown["since_s"], shown["changes"]) == (True, 2.0, 1)


def test_a_channel_is_behind_by_its_least_delay_of_the_last_seconds() -> None:
    net, vehicle = one_on_air(1)

    def behind_s(channel_id: int, delay_s: float) -> float | None:
        """After a frame that comes this much later than that of the present channel."""
        net.hear(AIR, vehicle.attitude(net.now))
        net.hear(channel_id, Machine(booted_at=delay_s).attitude(net.now))
        net.tick()
        return net.state.link_status(channel_id, net.now)["behind_s"]  # type: ignore[return-value]

    # forgotten after twice the window
    for pause_s, delay_s, behind in ((0.0, 0.75, 0.75), (4.0, 1.25, 0.75), (1.0, 1.25, 0.75), (5.0, 0.25, 0.25)):
        net.now += pause_s
        assert behind_s(WIFI, delay_s) == behind, pause_s
        assert net.state.link_status(AIR, net.now)["behind_s"] == 0.0
    assert behind_s(PEER, 61.0) is None, "another clock"


def test_the_channel_that_agrees_least_and_was_silent_for_longest_makes_room() -> None:
    net, vehicle = one_on_air(1)
    for number in range(MAX_CHANNELS - 1):
        net.now += 0.01
        net.hear(10 + number, Machine(booted_at=600.0 if number in (3, 5) else 0.0).attitude(net.now))
    for channel_id, gone in ((50, 13), (51, 15), (52, 10)):
        net.hear(channel_id, vehicle.attitude(net.now))
        assert {channel_id, AIR} <= set(net.state.links()) and gone not in net.state.links()
        assert len(net.state.links()) == MAX_CHANNELS


def test_a_mode_that_the_vehicle_showed_lately_explains_a_late_heartbeat() -> None:
    """Of the last eight states; an older one is a contradiction."""
    for states, kinds in ((7, []), (8, ["ignored"])):
        net, vehicle = one_on_two()
        old = vehicle.heartbeat()
        for mode in range(states):
            net.now += 0.01
            net.hear(AIR, vehicle.heartbeat(custom_mode=100 + mode))
        net.hear(WIFI, old)
        net.later()
        assert net.kinds() == kinds, states


@each("begun", ["known before", "taken over"])
def test_a_mode_that_was_shown_before_the_present_channel_explains_a_late_heartbeat(begun: str) -> None:
    old = Machine().heartbeat()
    if begun == "known before":
        net, present, other = Net(known=[(old, 999.0)]), AIR, WIFI
    else:
        (net, _), present, other = one_on_two(), WIFI, AIR
        net.take_over(WIFI)
    net.hear(present, Machine().heartbeat(custom_mode=100))
    net.hear(other, old)
    net.later()
    assert "ignored" not in net.kinds()
