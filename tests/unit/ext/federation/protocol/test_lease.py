"""The lease of a vehicle: one commander at a time, whatever hub, network, clocks and processes do."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from skygcs.ext.federation.protocol.lease import (
    NEW_HUB_S,
    TTL_S,
    VALID_S,
    Entry,
    Lease,
    LeaseConfig,
    State,
    decode_entry,
    encode_entry,
)
from support.examples import examples
from support.lease_world import World
from support.table import each

SITES = ("north", "south", "east")
HELD_WITHIN_S = NEW_HUB_S + 0.5
"""A hub that a bridge has not seen before is new to it."""


def world(count: int = 2, *, goes_on_alone: bool = True, **network: Any) -> World:
    """Sites with a good network, where the home has the lease."""
    made = World(SITES[:count], 1, goes_on_alone=goes_on_alone, **{"loss": 0.0, "delay_s": 0.0, **network})
    made.advance_until(lambda: made.holders == ["north"], HELD_WITHIN_S)
    made.advance(1.0)
    return made


def test_the_home_takes_its_vehicle_and_keeps_it() -> None:
    w = world(3)
    for _ in range(50):
        w.advance(0.2)
        assert w.holders == ["north"]
    assert [s.lease.holder for s in w.sites.values()] == ["north"] * 3


def test_another_site_gets_it_on_request_and_the_home_back_when_that_releases_it() -> None:
    w = world()
    assert w.sites["south"].lease.take(w.sites["south"].now()) is None
    w.advance_until(lambda: w.holders == ["south"], 2.0)
    w.advance(5.0)
    assert w.holders == ["south"]
    south = w.sites["south"]
    south.carry_out(south.lease.release(south.now()))
    w.advance_until(lambda: w.holders == ["north"], 3.0)
    assert w.both == []


def test_a_holder_that_is_busy_refuses_and_force_takes_it_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    w = world()
    north, south = w.sites["north"], w.sites["south"]
    real = north.lease.requested
    monkeypatch.setattr(north.lease, "requested", lambda by, now, **k: real(by, now, **{**k, "busy": "it is flown"}))
    south.lease.take(south.now())
    w.advance(3.0)
    assert (w.holders, south.lease.state) == (["north"], State.OBSERVED)
    assert south.reports[-1] == "alpha was not taken: it is flown; `--force` takes it all the same"
    south.lease.take(south.now(), force=True)
    w.advance_until(lambda: w.holders == ["south"], 3.0)
    assert w.both == []


def test_the_home_goes_on_alone_and_nobody_takes_it_but_by_force() -> None:
    w = world()
    w.sites["north"].cut = True
    w.advance(20.0)
    assert w.holders == ["north"]
    assert w.sites["north"].lease.state is State.ALONE
    w.sites["south"].lease.take(w.sites["south"].now())
    w.advance(10.0)
    assert w.holders == ["north"]
    w.sites["north"].cut = False
    w.advance_until(lambda: w.sites["north"].lease.state is State.HELD, 2.0)
    assert w.holders == ["north"]


def test_a_home_that_stops_is_followed_by_another_site_and_takes_it_back_when_that_is_gone() -> None:
    w = world(goes_on_alone=False)
    w.sites["north"].cut = True
    took_s = w.advance_until(lambda: w.holders == ["south"], TTL_S + 1.0)
    assert took_s > TTL_S - 1.1
    w.sites["north"].cut = False
    w.advance(10.0)
    assert w.holders == ["south"], "one that has it keeps it"
    w.sites["south"].bridge_stopped = True
    assert w.advance_until(lambda: w.holders == ["north"], TTL_S + 1.0)
    assert w.both == []


@each("part", ["bridge", "daemon", "both"])
def test_what_was_stopped_past_the_ttl_sends_nothing_when_it_goes_on(part: str) -> None:
    w = world(goes_on_alone=False)
    north = w.sites["north"]
    north.bridge_stopped = part in ("bridge", "both")
    north.daemon_stopped = part in ("daemon", "both")
    w.advance(6.0)
    if part == "daemon":  # its bridge renews: nobody else has it, and grants of the past give nothing
        assert w.holders == []
        north.daemon_stopped = False
        w.advance(1.5)
        assert w.holders == ["north"]
        return
    assert w.holders == ["south"]
    north.bridge_stopped = north.daemon_stopped = False
    for _ in range(100):
        w.advance(0.05)
        assert w.holders == ["south"]


@each("kind", ["restarted", "replaced"])
def test_the_home_does_not_notice_a_hub_that_is_gone_for_a_while(kind: str) -> None:
    w = world()
    w.hub.alive = False
    for _ in range(100):
        w.advance(0.1)
        assert w.holders == ["north"]
    if kind == "replaced":
        w.replace_hub()
    w.hub.alive = True
    w.advance_until(lambda: w.sites["north"].lease.state is State.HELD, 2.0)
    assert w.holders == ["north"]


def test_a_new_hub_gives_nothing_to_a_site_that_holds_nothing_before_every_older_lease_is_over() -> None:
    w = world(goes_on_alone=False)
    north = w.sites["north"]
    north.cut = True
    w.replace_hub()
    south = w.sites["south"]
    w.advance(0.3)
    south.lease.take(south.now())
    took_s = w.advance_until(lambda: w.holders == ["south"], NEW_HUB_S + 1.0)
    assert took_s > VALID_S
    assert w.both == []


def test_a_home_that_was_stopped_does_not_go_on_alone_where_a_person_had_another_site_take_it() -> None:
    w = world()
    north, south = w.sites["north"], w.sites["south"]
    north.bridge_stopped = north.daemon_stopped = True
    w.advance(1.0)
    assert south.lease.take(south.now(), force=True) is None
    w.advance_until(lambda: w.holders == ["south"], TTL_S + 1.0)
    north.cut = True  # it cannot even ask the hub
    north.bridge_stopped = north.daemon_stopped = False
    for _ in range(100):
        w.advance(0.1)
        assert w.holders == ["south"]


def test_without_the_hub_a_home_begins_only_by_a_persons_decision_and_late_enough() -> None:
    w = world()
    w.sites["north"].restart_daemon()
    w.hub.alive = False
    w.advance(1.0)
    north, south = w.sites["north"], w.sites["south"]
    assert w.holders == []
    refusals = [
        north.lease.take(north.now()),
        north.lease.take(north.now(), without_hub=True),
        south.lease.take(south.now(), without_hub=True, force=True),
    ]
    assert all(refusals), refusals
    w.advance(10.0)
    assert w.holders == []
    assert north.lease.take(north.now(), without_hub=True, force=True) is None
    w.advance(1.0)
    assert w.holders == ["north"]


def test_a_bridge_that_is_restarted_goes_on_with_what_its_daemon_has() -> None:
    w = world()
    w.sites["north"].restart_bridge()
    for _ in range(40):
        w.advance(0.1)
        assert w.holders == ["north"]


def test_a_released_home_stays_so_until_somebody_takes_it() -> None:
    w = world()
    north = w.sites["north"]
    north.carry_out(north.lease.release(north.now()))
    w.advance(15.0)
    assert w.holders == []
    south = w.sites["south"]
    assert south.lease.take(south.now()) is None, "no force: the home has said so itself"
    w.advance_until(lambda: w.holders == ["south"], 2.0)
    south.bridge_stopped = True
    w.advance_until(lambda: w.holders == ["north"], TTL_S + 1.0)


def test_a_home_whose_bridge_has_just_started_without_the_hub_is_not_taken_before_other_leases_are_over() -> None:
    for first_tick in (True, False):
        lease = Lease(LeaseConfig("alpha", "north", "north", "run"))
        if first_tick:
            assert lease.tick(100.0) == []
        refusal = lease.take(100.0, force=True, without_hub=True)
        assert refusal == "another site may hold it for 4.0 s more: try again then"
        lease.tick(101.0)
        refusal = lease.take(101.0, force=True, without_hub=True)
        assert refusal == "another site may hold it for 3.0 s more: try again then"
        assert lease.take(104.0, force=True, without_hub=True) is None
        assert lease.state is State.ALONE


def go_back(w: World, kind: str, lost: int = 3) -> None:
    match kind:
        case "recreated":
            w.recreate_bucket()
        case "restored":
            w.restore_bucket()
        case "power cut":
            w.cut_power(lost)


@each("holder", ["north", "south"])
@each("kind", ["recreated", "restored", "power cut"])
def test_a_hub_whose_revisions_go_back_takes_nothing_from_who_holds_it(kind: str, holder: str) -> None:
    w = world(3, goes_on_alone=False)
    w.sites[holder].lease.take(w.sites[holder].now())
    w.advance(20.0)
    go_back(w, kind)
    for _ in range(200):
        w.advance(0.05)
        assert w.holders == [holder], w.describe()


@each("kind", ["recreated", "restored", "power cut"])
def test_a_hub_whose_revisions_go_back_gives_nothing_away_while_an_older_lease_is_valid(kind: str) -> None:
    w = world(goes_on_alone=False)
    north, south = w.sites["north"], w.sites["south"]
    w.advance(5.0)
    w.advance_until(lambda: north.lease.valid_until - north.now() > VALID_S - 0.1, 1.5)
    north.cut = True  # it cannot write its lease there
    go_back(w, kind)
    south.lease.take(south.now())
    w.advance_until(lambda: w.holders == ["south"], NEW_HUB_S + 1.5)
    assert w.both == []


def test_a_site_that_was_away_does_not_take_what_a_hub_forgot_in_a_power_cut() -> None:
    w = world(goes_on_alone=False)
    north, south = w.sites["north"], w.sites["south"]
    south.cut = True  # it does not learn the last revisions
    w.advance(5.0)
    w.advance_until(lambda: north.lease.valid_until - north.now() > VALID_S - 0.1, 1.5)
    north.cut, south.cut = True, False
    w.cut_power(2)
    w.advance(0.2)
    assert south.lease.take(south.now()) is None
    w.advance_until(lambda: w.holders == ["south"], NEW_HUB_S + 1.5)
    assert w.both == []


PAUSES = st.sampled_from([0.1, 0.5, 1.0, 2.0, 2.6, 3.1, 5.0])
"""Between two events: shorter and longer than a renewal, a validity and a TTL."""


class LeaseMachine(RuleBasedStateMachine):
    """Two or three sites, a bad network and clocks that differ by 2 %: at no moment may two daemons send."""

    @initialize(
        seed=st.integers(0, 2**32),
        count=st.integers(2, 3),
        alone=st.booleans(),
        delay=st.sampled_from([0.05, 0.3, 0.6]),
        taker=st.integers(0, 1),
    )
    def begin(self, seed: int, count: int, alone: bool, delay: float, taker: int) -> None:
        """The home has it, or another site that asked for it."""
        self.world = World(SITES[:count], seed, goes_on_alone=alone, loss=0.0, delay_s=0.0)
        self.world.advance(HELD_WITHIN_S)
        if taker:
            self.world.sites["south"].lease.take(self.world.sites["south"].now())
            self.world.advance(2.0)
        assert self.world.holders == [SITES[taker]]
        self.world.loss, self.world.delay_s = 0.15, delay

    def site(self, number: int) -> Any:
        return list(self.world.sites.values())[number % len(self.world.sites)]

    @rule(for_s=PAUSES)
    def advance(self, for_s: float) -> None:
        self.world.advance(for_s)

    @rule(number=st.integers(0, 2), cut=st.booleans(), for_s=PAUSES)
    def cut(self, number: int, cut: bool, for_s: float) -> None:
        self.site(number).cut = cut
        self.world.advance(for_s)

    @rule(number=st.integers(0, 2), bridge=st.booleans(), daemon=st.booleans(), for_s=PAUSES)
    def stop_processes(self, number: int, bridge: bool, daemon: bool, for_s: float) -> None:
        site = self.site(number)
        site.bridge_stopped, site.daemon_stopped = bridge, daemon
        if not bridge:
            inbox, site.bridge_inbox = site.bridge_inbox, []
            for call in inbox:
                call()
        self.world.advance(for_s)

    @rule(number=st.integers(0, 2), daemon=st.booleans())
    def restart(self, number: int, daemon: bool) -> None:
        site = self.site(number)
        site.restart_daemon() if daemon else site.restart_bridge()

    @rule(alive=st.booleans(), new=st.booleans(), for_s=PAUSES)
    def hub(self, alive: bool, new: bool, for_s: float) -> None:
        if new:
            self.world.replace_hub()
        self.world.hub.alive = alive
        self.world.advance(for_s)

    @rule(kind=st.sampled_from(["recreated", "restored", "power cut"]), lost=st.integers(1, 10), for_s=PAUSES)
    def revisions_go_back(self, kind: str, lost: int, for_s: float) -> None:
        go_back(self.world, kind, lost)
        self.world.advance(for_s)

    @rule(number=st.integers(0, 2), force=st.booleans(), for_s=PAUSES)
    def take(self, number: int, force: bool, for_s: float) -> None:
        site = self.site(number)
        # where the home may be going on alone, force is a person's word that it is not
        site.lease.take(site.now(), force=force and not site.goes_on_alone)
        self.world.advance(for_s)

    @rule(number=st.integers(0, 2))
    def hand_over(self, number: int) -> None:
        """Every site in turn asks for it, as people do who play with it."""
        for offset in range(len(self.world.sites)):
            site = self.site(number + offset)
            site.lease.take(site.now())
            self.world.advance(1.5)

    @rule(number=st.integers(0, 2))
    def release(self, number: int) -> None:
        site = self.site(number)
        if not site.bridge_stopped:
            site.carry_out(site.lease.release(site.now()))

    @invariant()
    @precondition(lambda self: hasattr(self, "world"))
    def never_two(self) -> None:
        assert self.world.both == [], self.world.describe()

    def teardown(self) -> None:
        """Left in peace, somebody commands it again."""
        if not hasattr(self, "world"):
            return
        w = self.world
        w.hub.alive = True
        w.loss, w.delay_s = 0.0, 0.01
        for number in range(len(w.sites)):
            self.cut(number, False, 0.0)
            self.stop_processes(number, False, False, 0.0)
        w.advance(6.0)
        if not w.holders:  # its operator had released it
            home = w.sites["north"]
            assert home.lease.take(home.now()) is None
        w.advance(8.0)
        assert w.both == [], w.describe()
        assert len(w.holders) == 1, w.describe()


TestNeverTwo = LeaseMachine.TestCase
TestNeverTwo.settings = settings(max_examples=examples(50), stateful_step_count=30, deadline=None)


def test_a_holder_that_vanishes_while_another_site_is_not_connected_is_followed_all_the_same() -> None:
    w = world(goes_on_alone=False)
    north, south = w.sites["north"], w.sites["south"]
    south.cut = True
    w.advance(3.0)
    north.bridge_stopped = True
    w.advance(4.0)
    south.cut = False
    w.advance_until(lambda: w.holders == ["south"], 4.0)
    assert w.both == []


def test_after_a_restart_of_the_hub_the_home_comes_first() -> None:
    w = world(goes_on_alone=False)
    w.hub.alive = False
    w.advance(5.0)
    assert w.holders == []
    w.sites["north"].cut = True  # its bridge tries again later
    w.hub.alive = True
    w.advance(1.0)
    w.sites["north"].cut = False
    w.advance_until(lambda: w.holders == ["north"], 1.5)
    w.advance(5.0)
    assert w.holders == ["north"]


@each("value", [b"", b"{", b"[]", b'{"holder": 5}', b'{"holder": "' + b"n" * 2000 + b'"}', b"\xff"])
def test_what_nobody_can_read_is_somebodys(value: bytes) -> None:
    entry = decode_entry(value, 9)
    assert (entry.revision, entry.holder) == (9, "?")


def test_the_texts_of_an_entry_can_be_shown() -> None:
    entry = decode_entry(encode_entry("north\x1b", "r\n", 5.0, "\u202esouth"), 3)
    assert entry == Entry(3, "north?", "r?", "?south")
