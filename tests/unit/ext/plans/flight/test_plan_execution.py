"""A plan in flight as a state machine: its table, and what holds whatever happens in whatever order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.core.plan.fleet_plan import Phase, PhasedPlan, TimedPlan
from skygcs.core.plan.straight_flight import straight_trajectories
from skygcs.core.trajectory import ClockState, MotionLimits
from skygcs.errors import RefusedError
from skygcs.ext.plans.flight.execution import BARRIER_S, LATE_S, POSITION_SILENT_S, SETTLED_S, Execution
from skygcs.ext.plans.flight.flight_steps import FlightStep, StepKind, phased_steps, steps_of
from skygcs.ext.plans.flight.plan_states import Order, OrderKind, PlanState
from skygcs.ext.plans.flight.sights import Departure, DepartureCause, Measurement, Pair, Tubes, pairs_near, pairs_text
from support.examples import examples
from support.table import each

NAMES = ("alpha", "bravo")
STARTS = {"alpha": (0.0, 0.0, 10.0), "bravo": (6.0, 0.0, 10.0)}
GOALS = {"alpha": (0.0, 12.0, 10.0), "bravo": (6.0, 12.0, 10.0)}
GROUND = {name: (x, y, 0.0) for name, (x, y, _) in STARTS.items()}
MOVING = {OrderKind.ARM, OrderKind.TAKEOFF, OrderKind.ENGAGE, OrderKind.FLY, OrderKind.GO_ON, OrderKind.LAND}


def tubes(names: tuple[str, ...] = NAMES) -> Tubes:
    return Tubes(dict.fromkeys(names, 1.25), dict.fromkeys(names, 1.0), dict.fromkeys(names, 0.4), 2.0)


def steps() -> list[FlightStep]:
    limits = MotionLimits(speed_mps=2.0)
    way = phased_steps(
        PhasedPlan({n: (x, y - 3.0, z) for n, (x, y, z) in STARTS.items()}, (Phase("to the starts", STARTS),)),
        StepKind.WAY_THERE,
        limits,
    )
    ways = straight_trajectories(list(STARTS.values()), list(GOALS.values()), limits)
    return [*way, *steps_of(TimedPlan(dict(zip(STARTS, ways, strict=True))), limits)]


class Told:
    """An execution, its clock and the vehicles, which do what they are ordered; a test changes what it wants."""

    def __init__(self, grounded: tuple[str, ...] = NAMES, *, together: bool = True) -> None:
        self.execution = Execution(
            steps(),
            grounded,
            tubes(),
            {n: GROUND[n] if n in grounded else place for n, place in steps()[0].starts().items()},
            together=together,
        )
        self.now = 100.0
        self.clock: ClockState | None = None
        self.s = 0.0
        self.orders: list[Order] = []
        ground = {n: Measurement(GROUND[n], armed=False, on_ground=True) for n in NAMES}
        air = {n: Measurement(self.execution.step.starts()[n]) for n in NAMES}
        self.sights: dict[str, Measurement] = {n: ground[n] if n in grounded else air[n] for n in NAMES}
        self.take(self.execution.begin())

    @property
    def state(self) -> PlanState:
        return self.execution.state

    def take(self, orders: list[Order]) -> list[Order]:
        self.orders += orders
        for order in orders:
            match order.kind:
                case OrderKind.FLY:
                    self.clock, self.s = ClockState.RUNNING, 0.0
                case OrderKind.STOP_CLOCK:
                    self.clock = ClockState.PAUSED
                case OrderKind.GO_ON:
                    self.clock = ClockState.RUNNING
                case OrderKind.END_CLOCK:
                    self.clock = ClockState.ABORTED
        return orders

    def tick(self, by_s: float = 0.2) -> list[Order]:
        self.now += by_s
        return self.take(self.execution.tick(self.now, self.clock, self.s, self.sights))

    def done(self, kind: OrderKind, *names: str, ok: bool = True, text: str = "it says no") -> list[Order]:
        found = []
        for name in names or NAMES:
            found += self.take(self.execution.outcome(kind, name, ok, text))
        return found

    def see(self, name: str, **changes: Any) -> None:
        self.sights[name] = self.sights[name]._replace(**changes)

    def at(self, places: Mapping[str, Any]) -> None:
        for name, place in places.items():
            self.see(name, place_m=place, on_ground=False, armed=True)

    def to_control(self) -> None:
        if self.state is PlanState.ARMING:
            self.done(OrderKind.MODE)
            self.done(OrderKind.ARM)
            for name in NAMES:
                self.see(name, armed=True, takeoff="reached")
            self.at(self.execution.step.starts())
            self.tick()
        self.done(OrderKind.ENGAGE)
        self.settle()

    def settle(self) -> None:
        self.tick()
        self.tick(SETTLED_S + 0.1)

    def to_flying(self) -> None:
        self.to_control()
        self.end_of_step()

    def end_of_step(self) -> None:
        self.clock, self.s = ClockState.FINISHED, self.execution.step.duration_s
        self.at(self.execution.step.places())
        self.settle()

    def kinds(self) -> list[OrderKind]:
        return [order.kind for order in self.orders]


@pytest.fixture
def told() -> Told:
    return Told()


def test_the_whole_way_from_the_ground_to_the_goals(told: Told) -> None:
    assert told.state is PlanState.ARMING and told.orders == [Order(OrderKind.MODE, NAMES)]
    told.done(OrderKind.MODE, "alpha")
    assert told.execution.waits_for == ("bravo",), "nobody arms before all are in the mode of their take-off"
    assert told.done(OrderKind.MODE, "bravo") == [Order(OrderKind.ARM, NAMES)]
    told.done(OrderKind.ARM, "alpha")
    assert told.state is PlanState.ARMING and told.execution.waits_for == ("bravo",)
    told.done(OrderKind.ARM, "bravo")
    assert told.state is PlanState.TAKEOFF and told.orders[-1] == Order(OrderKind.TAKEOFF, NAMES)
    told.see("alpha", takeoff="reached", armed=True)
    told.see("bravo", takeoff="climbs", armed=True)
    told.tick()
    assert told.state is PlanState.TAKEOFF and told.execution.waits_for == ("bravo",)
    told.see("bravo", takeoff="reached")
    told.at(told.execution.step.starts())
    told.tick()
    assert told.state is PlanState.ENGAGING
    told.done(OrderKind.ENGAGE)
    told.tick()
    assert told.state is PlanState.ENGAGING, "it waits until they have settled"
    told.tick(SETTLED_S + 0.1)
    assert told.state is PlanState.TO_STARTS and told.orders[-1].kind is OrderKind.FLY
    told.end_of_step()
    assert told.state is PlanState.FLYING and told.execution.index == 1
    told.end_of_step()
    assert told.state is PlanState.FINISHED and told.orders[-1] == Order(OrderKind.HOLD, NAMES)
    states = [change.state for change in told.execution.changes]
    assert states == [
        *(PlanState.ARMING, PlanState.TAKEOFF, PlanState.ENGAGING, PlanState.TO_STARTS, PlanState.FLYING),
        PlanState.FINISHED,
    ], "each state is reported once"


def test_one_that_does_not_arm_keeps_all_on_the_ground_and_who_armed_is_disarmed(told: Told) -> None:
    told.done(OrderKind.ARM, "alpha")
    told.see("alpha", armed=True)
    orders = told.done(OrderKind.ARM, "bravo", ok=False, text="denied")
    assert told.state is PlanState.ABORTED and orders == [Order(OrderKind.DISARM, ("alpha",))]
    assert "bravo does not arm: denied" in told.execution.reason
    assert OrderKind.TAKEOFF not in told.kinds()


def test_one_that_does_not_change_its_mode_keeps_all_on_the_ground_and_nobody_arms(told: Told) -> None:
    told.done(OrderKind.MODE, "alpha")
    assert told.done(OrderKind.MODE, "bravo", ok=False, text="denied") == []
    assert told.state is PlanState.ABORTED and "bravo does not change its mode: denied" in told.execution.reason
    assert told.done(OrderKind.MODE, "bravo") == [], "it comes too late"
    assert OrderKind.ARM not in told.kinds()


def test_on_a_slow_link_each_takes_off_as_soon_as_it_is_armed() -> None:
    told = Told(together=False)
    told.done(OrderKind.MODE)
    assert told.done(OrderKind.ARM, "alpha") == [Order(OrderKind.TAKEOFF, ("alpha",))]
    assert told.state is PlanState.TAKEOFF and told.execution.waits_for == NAMES
    told.see("alpha", armed=True, on_ground=False, takeoff="reached")
    told.tick()
    assert told.state is PlanState.TAKEOFF and told.execution.waits_for == ("bravo",)
    assert told.done(OrderKind.ARM, "bravo") == [Order(OrderKind.TAKEOFF, ("bravo",))]
    told.see("bravo", armed=True, takeoff="reached")
    told.at(told.execution.step.starts())
    told.tick()
    assert told.state is PlanState.ENGAGING
    states = [change.state for change in told.execution.changes]
    assert states == [PlanState.ARMING, PlanState.TAKEOFF, PlanState.ENGAGING], "each state is reported once"


def test_on_a_slow_link_one_that_does_not_arm_stops_the_rest_and_who_stands_is_disarmed() -> None:
    told = Told(together=False)
    told.done(OrderKind.MODE)
    told.done(OrderKind.ARM, "alpha")
    told.see("alpha", armed=True)
    orders = told.done(OrderKind.ARM, "bravo", ok=False, text="denied")
    assert told.state is PlanState.STOPPED and orders == [Order(OrderKind.DISARM, ("alpha",))]
    assert "bravo does not arm: denied" in told.execution.reason
    first = Told(together=False)
    first.done(OrderKind.MODE)
    assert first.done(OrderKind.ARM, "bravo", ok=False) == [] and first.state is PlanState.ABORTED
    late = Told(together=False)
    late.done(OrderKind.MODE)
    late.done(OrderKind.ARM, "alpha")
    late.see("alpha", armed=True, on_ground=False, takeoff="climbs")
    late.tick()
    held = late.take(late.execution.abort())
    assert held == [Order(OrderKind.HOLD, ("alpha",))], "bravo stands, and was not armed"
    assert late.done(OrderKind.ARM, "bravo") == [Order(OrderKind.DISARM, ("bravo",))], "it comes too late"


def test_an_arming_that_comes_after_the_abort_is_undone(told: Told) -> None:
    told.take(told.execution.abort())
    assert told.state is PlanState.ABORTED
    assert told.done(OrderKind.ARM, "alpha") == [Order(OrderKind.DISARM, ("alpha",))]
    assert told.done(OrderKind.DISARM, "alpha", ok=False) == [Order(OrderKind.HOLD, ("alpha",))]


def test_one_that_took_off_by_its_pilot_after_the_abort_is_left_to_him(told: Told) -> None:
    told.take(told.execution.abort())
    assert told.done(OrderKind.ARM, "alpha") == [Order(OrderKind.DISARM, ("alpha",))]
    refused = told.execution.outcome(OrderKind.DISARM, "alpha", False, "not landed", unexpected_mode="POSCTL")
    assert refused == []
    said = [change.text for change in told.execution.changes if change.vehicle == "alpha"]
    assert said[-2:] == [
        "alpha could not be disarmed: not landed",
        "alpha is in POSCTL, which this plan did not set: it is not ordered to hold",
    ]


def test_an_abort_holds_those_that_climb_but_not_one_that_its_pilot_has(told: Told) -> None:
    told.done(OrderKind.ARM)
    for name in NAMES:
        told.see(name, armed=True, on_ground=False, takeoff="climbs")
    told.see("bravo", unexpected_mode="STABILIZE")
    told.tick()
    assert told.take(told.execution.abort()) == [Order(OrderKind.HOLD, ("alpha",))]
    told.done(OrderKind.HOLD, "alpha")
    assert told.state is PlanState.ABORTED
    told = Told()
    told.done(OrderKind.ARM)
    for name in NAMES:
        told.see(name, armed=True, on_ground=False, takeoff="climbs", unexpected_mode="POSCTL")
    told.tick()
    assert told.take(told.execution.abort()) == [] and told.state is PlanState.ABORTED


def test_an_abort_before_control_leaves_those_that_it_has_not_taken() -> None:
    told = Told(())
    assert told.state is PlanState.ENGAGING
    told.see("alpha", unexpected_mode="LOITER")
    told.tick()
    told.take(told.execution.abort())
    assert told.orders[-1] == Order(OrderKind.HOLD, ("bravo",))


def test_one_that_does_not_take_off_disarms_who_stands_and_nothing_goes_on(told: Told) -> None:
    told.done(OrderKind.ARM)
    for name in NAMES:
        told.see(name, armed=True)
    told.see("bravo", on_ground=False, takeoff="climbs", place_m=(6.0, 0.0, 3.0))
    told.tick()
    orders = told.done(OrderKind.TAKEOFF, "alpha", ok=False)
    assert told.state is PlanState.STOPPED and orders == [Order(OrderKind.DISARM, ("alpha",))]
    told.see("bravo", takeoff="reached")
    for _ in range(20):
        assert told.tick() == []
    with pytest.raises(RefusedError, match="before it flew"):
        told.execution.go_on()
    assert told.take(told.execution.abort())[-1] == Order(OrderKind.HOLD, ("bravo",))


def test_a_vehicle_off_its_reference_for_long_or_far_stops_all_and_its_pairs_are_named() -> None:
    for off_m, after_s in ((1.5, LATE_S + 0.1), (2.1, 0.2)):
        told = Told()
        told.to_flying()
        x, y, z = told.execution.step.trajectories["bravo"].at(told.s).pos_enu_m
        told.see("bravo", place_m=(x - off_m, y, z))
        told.tick()
        if after_s > 0.2:
            assert told.state is PlanState.FLYING, "a gust"
            told.tick(after_s)
        assert told.state is PlanState.STOPPED and told.orders[-1].kind is OrderKind.STOP_CLOCK
        assert told.execution.pairs[0].vehicles == ("bravo", "alpha") and "alpha" in told.execution.reason
        assert told.execution.changes[-1].vehicle == "bravo"


def test_on_a_straight_way_it_may_be_anywhere_but_beside_it(told: Told) -> None:
    told.to_control()
    assert told.state is PlanState.TO_STARTS and not told.execution.step.timed
    told.see("alpha", place_m=told.execution.step.places()["alpha"])
    told.tick()
    told.tick(LATE_S * 3)
    assert told.state is PlanState.TO_STARTS, "early is as good as late"
    told.see("alpha", place_m=(0.5, -1.0, 10.0))
    told.tick()
    told.tick(LATE_S + 0.1)
    assert told.state is PlanState.STOPPED and "from its way" in told.execution.reason


@each(
    ("change", "text"),
    [
        ({"age_s": POSITION_SILENT_S + 0.1}, "silent"),
        ({"place_m": None}, "silent"),
        ({"left": Departure(DepartureCause.PILOT, "its mode became POSCTL")}, "POSCTL"),
        ({"left": Departure(DepartureCause.GUARD, "the guard holds it")}, "guard"),
    ],
)
def test_each_trouble_stops_the_clock_of_all_at_once(change: dict[str, Any], text: str) -> None:
    told = Told()
    told.to_flying()
    told.see("alpha", **change)
    assert told.tick() == [Order(OrderKind.STOP_CLOCK)]
    assert told.state is PlanState.STOPPED and text in told.execution.reason
    count = len(told.execution.changes)
    for _ in range(10):
        assert told.tick() == []
    assert len(told.execution.changes) == count, "reported once"


def test_a_barrier_that_one_does_not_reach_stops_and_opens_for_nobody(told: Told) -> None:
    told.to_control()
    told.clock = ClockState.FINISHED
    told.at(told.execution.step.places())
    told.see("bravo", place_m=(6.0, -0.5, 10.0))
    for _ in range(int(BARRIER_S / 0.2) + 5):
        told.tick()
    assert told.state is PlanState.STOPPED and "bravo did not come to its place" in told.execution.reason
    assert told.kinds().count(OrderKind.FLY) == 1


def test_a_barrier_waits_for_those_that_pass_by(told: Told) -> None:
    told.to_control()
    told.clock = ClockState.FINISHED
    told.at(told.execution.step.places())
    told.see("bravo", speed_mps=2.0)
    told.settle()
    assert told.state is PlanState.TO_STARTS and told.execution.waits_for == ("bravo",)


def test_pause_and_resume_by_order_and_a_vehicle_that_leaves_meanwhile(told: Told) -> None:
    told.to_flying()
    assert told.take(told.execution.pause()) == [Order(OrderKind.STOP_CLOCK)]
    assert told.take(told.execution.go_on()) == [Order(OrderKind.GO_ON)] and told.state is PlanState.FLYING
    told.take(told.execution.pause())
    told.see("alpha", left=Departure(DepartureCause.ORDER, "land was ordered"))
    told.tick()
    assert told.state is PlanState.STOPPED
    with pytest.raises(RefusedError, match="alpha left"):
        told.execution.go_on()


def test_abort_stops_then_holds_those_that_still_follow(told: Told) -> None:
    told.to_flying()
    assert told.take(told.execution.abort()) == [Order(OrderKind.END_CLOCK)]
    told.clock = ClockState.ABORTING
    assert told.tick() == [] and told.state is PlanState.ABORTING
    told.clock = ClockState.ABORTED
    assert told.tick() == [Order(OrderKind.HOLD, NAMES)]
    told.done(OrderKind.HOLD, "alpha")
    told.done(OrderKind.HOLD, "bravo", ok=False)
    assert told.state is PlanState.ABORTED
    with pytest.raises(RefusedError):
        told.execution.abort()


def test_landing_is_certified_first_and_goes_by_rounds(told: Told) -> None:
    told.to_flying()
    assert told.take(told.execution.land()) == [Order(OrderKind.STOP_CLOCK)]
    assert told.tick() == [Order(OrderKind.CERTIFY_LANDING)] and told.tick() == []
    told.take(told.execution.landing([["bravo"], ["alpha"]]))
    assert told.orders[-1] == Order(OrderKind.LAND, ("bravo",))
    told.tick()
    told.see("bravo", on_ground=True, armed=False)
    assert told.tick() == [Order(OrderKind.LAND, ("alpha",))]
    told.see("alpha", on_ground=True, armed=False)
    told.tick()
    assert told.state is PlanState.LANDED


def test_a_landing_that_is_refused_leaves_them_where_they_are(told: Told) -> None:
    told.to_flying()
    told.take(told.execution.land())
    told.tick()
    told.take(told.execution.landing_refused(["alpha and bravo come within 1 m"]))
    assert told.state is PlanState.STOPPED and "alpha and bravo" in told.execution.reason
    assert OrderKind.LAND not in told.kinds()
    assert told.take(told.execution.go_on()) == [Order(OrderKind.GO_ON)]


# --- whatever happens -------------------------------------------------------------------------------------------------

PLACES = st.sampled_from(["start", "goal", "ground", "away", "none"])
WHATS = st.one_of(
    st.tuples(st.just("tick"), st.sampled_from([0.05, 0.2, 1.0, 4.0, 40.0])),
    st.tuples(st.just("outcome"), st.sampled_from(list(OrderKind)), st.sampled_from(NAMES), st.booleans()),
    st.tuples(st.just("place"), st.sampled_from(NAMES), PLACES),
    st.tuples(st.just("age"), st.sampled_from(NAMES), st.sampled_from([0.1, 10.0])),
    st.tuples(st.just("left"), st.sampled_from(NAMES), st.sampled_from([None, *DepartureCause])),
    st.tuples(st.just("takeoff"), st.sampled_from(NAMES), st.sampled_from([None, "climbs", "reached", "mode"])),
    st.tuples(st.just("armed"), st.sampled_from(NAMES), st.booleans()),
    st.tuples(st.just("unexpected_mode"), st.sampled_from(NAMES), st.sampled_from([None, "POSCTL"])),
    st.tuples(st.just("clock"), st.sampled_from([None, *ClockState])),
    st.tuples(st.just("order"), st.sampled_from(["pause", "go_on", "abort", "land", "landing", "refused", "start"])),
)


class Judged(Told):
    """Checks each order against what came before it."""

    def __init__(self, grounded: tuple[str, ...], together: bool) -> None:
        self.grounded = grounded
        self.together = together
        self.confirmed: dict[OrderKind, set[str]] = {kind: set() for kind in OrderKind}
        self.aborted = False
        self.asked = True
        self.late = False
        super().__init__(grounded, together=together)
        self.shown = dict(self.sights)

    def tick(self, by_s: float = 0.2) -> list[Order]:
        self.shown = dict(self.sights)
        return super().tick(by_s)

    def take(self, orders: list[Order]) -> list[Order]:
        for order in orders:
            if order.kind in MOVING and order.kind is not OrderKind.LAND:
                assert not self.aborted, order
            match order.kind:
                case OrderKind.ARM:
                    assert self.confirmed[OrderKind.MODE] >= set(self.grounded)
                case OrderKind.TAKEOFF:
                    needed = self.grounded if self.together else order.vehicles
                    assert self.confirmed[OrderKind.ARM] >= set(needed)
                case OrderKind.FLY:
                    assert self.confirmed[OrderKind.ENGAGE] >= set(NAMES)
                    places = self.execution.step.starts()
                    for name in NAMES:
                        place = self.sights[name].place_m
                        assert place is not None and self.sights[name].age_s <= POSITION_SILENT_S
                        assert all(abs(a - b) <= 0.4 for a, b in zip(place, places[name], strict=True))
                case OrderKind.DISARM:
                    # not forced: one that flies since the last tick, or since its arming was late, refuses it
                    for name in order.vehicles:
                        on_ground = self.shown[name].on_ground or self.late
                        assert on_ground or name not in self.execution.grounded or self.aborted
                case OrderKind.GO_ON:
                    assert self.asked
                case OrderKind.HOLD:
                    # never one that its pilot had as of the last look
                    assert not any(self.shown[name].unexpected_mode for name in order.vehicles), order
        return super().take(orders)

    def do(self, what: tuple[Any, ...]) -> None:
        execution = self.execution
        match what:
            case ("tick", by_s):
                before = self.state
                orders = self.tick(by_s)
                if before in (PlanState.PAUSED, PlanState.STOPPED, PlanState.FINISHED, PlanState.ABORTED):
                    assert not {order.kind for order in orders} & MOVING, (before, orders)
            case ("outcome", OrderKind.ARM, name, _) if name in self.confirmed[OrderKind.ARM]:
                pass  # it has come already
            case ("outcome", kind, name, ok):
                if ok:
                    self.confirmed[kind].add(name)
                self.late = kind is OrderKind.ARM and self.state is not PlanState.ARMING
                self.shown[name] = self.sights[name]
                self.take(execution.outcome(kind, name, ok, "so", self.sights[name].unexpected_mode))
                self.late = False
            case ("place", name, where):
                places = {
                    "start": execution.step.starts()[name],
                    "goal": execution.step.places()[name],
                    "ground": GROUND[name],
                    "away": (50.0, 50.0, 30.0),
                    "none": None,
                }
                self.see(name, place_m=places[where], on_ground=where == "ground")
            case ("age" | "takeoff" | "armed" | "unexpected_mode", name, value):
                self.see(name, **{"age": {"age_s": value}}.get(what[0], {what[0]: value}))
            case ("left", name, why):
                self.see(name, left=None if why is None else Departure(why, "so"))
            case ("clock", clock):
                self.clock = clock
            case ("order", order):
                self._order(order)

    def _order(self, order: str) -> None:
        execution = self.execution
        asked: dict[str, Callable[[], list[Order]]] = {
            "pause": execution.pause,
            "go_on": execution.go_on,
            "abort": execution.abort,
            "land": execution.land,
            "landing": lambda: execution.landing([["alpha"], ["bravo"]]),
            "refused": lambda: execution.landing_refused(["no"]),
            "start": lambda: execution.start_failed("no"),
        }
        try:
            orders = asked[order]()
        except RefusedError:
            return
        self.aborted = self.aborted or order == "abort"
        self.take(orders)


@settings(max_examples=examples(400), deadline=None)
@given(st.sampled_from([NAMES, ("alpha",), ()]), st.booleans(), st.booleans(), st.lists(WHATS, max_size=60))
def test_whatever_comes_in_whatever_order(
    grounded: tuple[str, ...], together: bool, flying: bool, whats: list[tuple[Any, ...]]
) -> None:
    judged = Judged(grounded, together)
    if flying and grounded != ("alpha",):
        judged.confirmed = {kind: set(NAMES) for kind in OrderKind}
        judged.to_flying()
        assert judged.state is PlanState.FLYING
    for what in whats:
        judged.do(what)
    # trouble stops, always
    if judged.state in (PlanState.TO_STARTS, PlanState.FLYING):
        judged.see("alpha", left=Departure(DepartureCause.LOST, "gone"))
        assert judged.tick() == [Order(OrderKind.STOP_CLOCK)]
        assert judged.state is PlanState.STOPPED
    # and so does an abort
    if not judged.execution.over and judged.state is not PlanState.ABORTING:
        judged._order("abort")
        judged.clock = None
        for _ in range(3):
            judged.tick()
            judged.done(OrderKind.HOLD)
        assert judged.state is PlanState.ABORTED


def test_a_step_of_one_vehicle_that_stands_has_no_pairs() -> None:
    step = replace(steps()[0], trajectories={"alpha": steps()[0].trajectories["alpha"]})
    execution = Execution([step], (), tubes(("alpha",)), step.starts())
    assert pairs_near("alpha", {"alpha": Measurement((0.0, 0.0, 10.0))}, execution.tubes) == ()


# --- a vehicle that is gone -------------------------------------------------------------------------------------------

GONE = Departure(DepartureCause.LOST, "it was forgotten")


def test_one_that_is_gone_while_they_arm_keeps_all_on_the_ground(told: Told) -> None:
    told.done(OrderKind.ARM, "alpha")
    told.see("alpha", armed=True)
    told.see("bravo", left=GONE, forgotten=True)
    assert told.tick() == [Order(OrderKind.DISARM, ("alpha",))]
    assert told.state is PlanState.ABORTED and "bravo left: it was forgotten" in told.execution.reason


def test_one_that_is_gone_while_they_take_off_stops_and_who_stands_is_disarmed(told: Told) -> None:
    told.done(OrderKind.ARM)
    told.see("alpha", armed=True, on_ground=False, takeoff="climbs")
    told.see("bravo", armed=True, left=GONE, forgotten=True)
    assert told.tick() == [Order(OrderKind.DISARM, ("bravo",))]
    assert told.state is PlanState.STOPPED and "bravo" in told.execution.left


def test_one_that_is_gone_before_it_was_taken_under_control_is_not_waited_for() -> None:
    told = Told(grounded=())
    told.done(OrderKind.ENGAGE, "alpha")
    told.see("bravo", left=GONE, forgotten=True)
    told.tick()
    assert told.state is PlanState.STOPPED and "bravo left" in told.execution.reason


def test_an_abort_does_not_wait_for_the_hold_of_one_that_is_forgotten(told: Told) -> None:
    told.to_flying()
    told.take(told.execution.abort())
    told.see("bravo", forgotten=True)
    told.tick()
    told.done(OrderKind.HOLD, "alpha")
    told.tick()
    assert told.state is PlanState.ABORTED
    assert any("bravo was ordered to hold, but: it was forgotten" in change.text for change in told.execution.changes)


@each("last", [False, True])
def test_a_landing_goes_on_below_nobody_that_is_forgotten(last: bool) -> None:
    told = Told()
    told.to_flying()
    told.take(told.execution.land())
    told.tick()
    told.take(told.execution.landing([["alpha"], ["bravo"]]))
    if last:
        told.see("alpha", on_ground=True)
        told.tick()
    told.see("bravo" if last else "alpha", forgotten=True)
    orders = told.tick()
    assert not orders
    assert told.state is (PlanState.LANDED if last else PlanState.STOPPED), told.execution.reason
    if not last:
        assert "alpha was forgotten" in told.execution.reason
        assert told.take(told.execution.land()) == [] and told.tick() == [Order(OrderKind.CERTIFY_LANDING)]


def test_a_pair_that_keeps_its_margin_is_the_nearest_and_not_too_near() -> None:
    """Of two vehicles 8.5 m apart under a margin of 3.3 m it said "near each other"."""
    apart, near = Pair(("a", "b"), 8.5, 3.3), Pair(("a", "c"), 3.2, 3.3)
    assert pairs_text(()) == ""
    assert pairs_text((apart,)) == "; the nearest to each other: a and b (8.5 m, margin 3.3 m)"
    assert pairs_text((near, apart)) == "; too near each other: a and c (3.2 m, margin 3.3 m)"
