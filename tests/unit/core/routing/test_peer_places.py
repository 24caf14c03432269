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


def places(number: int, *peers: Peer) -> PeerPlaces:
    return PeerPlaces(number, lambda: peers)


def gcs(key: str, host: str = "a", silent_s: float = 0.0) -> Peer:
    return Peer(key, host, False, NOW - silent_s)


def autopilot(key: str, host: str = "v", silent_s: float = 0.0) -> Peer:
    return Peer(key, host, True, NOW - silent_s)


def test_the_peer_without_an_autopilot_that_is_silent_for_longest_gives_way() -> None:
    table = places(3, gcs("x", silent_s=PEER_SILENT_S), gcs("y", silent_s=9.0), autopilot("v", silent_s=50.0))
    assert table.judge("a", autopilot=False, now=NOW) == Judgement(True, "y")
    assert table.judge("b", autopilot=True, now=NOW) == Judgement(True, "y")


def test_whoever_speaks_keeps_its_place_against_one_without_an_autopilot() -> None:
    table = places(3, gcs("x", "a", 1.0), gcs("y", "b", 1.0), autopilot("v", silent_s=50.0))
    assert table.judge("a", autopilot=False, now=NOW) is REFUSED


def test_an_autopilot_takes_the_place_of_one_that_speaks_but_not_of_an_autopilot_that_does() -> None:
    table = places(3, gcs("x", "a", 1.0), gcs("y", "a", 2.0), autopilot("v", silent_s=9.0))
    assert table.judge("b", autopilot=True, now=NOW) == Judgement(True, "y")
    table = places(2, autopilot("v", silent_s=9.0), autopilot("w", silent_s=8.0))
    assert table.judge("b", autopilot=True, now=NOW) is REFUSED
    assert table.judge("b", autopilot=True, now=NOW + AUTOPILOT_SILENT_S - 9.0) == Judgement(True, "v")


def test_the_last_way_to_a_vehicle_in_the_air_is_never_put_out() -> None:
    flying = autopilot("v", silent_s=900.0)._replace(kept=True)
    table = places(2, flying, autopilot("w", silent_s=AUTOPILOT_SILENT_S))
    assert table.judge("b", autopilot=True, now=NOW) == Judgement(True, "w")
    assert places(1, flying).judge("b", autopilot=True, now=NOW) is REFUSED


def test_a_flood_of_autopilots_leaves_an_eighth_to_ground_stations_that_speak() -> None:
    peers: dict[object, Peer] = {n: gcs(f"gcs{n}", "g", 1.0) for n in range(16)}
    table = PeerPlaces(16, peers.values)
    for number in range(100):
        admitted, out = table.judge("hostile", autopilot=True, now=NOW)
        if admitted:
            if out is not None:
                peers = {k: p for k, p in peers.items() if p.key != out}
                table._peers = peers.values
            peers[f"forged{number}"] = autopilot(f"forged{number}", "hostile")
            table.changed()
    assert Counter(p.autopilot for p in peers.values()) == {True: 14, False: 2}


def test_an_address_that_holds_many_places_gives_one_to_another_address() -> None:
    crowd = [gcs(f"h{n}", "hostile", 1.0) for n in range(10)]
    table = places(11, *crowd, gcs("x", "a", 2.0))
    assert table.judge("b", autopilot=False, now=NOW) == Judgement(True, "h0")
    assert table.judge("hostile", autopilot=False, now=NOW) is REFUSED


def test_a_few_places_are_kept_for_addresses_that_have_none() -> None:
    crowd = [autopilot(f"h{n}", "hostile") for n in range(32)]
    table = places(32, *crowd)
    assert table.judge("hostile", autopilot=True, now=NOW) is REFUSED
    assert table.judge("v", autopilot=True, now=NOW) is LET_IN
    table = places(32, *crowd, autopilot("v1", "v"), autopilot("w1", "w"))
    assert table.judge("x", autopilot=True, now=NOW) is REFUSED


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
    peers = [autopilot("v", "a", AUTOPILOT_SILENT_S)]
    table = PeerPlaces(1, lambda: peers)
    assert table.judge("a", autopilot=False, now=NOW) is REFUSED  # a review that shows it silent
    peers[:] = [autopilot("v", "a", -0.01)]
    assert table.judge("a", autopilot=True, now=NOW + 0.02) is REFUSED


STEPS = st.lists(
    st.tuples(
        st.sampled_from(["a", "b", "c", "d"]),
        st.booleans(),
        st.sampled_from([0.0, 0.05, 1.0, 4.0, 15.0]),
        st.integers(0, 40),
    ),
    max_size=60,
)


@settings(deadline=None)
@given(st.integers(1, 40), STEPS)
def test_whoever_comes_the_bounds_hold_and_no_autopilot_that_is_heard_goes(
    number: int, steps: list[tuple[str, bool, float, int]]
) -> None:
    peers: dict[object, Peer] = {}
    table = PeerPlaces(number, lambda: peers.values())
    now = 0.0
    for count, (host, is_autopilot, pause_s, speaker) in enumerate(steps):
        now += pause_s
        if speaker in peers:
            peers[speaker] = peers[speaker]._replace(heard_at=now)
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
        else:
            admitted = True
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
