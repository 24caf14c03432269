"""Upload, download and clearing over good and bad networks, against both autopilots' ways of storing a mission."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.mission.item import MissionItem, MissionType
from skygcs.core.protocols.base import Finish, Send
from skygcs.core.protocols.mission import (
    CLEAR_TRIES,
    MAX_TRIES,
    MissionClear,
    MissionDownload,
    MissionOutcome,
    MissionProtocol,
    opaque_id,
)
from skygcs.core.protocols.mission import MAX_ROUNDS as DOWNLOAD_ROUNDS
from skygcs.core.protocols.mission_upload import ANSWERS_PER_ITEM, LINGER_S, MAX_ROUNDS, SILENCE_S, MissionUpload
from support.examples import examples
from support.frames import dialect
from support.mission_vehicle import (
    ArduPilotMission,
    MissionRig,
    MissionVehicle,
    Px4Mission,
    Reply,
    opaque_of,
)
from support.param_vehicle import Network
from support.table import each

VEHICLES = {"ardupilot": ArduPilotMission, "px4": Px4Mission}
NETWORKS = {
    "lossy": Network(loss=0.2),
    "doubling": Network(duplicate=0.3, delay_s=(0.01, 0.3)),
    "reordering": Network(delay_s=(0.0, 1.0)),
    "slow": Network(delay_s=(1.9, 2.1)),
    "bytewise": Network(loss=0.05, bytewise=True),
    "all at once": Network(loss=0.2, duplicate=0.2, delay_s=(0.02, 0.6), bytewise=True),
}


def mission(count: int, first: int = 0) -> list[MissionItem]:
    """Items that all differ, with numbers that are not round."""
    return [
        MissionItem(16, 3, (n / 3, None, 0.0, None), 437800000 + 31 * n, -794600000 - 17 * n, 10 + n / 7)
        for n in range(first, first + count)
    ]


def upload(items: list[MissionItem], vehicle: MissionVehicle, **more: Any) -> MissionUpload:
    return MissionUpload(MissionType.MISSION, items, keeps_old=isinstance(vehicle, Px4Mission), **more)


def outcome_of(rig: MissionRig | MissionProtocol) -> MissionOutcome:
    exchange = rig.exchange if isinstance(rig, MissionRig) else rig
    assert exchange.outcome is not None and exchange.deadline is None
    return exchange.outcome


def uploading(count: int, *requests: tuple[int, float]) -> MissionUpload:
    """An upload to a PX4 that began at 0 s, and was asked for these items at these times."""
    exchange = upload(mission(count), Px4Mission())
    exchange.start(0.0)
    for seq, now in requests:
        exchange.on_request(seq, now)
    return exchange


def downloading(kind: MissionType = MissionType.MISSION) -> MissionDownload:
    exchange = MissionDownload(kind)
    exchange.start(0.0)
    return exchange


@each("family", VEHICLES)
def test_an_upload_on_a_good_link_sends_each_item_once(family: str) -> None:
    vehicle = VEHICLES[family](items=mission(3, 50))
    items = mission(5)
    rig = MissionRig(upload(items, vehicle), vehicle).run()
    assert vehicle.items == items
    assert [message for message, _ in rig.sent] == ["MISSION_COUNT"] + ["MISSION_ITEM_INT"] * 5
    outcome = outcome_of(rig)
    assert (outcome.ok, outcome.state, outcome.sent) == (True, "complete", 6)
    assert outcome.message == "5 mission items taken"
    assert outcome.opaque_id == opaque_of(items)
    assert rig.reports == [16, 33, 50, 66, 83]


@each("family", VEHICLES)
def test_a_download_on_a_good_link_asks_for_each_item_once(family: str) -> None:
    items = mission(5)
    vehicle = VEHICLES[family](items=list(items))
    rig = MissionRig(MissionDownload(MissionType.MISSION), vehicle).run()
    outcome = outcome_of(rig)
    assert outcome.items == tuple(items)
    assert (outcome.state, outcome.message, outcome.opaque_id) == ("complete", "5 items read", opaque_of(items))
    assert [m for m, _ in rig.sent] == ["MISSION_REQUEST_LIST", *["MISSION_REQUEST_INT"] * 5, "MISSION_ACK"]


@each("seed, network", enumerate(NETWORKS))
@each("family", VEHICLES)
def test_many_items_go_up_and_down_exactly_over_a_bad_network(family: str, network: str, seed: int) -> None:
    vehicle = VEHICLES[family](items=mission(7, 1000))
    items = mission(130)
    up = MissionRig(upload(items, vehicle), vehicle, NETWORKS[network], seed).run()
    assert outcome_of(up).ok, outcome_of(up).message
    assert vehicle.items == items
    up.settle()
    assert vehicle.items == items and not vehicle.receiving
    down = MissionRig(MissionDownload(MissionType.MISSION), vehicle, NETWORKS[network], seed)
    down.now = up.now
    assert outcome_of(down.run()).items == tuple(items)


def networks(slowest_s: float, **more: Any) -> st.SearchStrategy[Network]:
    delays = st.tuples(st.floats(0, 0.2), st.floats(0.2, slowest_s))
    return st.builds(Network, loss=st.floats(0, 0.25), duplicate=st.floats(0, 0.5), delay_s=delays, **more)


families = st.sampled_from(sorted(VEHICLES))


@settings(max_examples=examples(60), deadline=None)
@given(
    families,
    st.integers(0, 2**32),
    networks(2.0, bytewise=st.booleans()),
    st.integers(1, 25),
    st.integers(0, 30),
    st.none() | st.integers(0, 60),
)
def test_any_upload_ends_bounded_and_tells_the_truth(family, seed, net, count, before, cut_after) -> None:
    vehicle = VEHICLES[family](items=mission(before, 1000))
    old, items = list(vehicle.items), mission(count)
    exchange = upload(items, vehicle)
    rig = MissionRig(exchange, vehicle, net, seed)
    rig.run(until=lambda: cut_after is not None and len(rig.sent) > cut_after)
    if not exchange.done:
        rig._carry_out(exchange.stop(rig.now, "cancelled", "cancelled by the operator"))
    outcome = outcome_of(rig)
    rig.settle()
    assert outcome.sent <= MAX_ROUNDS * (MAX_TRIES * (2 + count)) + ANSWERS_PER_ITEM * count + DOWNLOAD_ROUNDS * count
    assert outcome.state in ("complete", "unchanged", "partial", "unknown")
    assert outcome.ok == (outcome.state == "complete") or outcome.state == "unchanged"
    if outcome.state == "complete":
        assert vehicle.items == items and not vehicle.receiving
    if outcome.state == "unchanged":
        assert vehicle.items == old


@settings(max_examples=examples(40), deadline=None)
@given(families, st.integers(0, 2**32), networks(1.0), st.integers(0, 25))
def test_any_download_is_exact_or_says_that_it_failed(family: str, seed: int, net: Network, count: int) -> None:
    """Whatever ended it at the vehicle, unheard: a late copy of a request, 5 s of silence. The list is asked for again.
    (300 runs at the worst of these networks were all exact.)"""
    vehicle = VEHICLES[family](items=mission(count))
    outcome = outcome_of(MissionRig(MissionDownload(MissionType.MISSION), vehicle, net, seed).run())
    assert outcome.ok and outcome.items == tuple(mission(count)), outcome.message
    assert outcome.sent <= DOWNLOAD_ROUNDS * MAX_TRIES * (count + 1) + 1


class LosesLastAck(ArduPilotMission):
    """Its word that the mission was taken never comes."""

    def ack(self, result: int) -> list[Reply]:
        return [] if result == 0 else super().ack(result)


def test_a_lost_last_ack_is_found_out_by_reading_back() -> None:
    vehicle = LosesLastAck()
    outcome = outcome_of(MissionRig(upload(mission(4), vehicle), vehicle).run())
    assert (outcome.ok, outcome.state, outcome.opaque_id) == (True, "complete", opaque_of(mission(4)))
    assert "read back" in outcome.message


class DeafForItems(Px4Mission):
    """No item reaches it until it has given the first upload up, at 5 s."""

    deaf_until = 106.5

    def on_item(self, seq: int, item: MissionItem) -> list[Reply]:
        return super().on_item(seq, item) if self.now > self.deaf_until else []


@each("before", [(5003, 0, 500.0), (5003, 3, 50.0), (5001, 0, 50.0)])
def test_an_old_list_that_differs_in_any_number_is_not_taken_for_the_new_one(before: tuple[int, int, float]) -> None:
    """A fence's circle of another radius was; it came to "accepted", and the vehicle held the old one."""
    command, frame, radius_m = before
    new = [MissionItem(5003, 0, (50.0, 0.0, 0.0, 0.0), 437800000, -794600000, 0.0)]
    old = MissionItem(command, frame, (radius_m, 0.0, 0.0, 0.0), 437800000, -794600000, 0.0)
    vehicle = DeafForItems(items=[old], kind=MissionType.FENCE)
    exchange = MissionUpload(MissionType.FENCE, new, keeps_old=True, family="px4")
    outcome = outcome_of(MissionRig(exchange, vehicle).run())
    assert outcome.ok and vehicle.items == new, outcome.message


def test_what_the_vehicle_holds_otherwise_is_no_success() -> None:
    class Forgets(LosesLastAck):
        def on_list(self) -> list[Reply]:
            self.items = mission(4, 500)
            return super().on_list()

    vehicle = Forgets()
    outcome = outcome_of(MissionRig(upload(mission(4), vehicle), vehicle).run())
    assert not outcome.ok and outcome.state == "unknown"
    assert f"not taken in {MAX_ROUNDS} rounds: it holds other items, 4 of them" in outcome.message


def test_the_old_request_is_answered_with_an_integer_item() -> None:
    vehicle = ArduPilotMission(old_requests=True)
    MissionRig(upload(mission(3), vehicle), vehicle).run()
    assert vehicle.items == mission(3)


OLD_AND_NEW = {
    "ardupilot": ("partial", "items up to {} are new and what follows is old: do not fly it"),
    "px4": ("unchanged", "the vehicle keeps the mission it had"),
}


@each("family", VEHICLES)
def test_a_refused_item_is_named_with_what_the_vehicle_holds_now(family: str) -> None:
    state, said = OLD_AND_NEW[family]
    vehicle = VEHICLES[family](items=mission(9, 1000), refuses={2: 12})
    rig = MissionRig(upload(mission(6), vehicle), vehicle)
    rig.run(until=lambda: len(rig.sent) == 4)
    rig.exchange.on_text("Mission: altitude too low")
    rig.settle(5)
    outcome = outcome_of(rig)
    assert (outcome.ok, outcome.result, outcome.state) == (False, "denied", state)
    assert outcome.message.startswith("item 3: altitude (param7) is invalid: Mission: altitude too low; ")
    assert said.format(2) in outcome.message


@each("family", VEHICLES)
def test_cancelling_says_what_the_vehicle_holds_and_tells_the_vehicle(family: str) -> None:
    state, said = OLD_AND_NEW[family]
    vehicle = VEHICLES[family](items=mission(9, 1000))
    rig = MissionRig(upload(mission(6), vehicle), vehicle)
    rig.run(until=lambda: len(rig.sent) == 5)
    rig._carry_out(rig.exchange.stop(rig.now, "cancelled", "cancelled"))
    outcome = outcome_of(rig)
    assert (outcome.result, outcome.state) == ("cancelled", state)
    assert outcome.message.startswith("cancelled; " + said.format(3))
    rig.settle(1)
    assert vehicle.cancelled
    assert rig.exchange.stop(rig.now, "lost", "again") == ()


def test_a_mission_too_long_for_the_vehicle_is_refused_before_any_item() -> None:
    vehicle = Px4Mission(capacity=10)
    rig = MissionRig(upload(mission(11), vehicle), vehicle).run()
    assert outcome_of(rig).message == (
        "not taken: the vehicle has no space for so many items; the vehicle keeps the mission it had"
    )
    assert [message for message, _ in rig.sent] == ["MISSION_COUNT"]


def test_an_acceptance_before_all_items_were_asked_for_is_not_believed() -> None:
    exchange = uploading(2)
    assert exchange.on_ack(0, 0.1) == ()
    exchange.on_request(0, 0.2)
    assert exchange.on_ack(0, 0.3) == ()
    exchange.on_request(1, 0.4)
    exchange.on_ack(0, 0.5)
    assert exchange.done
    (again,) = exchange.on_request(0, 1.0)
    assert isinstance(again, Send) and again.values["seq"] == 0, "one that begins anew is given the items for a while"
    assert exchange.on_request(0, 0.6 + LINGER_S) == ()


def test_a_vehicle_that_never_has_enough_is_left() -> None:
    exchange, sent, now = uploading(2), 0, 1.0
    while not exchange.done:
        now += 0.2
        sent += sum(isinstance(e, Send) for e in exchange.on_request(0, now))
    assert sent == 2 * ANSWERS_PER_ITEM
    assert "goes on asking" in outcome_of(exchange).message


def test_a_request_that_came_over_two_links_is_answered_once_and_one_beyond_the_list_not() -> None:
    exchange = uploading(2)
    assert [len(exchange.on_request(seq, at)) for seq, at in ((2, 0.9), (0, 1.0), (0, 1.02), (0, 1.3))] == [0, 2, 0, 2]


def test_an_upload_that_was_accepted_while_it_was_read_back_stays_over() -> None:
    exchange = uploading(1, (0, 0.2))
    exchange.on_timer(0.2 + SILENCE_S)
    assert any(isinstance(effect, Finish) for effect in exchange.on_ack(0, 7.0))
    assert exchange.on_count(1, 7.1) == ()
    assert exchange.on_item(0, mission(1, 5)[0].values(), 7.2) == ()
    assert outcome_of(exchange).ok


@each(
    ("exchange", "state", "tries", "said"),
    [
        ("upload", "unchanged", MAX_TRIES, f"no request came after {MAX_TRIES} offers; the vehicle keeps the mission"),
        ("download", "unchanged", MAX_TRIES, f"no answer to {MAX_TRIES} requests of the list"),
        ("clear", "unknown", CLEAR_TRIES, "download it to see"),
    ],
)
def test_silence_ends_each_of_them(exchange: str, state: str, tries: int, said: str) -> None:
    vehicle, kind = Px4Mission(), MissionType.MISSION
    protocol = {"download": MissionDownload(kind), "clear": MissionClear(kind)}.get(
        exchange, upload(mission(2), vehicle)
    )
    rig = MissionRig(protocol, vehicle, Network(loss=1.0)).run()
    outcome = outcome_of(rig)
    assert (outcome.result, outcome.state, len(rig.sent)) == ("timeout", state, tries)
    assert said in outcome.message


def test_a_list_that_changes_while_it_is_read_is_read_anew() -> None:
    vehicle = ArduPilotMission(items=mission(6))
    rig = MissionRig(MissionDownload(MissionType.MISSION), vehicle)
    rig.run(until=lambda: len(rig.sent) == 4)
    vehicle.items = mission(3, 70)
    rig._reply(vehicle.count())
    while not rig.exchange.done:
        rig.step()
    assert outcome_of(rig).items == tuple(mission(3, 70))


def test_a_refused_list_waits_for_the_reason() -> None:
    exchange = downloading(MissionType.RALLY)
    exchange.on_ack(3, 0.5)
    exchange.on_text("no rally points here")
    exchange.on_timer(5.0)
    outcome = outcome_of(exchange)
    assert (outcome.result, outcome.state) == ("unsupported", "unchanged")
    assert outcome.message == "not read: not supported by the vehicle: no rally points here"


def test_an_item_no_plan_can_hold_ends_a_download_with_its_number() -> None:
    exchange = downloading()
    exchange.on_count(1, 0.1)
    exchange.on_item(0, {**mission(1)[0].values(), "param1": float("inf")}, 0.2)
    assert not outcome_of(exchange).ok
    assert "item 0 of the vehicle's mission: param1" in outcome_of(exchange).message


@each("network", NETWORKS)
@each("family", VEHICLES)
def test_clearing_works_over_a_bad_network(family: str, network: str) -> None:
    vehicle = VEHICLES[family](items=mission(3))
    rig = MissionRig(MissionClear(MissionType.MISSION), vehicle, NETWORKS[network], seed=3).run()
    assert outcome_of(rig).state == "cleared" and vehicle.items == []


def test_a_refused_clearing_leaves_it_as_it_was() -> None:
    exchange = MissionClear(MissionType.FENCE)
    exchange.start(0.0)
    exchange.on_ack(14, 0.2)
    exchange.on_timer(1.0)
    assert outcome_of(exchange).message == "not cleared: the vehicle takes no missions from us now"
    assert outcome_of(exchange).state == "unchanged"


def test_an_ardupilots_home_need_not_come_back_as_it_was_sent() -> None:
    class OwnHome(LosesLastAck):
        def on_item(self, seq: int, item: MissionItem) -> list[Reply]:
            return super().on_item(seq, mission(1, 77)[0] if seq == 0 else item)

    vehicle = OwnHome()
    exchange = upload(mission(3), vehicle, first_number=0, home_first=True)
    outcome = outcome_of(MissionRig(exchange, vehicle).run())
    assert outcome.ok and outcome.message.startswith("2 mission items taken")


def test_the_opaque_id_is_read_behind_the_fields_of_every_dialect() -> None:
    count = dialect().by_name["MISSION_COUNT"].pack({"count": 3})
    assert opaque_id(count + (77).to_bytes(4, "little"), 5) == 77
    assert opaque_id(count + b"\x4d", 5) == 77  # zeros behind it are cut off on the wire
    assert opaque_id(count, 5) is None


def test_an_outcome_is_json_able_and_has_what_every_order_tells() -> None:
    vehicle = Px4Mission()
    reported = outcome_of(MissionRig(upload(mission(1), vehicle), vehicle).run()).as_dict()
    assert {"ok", "result", "message", "attempts", "elapsed_s", "status_texts"} <= reported.keys()
    assert (reported["list"], reported["state"]) == ("mission", "complete")


def test_an_empty_list_is_cleared_and_not_uploaded() -> None:
    with pytest.raises(ValueError, match="0 items"):
        MissionUpload(MissionType.MISSION, [], keeps_old=True)


def test_a_list_that_never_stops_changing_is_given_up() -> None:
    exchange = downloading()
    for n in range(100):
        exchange.on_count(3 + n, n + 0.1)
        if exchange.done:
            break
        exchange.on_count(4 + n, n + 0.2)
    said = f"not read in {DOWNLOAD_ROUNDS} rounds: its list changed while it was read"
    assert said in outcome_of(exchange).message


@each("result", [14, 15])
def test_a_list_is_read_when_a_broken_off_upload_has_timed_out(result: int) -> None:
    """An ArduPilot denies its list for 8 s from the last item of an upload, and then says that it gives it up."""
    exchange, now = downloading(), 0.0
    while now < 8.0:
        exchange.on_ack(14, now + 0.1)
        assert exchange.outcome is None and exchange.deadline is not None
        now = exchange.deadline
        assert [e.message for e in exchange.on_timer(now) if isinstance(e, Send)] == ["MISSION_REQUEST_LIST"]
    exchange.on_ack(result, now + 0.1)
    exchange.on_count(0, now + 0.2)
    assert outcome_of(exchange).ok and outcome_of(exchange).items == ()


def test_a_list_that_stays_denied_is_not_asked_for_without_end() -> None:
    exchange, now = downloading(), 0.0
    while exchange.outcome is None and now < 60.0:
        exchange.on_ack(14, now + 0.1)
        assert exchange.deadline is not None
        now = exchange.deadline
        exchange.on_timer(now)
    assert outcome_of(exchange).result == "denied" and 10.0 <= now < 14.0
    assert "8 s from an upload that was broken off" in outcome_of(exchange).message


@each(("keeps_old", "state"), [(True, "unchanged"), (False, "partial")])
def test_a_refusal_of_the_last_item_is_no_riddle(keeps_old: bool, state: str) -> None:
    refused, silent = (MissionUpload(MissionType.MISSION, mission(3), keeps_old=keeps_old) for _ in range(2))
    for exchange in (refused, silent):
        exchange.start(0.0)
        for seq in range(3):
            exchange.on_request(seq, 1.0 + seq)
    refused.on_ack(3, 4.0)
    refused.on_timer(10.0)
    assert outcome_of(refused).state == state
    assert outcome_of(refused).message.startswith("item 3: not supported by the vehicle; ")
    silent.stop(4.0, "cancelled", "cancelled")
    assert outcome_of(silent).state == "unknown"
