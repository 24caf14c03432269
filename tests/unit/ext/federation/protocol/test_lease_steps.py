"""The lease step by step: which action is due at which moment, and not a tick earlier."""

from __future__ import annotations

from collections.abc import Sequence

from skygcs.ext.federation.protocol.lease import (
    Action,
    Ask,
    Entry,
    Grant,
    Inspect,
    Lease,
    LeaseConfig,
    LeaseReport,
    Look,
    Revoke,
    State,
    Write,
    decode_entry,
    encode_entry,
)

RUN = "run"
NORTH, SOUTH = Entry(9, "north", "run of north"), Entry(9, "south", "run of south")


def lease(site: str = "north", *, goes_on_alone: bool = True) -> Lease:
    """Of a vehicle whose home is north."""
    return Lease(LeaseConfig("alpha", "north", site, RUN, goes_on_alone))


def connected(site: str = "north", entry: Entry | None = None, *, goes_on_alone: bool = True) -> Lease:
    """At a hub that it knows, at 0 s, with what it read there."""
    made = lease(site, goes_on_alone=goes_on_alone)
    made.remember("hub")
    assert made.hub_up("hub", 0.0) == [Look()]
    made.seen(entry, 0.0)
    return made


def held(*, goes_on_alone: bool = True) -> Lease:
    """By its home since 0 s with revision 5."""
    made = connected(goes_on_alone=goes_on_alone)
    assert made.tick(0.0) == [Write(1, "north", RUN, None, None)]
    assert made.answered(1, 5, 0.1) == [Grant(0.0, 5, "hub"), LeaseReport("alpha is commanded by north")]
    assert (made.state, made.valid_until, made.holder) == (State.HELD, 2.5, "north")
    return made


def ticks(made: Lease, *times: float) -> list[Action]:
    return [action for now in times for action in made.tick(now)]


def test_a_home_reads_a_new_hubs_key_each_second_and_creates_it_after_3_5_s() -> None:
    made = lease()
    assert made.hub_up("hub", 0.0) == [Look()]
    assert made.seen(None, 0.0) == []
    assert ticks(made, 0.5, 0.99) == []
    assert ticks(made, 1.0, 1.09) == [Look()]
    assert made.tick(1.1) == [Look()], "an answer that does not come is asked for again"
    made.seen(None, 2.6)
    assert ticks(made, 3.4, 3.49) == []
    assert made.tick(3.5) == [Write(1, "north", RUN, None, None)]
    assert made.state is State.WANTED
    assert ticks(made, 3.6, 4.4) == [Look()] * 2, "nothing is written while an answer is awaited; the key is old at 3.6"
    assert made.status(4.4)["state"] == "wanted"


def test_a_lease_is_renewed_each_second_and_counts_from_when_the_write_was_sent() -> None:
    made = held()
    assert made.status(0.5) == {
        "vehicle": "alpha",
        "home": "north",
        "state": "held",
        "holder": "north",
        "held": True,
        "revision": 5,
        "remaining_s": 2.0,
        "without_hub": "continue",
    }
    assert ticks(made, 0.5, 0.99) == []
    assert made.tick(1.0) == [Write(2, "north", RUN, None, 5)]
    assert made.answered(2, 6, 1.4) == [Grant(1.0, 6, "hub")]
    assert made.valid_until == 3.5
    assert ticks(made, 1.99) == []
    assert made.tick(2.0) == [Write(3, "north", RUN, None, 6)]


def test_a_home_that_goes_on_alone_does_so_1_s_before_the_end_and_grants_each_half_second() -> None:
    made = held()
    assert made.tick(1.0) == [Write(2, "north", RUN, None, 5)]
    assert made.tick(1.49) == []
    alone = LeaseReport("alpha: the hub is away; north goes on alone, as its home")
    assert made.tick(1.5) == [alone, Grant(1.5, 5, "hub")]
    assert (made.state, made.valid_until) == (State.ALONE, 4.0)
    assert made.tick(1.99) == [] and made.valid_until == 4.49
    assert made.tick(2.0) == [Grant(2.0, 5, "hub")], "and the write is given up after a second"
    assert made.answered(2, 6, 2.1) == [], "its answer comes too late"
    assert made.tick(2.24) == []
    assert made.tick(2.25) == [Look()]
    assert made.seen(Entry(6, "north", RUN), 2.3) == []
    assert made.tick(2.4) == [Write(3, "north", RUN, None, 6)]
    assert made.answered(3, 7, 2.45) == [
        Grant(2.4, 7, "hub"),
        LeaseReport("alpha: the hub is back, and the lease is held"),
    ]
    assert (made.state, made.valid_until) == (State.HELD, 4.9)


def test_a_home_that_stops_loses_it_when_its_validity_is_over() -> None:
    made = held(goes_on_alone=False)
    made.hub_down(0.2)
    assert made.state is State.HELD
    assert ticks(made, 1.49) == [] and made.state is State.HELD
    assert ticks(made, 1.5) == [] and made.state is State.LATE
    assert ticks(made, 2.49) == []
    assert made.status(2.49)["held"] is True and made.holder == "north"
    lost = LeaseReport("alpha is not commanded by north any more: its lease was not renewed in time")
    assert made.tick(2.5) == [Revoke(5, "hub", None), lost]
    assert (made.state, made.holder) == (State.OBSERVED, None)
    status = made.status(2.5)
    assert (status["held"], status["remaining_s"], status["without_hub"]) == (False, 0.0, "stop")


def test_a_renewal_that_fails_is_tried_again_after_a_quarter_of_a_second() -> None:
    for failing in ("failed", "hub lost"):
        made = held()
        made.tick(1.0)
        if failing == "failed":
            assert made.answered(2, "failed", 1.1) == []
        else:
            assert made.hub_down(1.1) == []
            assert made.hub_up("hub", 1.1) == [Look()]
        assert made.state is State.LATE
        assert ticks(made, 1.1 if failing == "failed" else 1.05, 1.34) == ([] if failing == "failed" else [Look()])
        made.seen(Entry(5, "north", RUN), 1.34)
        assert made.tick(1.35) == [Write(3, "north", RUN, None, 5)]
        assert made.answered(3, 6, 1.36) == [Grant(1.35, 6, "hub")]
        assert made.state is State.HELD


def test_a_home_whose_write_met_another_revision_does_not_go_on_alone_before_it_knows_whose() -> None:
    made = held()
    made.tick(1.0)
    assert made.answered(2, "conflict", 1.2) == [Look()]
    made.hub_down(1.3)
    assert ticks(made, 1.5, 2.4) == [] and made.state is State.LATE
    made.hub_up("hub", 2.4)
    assert made.seen(Entry(6, "north", RUN), 2.41) == [], "it is ours: the answer was lost"
    assert made.tick(2.42) == [
        LeaseReport("alpha: the hub is away; north goes on alone, as its home"),
        Grant(2.42, 6, "hub"),
        Write(3, "north", RUN, None, 6),
    ], "with the token that it read"

    made = held()
    made.tick(1.0)
    made.answered(2, "conflict", 1.2)
    gone = LeaseReport("alpha is not commanded by north any more: another site has taken it (south)")
    assert made.seen(Entry(6, "south", "x"), 1.3) == [Revoke(5, "hub", "south"), gone]
    assert (made.state, made.holder) == (State.OBSERVED, "south")


def test_after_a_conflict_the_key_is_read_and_then_written_with_its_revision() -> None:
    made = connected()
    made.tick(0.0)
    assert made.answered(1, "conflict", 0.1) == [Look()]
    assert made.tick(0.34) == []
    assert made.tick(0.35) == [Look()], "not read yet"
    assert made.seen(Entry(4, None, "x"), 0.36) == [Revoke(0, "", None)]
    assert made.tick(0.4) == [Write(2, "north", RUN, None, 4)]


def test_an_answer_to_another_write_is_no_answer() -> None:
    made = connected()
    made.tick(0.0)
    assert made.answered(2, 5, 0.1) == [] and made.state is State.WANTED
    assert made.answered(1, 5, 0.2)[0] == Grant(0.0, 5, "hub")


def test_an_answer_from_before_a_write_is_given_up_still_counts() -> None:
    for at, given_up in ((0.99, False), (1.0, True)):
        made = connected()
        made.tick(0.0)
        made.tick(at)
        assert (made.answered(1, 5, at) == []) is given_up


def test_an_answer_after_the_whole_validity_gives_nothing_and_is_written_again_at_once() -> None:
    made = connected()
    made.tick(0.0)
    assert made.answered(1, 5, 2.5) == [] and made.state is State.WANTED
    assert made.tick(2.5) == [Write(2, "north", RUN, None, 5)]


def test_a_release_is_written_when_the_daemon_has_closed_its_gate() -> None:
    made = held()
    assert made.release(0.5) == [Revoke(5, "hub", None)]
    assert made.state is State.RELEASING
    assert ticks(made, 0.6, 0.7) == []
    made.revoked(7)
    assert made.tick(0.8) == [], "of another revocation"
    made.revoked(1)
    assert made.tick(0.9) == [Write(2, None, RUN, None, 5)]
    assert made.tick(1.0) == [], "one at a time"
    assert made.answered(2, 6, 1.1) == []
    assert (made.state, made.holder) == (State.OBSERVED, None)
    assert made.status(1.1)["revision"] == 6

    # The home keeps a released key alive, and does not take it again
    assert ticks(made, 1.5, 1.89) == []
    assert made.tick(1.9) == [Write(3, None, RUN, None, 6)]
    assert made.answered(3, 7, 2.0) == []
    assert ticks(made, 2.89) == [] and made.tick(2.9) == [Write(4, None, RUN, None, 7)]


def test_a_release_that_the_daemon_does_not_confirm_is_written_when_its_grant_is_over() -> None:
    made = held()
    made.release(2.4)
    made.seen(Entry(5, "north", RUN), 2.45)
    assert made.tick(2.49) == []
    assert made.tick(2.5) == [Write(2, None, RUN, None, 5)]

    made = held()
    made.release(1.0)
    made.hub_down(1.1)
    assert ticks(made, 1.2, 2.49) == [] and made.state is State.RELEASING
    assert made.tick(2.5) == [] and made.state is State.OBSERVED

    made = held()
    made.release(1.0)
    made.hub_down(1.1)
    made.hub_up("hub", 2.6)
    assert made.tick(2.6) == [] and made.state is State.OBSERVED, "what was not read has expired, or will"


def test_a_release_before_the_write_is_answered_gives_up_what_it_brings() -> None:
    made = connected("south")
    assert made.take(0.0) is None
    assert made.tick(0.0) == []
    made = connected("south", goes_on_alone=False)
    made.take(0.0)
    assert made.tick(0.0) == [Write(1, "south", RUN, None, None)]
    assert made.release(0.1) == []
    assert made.answered(1, 5, 0.2) == [Revoke(0, "", None)]
    assert made.state is State.RELEASING
    made.revoked(1)
    assert made.tick(0.3) == [Write(2, None, RUN, None, 5)]

    made = connected("south", goes_on_alone=False)
    made.take(0.0)
    made.tick(0.0)
    made.release(0.1)
    made.answered(1, 5, 0.2)
    assert made.tick(1.0) == [Write(2, None, RUN, None, 5)], "no grant was given: nothing needs to be confirmed"

    made = connected("south")
    assert made.release(0.1) == [] and made.state is State.OBSERVED, "nothing to give up"


def test_a_release_of_a_key_that_is_gone_is_written_with_the_last_revision() -> None:
    made = held()
    made.release(0.5)
    assert made.seen(None, 0.6) == []
    made.revoked(1)
    assert made.tick(0.9) == [Write(2, None, RUN, None, 5)]


def test_a_holder_releases_what_another_site_asks_for_unless_it_is_busy() -> None:
    made = held()
    refusal, actions = made.requested("south", 0.5, busy="alpha is flown by anna")
    assert (refusal, actions) == ("alpha is flown by anna; `--force` takes it all the same", [])
    assert made.state is State.HELD
    asked = LeaseReport("alpha goes to south, which asked for it")
    assert made.requested("south", 0.5, busy="x", force=True) == (None, [asked, Revoke(5, "hub", "south")])
    made.revoked(1)
    assert made.tick(0.6) == [Write(2, None, RUN, "south", 5)]
    made.answered(2, 6, 0.7)
    assert ticks(made, 0.8, 1.5) == [], "the home leaves it to the site that asked"
    assert made.requested("south", 0.8, busy="x") == (None, []), "not its holder any more"


def test_a_person_takes_it_from_its_holder_by_asking_each_second() -> None:
    made = connected("south", NORTH)
    assert made.holder == "north"
    assert made.take(0.2, force=True) is None
    assert made.state is State.WANTED
    assert made.tick(0.2) == [Ask("north", True)]
    assert ticks(made, 0.3, 1.19) == []
    assert made.tick(1.2) == [Ask("north", True)]
    assert made.asked("it is flown", 1.21) == [], "force goes on, and reads what became of it"
    assert made.tick(1.22) == [Look()]
    assert made.seen(Entry(10, None, "run of north", "south"), 1.23) == [Revoke(0, "", None)]
    assert made.tick(1.24) == [Write(1, "south", RUN, None, 10)]
    assert made.answered(1, 11, 1.3) == [Grant(1.24, 11, "hub"), LeaseReport("alpha is commanded by south")]
    assert made.take(1.4) is None and made.state is State.HELD


def test_a_request_that_is_refused_ends_and_one_without_an_answer_after_8_s() -> None:
    made = connected("south", NORTH)
    made.take(0.0)
    assert made.tick(0.0) == [Ask("north", False)]
    assert made.asked("it is flown", 0.1) == [LeaseReport("alpha was not taken: it is flown")]
    assert made.asked("it is flown", 0.15) != [] and made.tick(0.2) == []
    assert made.state is State.OBSERVED
    assert made.asked("it is flown", 0.3) == [], "an answer to a request that has ended"

    made = connected("south", NORTH)
    made.take(0.0)
    made.seen(NORTH, 7.5)
    made.tick(7.99)
    assert made.state is State.WANTED
    made.tick(8.0)
    assert made.state is State.OBSERVED


def test_a_request_at_a_new_hub_is_pursued_for_8_s_after_its_leases_are_over() -> None:
    made = lease("south", goes_on_alone=False)
    made.hub_up("hub", 0.0)
    made.take(0.0)
    for now, state in ((11.4, State.WANTED), (11.5, State.OBSERVED)):
        made.tick(now)
        assert made.state is state, now


def test_who_may_take_a_free_key() -> None:
    """The home at once; another site on request, by force where the home may go on alone; never what is promised."""
    write = [Write(1, "south", RUN, None, None)]
    for goes_on_alone, force, expected in ((True, False, []), (True, True, write), (False, False, write)):
        made = connected("south", goes_on_alone=goes_on_alone)
        made.take(0.0, force=force)
        assert made.tick(0.0) == expected, (goes_on_alone, force)
        assert connected("south", goes_on_alone=goes_on_alone).tick(0.0) == [], "not by itself"

    released = Entry(4, None, "x")
    promised = Entry(4, None, "x", "east")
    for site, entry, request, force, takes in (
        ("north", released, False, False, True),
        ("north", promised, False, False, False),
        ("north", promised, True, False, False),
        ("north", promised, True, True, True),
        ("south", released, False, False, False),
        ("south", released, True, False, True),
        ("south", promised, True, False, False),
        ("south", Entry(4, None, "x", "south"), True, False, True),
        ("north", Entry(4, "north", RUN), False, False, True),
        ("south", Entry(4, "south", RUN), False, False, False),
        ("south", Entry(4, "south", RUN), True, False, True),
    ):
        made = connected(site, entry)
        if request:
            made.take(0.0, force=force)
        assert made.tick(0.0) == ([Write(1, site, RUN, None, 4)] if takes else []), (site, entry, request, force)


def test_another_site_follows_a_holder_that_vanished_a_quarter_of_a_second_after_the_home() -> None:
    made = connected("south", NORTH, goes_on_alone=False)
    made.seen(None, 2.5)
    assert made.tick(2.74) == []
    assert made.tick(2.75) == [Write(1, "south", RUN, None, None)]

    # Not where the home goes on alone, nor after a release, nor before the home can have reconnected
    made = connected("south", NORTH)
    made.seen(None, 2.5)
    assert ticks(made, 2.75, 3.4) == []
    made = connected("south", Entry(9, None, "x"), goes_on_alone=False)
    made.seen(None, 2.5)
    assert ticks(made, 2.75, 3.4) == []
    made = connected("south", NORTH, goes_on_alone=False)
    made.seen(None, 0.5)
    made.seen(None, 1.3)
    assert made.tick(1.99) == []
    assert made.tick(2.0) == [Write(1, "south", RUN, None, None)]

    # An absence before the hub was lost does not count: the home may have come and gone since
    made = connected("south", NORTH, goes_on_alone=False)
    made.seen(None, 2.5)
    made.hub_down(2.6)
    made.hub_up("hub", 5.0)
    made.seen(None, 6.9)
    assert made.tick(7.14) == []
    assert made.tick(7.15) == [Write(1, "south", RUN, None, None)]


def test_a_home_does_not_take_what_its_operator_released_until_another_site_had_it() -> None:
    made = connected("north", SOUTH)
    made.release(0.0)
    made.seen(None, 0.1)
    assert made.tick(0.1) == [Write(1, None, RUN, None, None)]
    made = connected("north", SOUTH)
    made.release(0.0)
    made.seen(Entry(10, "south", "x"), 0.1)
    made.seen(None, 0.2)
    assert made.tick(0.2) == [Write(1, "north", RUN, None, None)]
    made = connected("north", SOUTH)
    made.release(0.0)
    assert made.take(0.1) is None
    made.seen(None, 0.2)
    assert made.tick(0.2) == [Write(1, "north", RUN, None, None)]


def test_a_key_of_another_site_is_read_each_second_and_a_quarter() -> None:
    made = connected("south", NORTH)
    assert ticks(made, 1.0, 1.24) == []
    assert made.tick(1.25) == [Look()]
    made.seen(NORTH, 1.3)
    assert made.tick(1.35) == [Look()], "the same revision: it may have expired meanwhile"
    made.seen(Entry(10, "north", "x"), 1.4)
    assert ticks(made, 1.5, 2.64) == [] and made.tick(2.65) == [Look()]


def test_a_reading_of_an_older_revision_changes_nothing() -> None:
    made = held()
    assert made.seen(Entry(4, "south", "x"), 0.2) == [Inspect()]
    assert made.state is State.HELD
    assert made.seen(Entry(5, "north", RUN), 0.2) == []
    made = connected("south", NORTH)
    assert made.seen(Entry(8, "east", "x"), 0.2) == [Inspect()] and made.holder == "north"
    assert made.seen(Entry(9, "north", "x"), 0.3) == [Revoke(0, "", "north")]


def test_without_the_hub_its_home_commands_it_by_force_4_s_after_the_hub_was_lost() -> None:
    made = held(goes_on_alone=False)
    made.hub_down(0.5)
    made.tick(2.5)
    assert made.take(2.6) == "the hub is away; `--without-hub --force` if no other site commands it"
    assert made.take(2.6, without_hub=True) == "another site may command it: insist with --force if none does"
    later = "another site may hold it for {} s more: try again then"
    assert made.take(2.6, without_hub=True, force=True) == later.format("1.9")
    assert made.take(4.4, without_hub=True, force=True) == later.format("0.1")
    assert made.take(4.5, without_hub=True, force=True) is None
    assert (made.state, made.valid_until) == (State.ALONE, 7.0)
    assert made.tick(4.5) == [Grant(4.5, 6, "hub")], "a token above the one that was revoked"
    assert made.take(4.6) is None

    assert connected().take(0.0, without_hub=True) == "the hub is there: take it without --without-hub"
    south = lease("south")
    assert south.take(9.0) == "the hub is away"
    assert south.take(9.0, without_hub=True, force=True) == "only its home (north) may command it without the hub"


def test_a_bridge_goes_on_with_the_grant_of_its_daemon() -> None:
    made = lease()
    made.adopt(until=2.0, token=5, hub="hub")
    assert (made.state, made.holder, made.valid_until) == (State.LATE, "north", 2.0)
    assert made.hub_up("hub", 0.1) == [Look()]
    assert made.seen(Entry(5, "north", RUN), 0.2) == []
    assert made.tick(0.3) == [Write(1, "north", RUN, None, 5)]
    assert made.answered(1, 6, 0.4) == [Grant(0.3, 6, "hub")], "it was and stays the commander: no report"

    made = lease()
    made.adopt(until=2.0, token=5, hub="hub")
    made.hub_up("another hub", 0.1)
    assert made.seen(None, 0.2) == []
    assert made.tick(0.3) == [Write(1, "north", RUN, None, None)], "what is valid is written to a new hub at once"
    assert made.answered(1, 1, 0.4) == [Grant(0.3, 1, "another hub")]
    made = lease()
    made.adopt(until=2.0, token=5, hub="hub")
    made.seen(Entry(7, "south", "x"), 0.2)
    assert made.state is State.OBSERVED
    made = lease(goes_on_alone=False)
    made.adopt(until=2.0, token=5, hub="hub")
    made.tick(2.0)
    assert made.state is State.OBSERVED
    made.hub_up("hub", 2.1)
    made.seen(None, 2.2)
    assert made.tick(2.2) == [Write(1, "north", RUN, None, None)], "the hub is the one of the grant, and not new"


def test_entries_are_bounded_and_what_cannot_be_read_is_another_sites() -> None:
    unknown = Entry(3, "?", "")

    def read(entries: Sequence[tuple[str | None, str, str | None]]) -> list[Entry]:
        return [decode_entry(encode_entry(holder, run, 1.0, wanted), 3) for holder, run, wanted in entries]

    long = "n" * 64
    assert read([(long, long, long), (None, "", None)]) == [Entry(3, long, long, long), Entry(3, None, "", None)]
    assert read([(long + "n", "r", None), ("n", long + "r", None), ("n", "r", long + "s")]) == [unknown] * 3
    assert encode_entry("n", "r", 1.23456, None) == b'{"holder":"n","run":"r","since_s":1.235,"wanted_by":null}'
    padded = b'{"holder": "n"' + b" " * 2000
    assert decode_entry(padded[:1023] + b"}", 3) == Entry(3, "n", "")
    assert decode_entry(padded[:1024] + b"}", 3) == unknown
    assert decode_entry(b'{"holder": "n", "run": 5}', 3) == unknown
