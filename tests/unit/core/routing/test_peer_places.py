"""Which peer of a server gives way when all places are taken."""

from __future__ import annotations

from collections import Counter

from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.routing.peer_places import (
    AUTOPILOT_SILENT_S,
    BURST_BYTES,
    BYTES_PER_S,
    LET_IN,
    PARK_S,
    PEER_SILENT_S,
    REFUSED,
    GarbageGauge,
    Judgement,
    Peer,
    PeerPlaces,
)

NOW = 1000.0


def judged(number: int, *peers: Peer, host: str = "b", autopilot: bool, later_s: float = 0.0) -> Judgement:
    return PeerPlaces(number, lambda: peers).judge(host, autopilot=autopilot, now=NOW + later_s)


def gcs(key: str, host: str = "a", silent_s: float = 0.0) -> Peer:
    return Peer(key, host, False, NOW - silent_s)


def vehicle(key: str, host: str = "v", silent_s: float = 0.0) -> Peer:
    return Peer(key, host, True, NOW - silent_s)


def test_the_peer_without_an_autopilot_that_is_silent_for_longest_gives_way() -> None:
    peers = gcs("x", silent_s=PEER_SILENT_S), gcs("y", silent_s=9.0), vehicle("v", silent_s=50.0)
    assert judged(3, *peers, host="a", autopilot=False) == judged(3, *peers, autopilot=True) == Judgement(True, "y")
    speaks = gcs("x", "a", 1.0), gcs("y", "b", 1.0), vehicle("v", silent_s=50.0)
    assert judged(3, *speaks, host="a", autopilot=False) is REFUSED, "whoever speaks keeps its place"


def test_an_autopilot_takes_the_place_of_one_that_speaks_but_not_of_an_autopilot_that_does() -> None:
    speaks = gcs("x", "a", 1.0), gcs("y", "a", 2.0), vehicle("v", silent_s=9.0)
    assert judged(3, *speaks, autopilot=True) == Judgement(True, "y")
    both = vehicle("v", silent_s=9.0), vehicle("w", silent_s=8.0)
    assert judged(2, *both, autopilot=True) is REFUSED
    assert judged(2, *both, autopilot=True, later_s=AUTOPILOT_SILENT_S - 9.0) == Judgement(True, "v")


def test_the_last_way_to_a_vehicle_in_the_air_is_never_put_out() -> None:
    flying = vehicle("v", silent_s=900.0)._replace(kept=True)
    silent = vehicle("w", silent_s=AUTOPILOT_SILENT_S)
    assert judged(2, flying, silent, autopilot=True) == Judgement(True, "w")
    assert judged(1, flying, autopilot=True) is REFUSED


def test_an_address_that_holds_many_places_gives_one_to_another_address_and_few_are_kept_for_those_without() -> None:
    crowd = [gcs(f"h{n}", "hostile", 1.0) for n in range(10)]
    assert judged(11, *crowd, gcs("x", "a", 2.0), autopilot=False) == Judgement(True, "h0")
    assert judged(11, *crowd, gcs("x", "a", 2.0), host="hostile", autopilot=False) is REFUSED
    crowd = [vehicle(f"h{n}", "hostile") for n in range(32)]
    assert judged(32, *crowd, host="hostile", autopilot=True) is REFUSED
    assert judged(32, *crowd, host="v", autopilot=True) is LET_IN
    assert judged(32, *crowd, vehicle("v1", "v"), vehicle("w1", "w"), host="x", autopilot=True) is REFUSED


def test_a_flood_of_autopilots_leaves_an_eighth_to_ground_stations_that_speak() -> None:
    peers: dict[object, Peer] = {n: gcs(n, "g", 1.0) for n in range(16)}  # type: ignore[arg-type]
    table = PeerPlaces(16, lambda: peers.values())
    for number in range(100, 200):
        admitted, out = table.judge("hostile", autopilot=True, now=NOW)
        if admitted:
            peers.pop(out, None)
            peers[number] = vehicle(number, "hostile")  # type: ignore[arg-type]
            table.changed()
    assert Counter(p.autopilot for p in peers.values()) == {True: 14, False: 2}


def test_a_flood_of_strangers_costs_one_look_at_the_peers_in_a_tenth_of_a_second() -> None:
    looks = 0

    def peers() -> list[Peer]:
        nonlocal looks
        looks += 1
        return [gcs("x", "a", 1.0)]

    table = PeerPlaces(1, peers)
    for number in range(1000):
        assert table.judge("a", autopilot=False, now=NOW + number * 1e-4) is REFUSED
    assert looks == 1
    table.judge("a", autopilot=False, now=NOW + 0.1)
    assert looks == 2


def test_an_autopilot_heard_since_the_last_review_keeps_its_place() -> None:
    peers = [vehicle("v", "a", AUTOPILOT_SILENT_S)]
    table = PeerPlaces(1, lambda: peers)
    assert table.judge("a", autopilot=False, now=NOW) is REFUSED  # a review that shows it silent
    peers[:] = [vehicle("v", "a", -0.01)]
    assert table.judge("a", autopilot=True, now=NOW + 0.02) is REFUSED


PAUSES_S = st.sampled_from([0.0, 0.05, 1.0, 4.0, 15.0])
STEPS = st.lists(st.tuples(st.sampled_from("abcd"), st.booleans(), PAUSES_S, st.integers(0, 40)), max_size=60)


@settings(deadline=None)
@given(st.integers(1, 40), STEPS)
def test_whoever_comes_the_bounds_hold_and_no_autopilot_that_is_heard_goes(number, steps) -> None:
    peers: dict[object, Peer] = {}
    table = PeerPlaces(number, lambda: peers.values())
    now = 0.0
    for count, (host, is_autopilot, pause_s, speaker) in enumerate(steps):
        now += pause_s
        if speaker in peers:
            peers[speaker] = peers[speaker]._replace(heard_at=now)
        admitted = True
        if len(peers) >= number:
            admitted, out = table.judge(host, autopilot=is_autopilot, now=now)
            if out is not None:
                gone = peers.pop(out)
                assert admitted
                assert not gone.autopilot or (is_autopilot and now - gone.heard_at >= AUTOPILOT_SILENT_S)
                if not gone.autopilot and not is_autopilot and now - gone.heard_at < PEER_SILENT_S:
                    by_host = Counter(p.host for p in peers.values())
                    assert by_host[gone.host] + 1 >= by_host[host] + 2
            elif admitted:
                assert all(p.host != host for p in peers.values())
        if admitted:
            peers[count] = Peer(count, host, is_autopilot, now)
            table.changed()
        assert len(peers) <= number + table.kept


def test_a_radio_full_of_noise_is_never_parked() -> None:
    gauge = GarbageGauge(0.0)
    assert not any(gauge.skipped(115, 0.01 * step) for step in range(100_000))  # 115200 baud
    assert gauge.parkings == 0


def test_a_flood_is_searched_for_no_more_than_its_part_and_comes_back_after_a_pause() -> None:
    gauge = GarbageGauge(5.0)
    searched = 0
    for step in range(60_000):
        now = 5.0 + 0.001 * step
        if not gauge.is_parked(now):
            searched += 1000
            gauge.skipped(1000, now)
    assert gauge.parkings > 25
    assert searched < 60 * BYTES_PER_S
    assert gauge.is_parked(now) or not gauge.skipped(0, now)
    assert not gauge.is_parked(now + PARK_S)
    assert not gauge.skipped(int(BURST_BYTES / 5), now + PARK_S)
