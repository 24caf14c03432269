"""Other senders with a vehicle's ids: what is reported of them, how often, and when it is over."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from skygcs.core.vehicle.shared_ids import BESIDE_OVER_S, REPORT_AGAIN_S, Finding, SharedIds
from support.table import each

NEVER = -1e9
OVER_S = 1.5 + BESIDE_OVER_S


class Rig:
    def __init__(self) -> None:
        self.ids = SharedIds(7, 1)
        self.heartbeats: Any = SimpleNamespace(contradicted_at=NEVER, alternating=False)
        self.two_clocks = False
        self.boot: Any = SimpleNamespace(two_clocks=lambda now: self.two_clocks)

    def beat(self, origin: Any, now: float) -> Finding | None:
        return self.ids.on_heartbeat(origin, "QUADROTOR", "PX4", "armed", "LOITER, disarmed", now)

    def tick(self, now: float) -> Finding | None:
        return self.ids.tick(self.heartbeats, self.boot, now)


@each(
    ("origin", "kind", "change", "beside"),
    [("other", "conflict", "other_heartbeat", False), ("duplicate", "duplicate", "duplicate", True)],
)
def test_heartbeats_of_others_are_reported_once_a_minute_with_their_number(
    origin: Any, kind: str, change: str, beside: bool
) -> None:
    rig = Rig()
    counts = {}
    for second in range(int(REPORT_AGAIN_S) + 2):
        if (found := rig.beat(origin, float(second))) is not None:
            assert (found[0], found[2]["change"]) == (kind, change)
            counts[second] = found[2]["count"]
    assert counts == {0: 1, REPORT_AGAIN_S: REPORT_AGAIN_S + 1}
    assert (rig.ids.beside, rig.ids.where) == (beside, "on one link" if beside else None)


def test_two_vehicles_are_over_when_neither_heartbeats_nor_clocks_contradict_and_begin_anew() -> None:
    rig = Rig()
    rig.beat("duplicate", 0.0)
    rig.heartbeats.contradicted_at = 1.0
    assert rig.tick(1.0 + BESIDE_OVER_S) is None
    for holds in ({"alternating": True}, {}):
        rig.heartbeats.alternating, rig.two_clocks = bool(holds), not holds
        assert rig.tick(OVER_S) is None and rig.ids.beside
    rig.two_clocks = False
    over = rig.tick(OVER_S)
    assert over is not None and over[2] == {"change": "duplicate_over"} and not rig.ids.beside
    assert rig.tick(OVER_S + 1.0) is None
    # the same one within the minute of its report
    again = rig.beat("duplicate", OVER_S + 2.0)
    assert again is not None and again[2] == {"change": "duplicate"} and rig.ids.beside
    assert rig.beat("duplicate", OVER_S + 3.0) is None


def test_a_second_clock_is_a_second_vehicle_and_reported_once() -> None:
    rig = Rig()
    assert rig.ids.on_clock(rig.boot, 0.0) is None
    rig.two_clocks = True
    found = rig.ids.on_clock(rig.boot, 1.0)
    assert found is not None and found[2] == {"change": "duplicate", "sysid": 7} and rig.ids.beside
    assert found[1].startswith("two vehicles with system id 7 send on one link: their clocks")
    assert rig.ids.on_clock(rig.boot, 2.0) is None


def test_another_vehicle_on_another_channel_is_named_by_the_fleets_table() -> None:
    rig = Rig()
    rig.ids.others = {7 << 8 | 2: "elsewhere"}
    assert rig.ids.where is rig.ids.elsewhere is None
    rig.ids.others = {7 << 8 | 1: "radio 2"}
    assert rig.ids.where == rig.ids.elsewhere == "radio 2"
