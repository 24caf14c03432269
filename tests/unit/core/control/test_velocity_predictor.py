"""Velocity control with prediction, flown against a vehicle that is not the model."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control import velocity_predictor
from skygcs.core.control.cascade import ZERO, Estimate, Reference, Vector
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.velocity_predictor import (
    ARDUCOPTER_LOOP,
    DELAY_SLEW,
    DISTURBANCE_MAX_MPS2,
    MAX_COMMANDS,
    PX4_LOOP,
    PredictorMemory,
    Timing,
    predicted_setpoint,
)
from support.examples import thinned
from support.table import each

LAW = ControlConfig()
GRID_S = 0.005
HOLD_S = 0.1


@dataclass
class Vehicle:
    """A velocity loop with P, I and D and an attitude behind it, in a wind: one axis, in Euler steps of 5 ms."""

    push_mps2: float = 0.0
    p: float = 1.8
    i: float = 0.4
    d: float = 0.2
    attitude_lag_s: float = 0.15
    x: float = 0.0
    v: float = 0.0
    lean_mps2: float = 0.0
    accel_mps2: float = 0.0
    integral: float = 0.0

    def step(self, vel: float, acc: float) -> None:
        error = vel - self.v
        wanted = acc + self.p * error + self.integral - self.d * self.accel_mps2
        self.integral += self.i * error * GRID_S
        self.lean_mps2 += (wanted - self.lean_mps2) * GRID_S / self.attitude_lag_s
        self.accel_mps2 = self.lean_mps2 + self.push_mps2
        self.x += self.v * GRID_S
        self.v += self.accel_mps2 * GRID_S


@dataclass
class Flight:
    """The predictor, the vehicle, and a link of ``delay_s`` there and back, which is taken for ``measured_s``."""

    delay_s: float
    measured_s: float | None = None
    vehicle: Vehicle = field(default_factory=Vehicle)
    state_every_s: float = 0.1
    predicts: bool = True
    memory: PredictorMemory = field(default_factory=PredictorMemory)
    lost: range = range(0)
    """Of the states, by number."""

    def fly(self, reference: Any, seconds: float) -> list[float]:
        """Its error against the reference, at each step of the grid."""
        one_way_s = self.delay_s / 2
        up: deque[tuple[float, Vector, Vector]] = deque()
        down: deque[tuple[float, Estimate]] = deque()
        acting: tuple[Vector, Vector] = (ZERO, ZERO)
        newest, came_at, errors = Estimate(ZERO, ZERO), 0.0, []
        for n in range(round(seconds / GRID_S)):
            now = n * GRID_S
            while up and up[0][0] <= now + 1e-9:
                _, *both = up.popleft()
                acting = (both[0], both[1])
            self.vehicle.step(acting[0][0], acting[1][0])
            if n % round(self.state_every_s / GRID_S) == 3 and n // round(self.state_every_s / GRID_S) not in self.lost:
                state = Estimate((self.vehicle.x, 0.0, 0.0), (self.vehicle.v, 0.0, 0.0))
                down.append((now + one_way_s, state))
            while down and down[0][0] <= now + 1e-9:
                came_at, newest = down.popleft()
            if n % round(HOLD_S / GRID_S) == 0:
                sent = self._tick(newest, reference(now), now, now - came_at)
                up.append((now + one_way_s, *sent))
            errors.append(self.vehicle.x - reference(now).pos_enu_m[0])
        return errors

    def _tick(self, state: Estimate, reference: Reference, now: float, age_s: float) -> tuple[Vector, Vector]:
        round_trip_s = self.delay_s if self.measured_s is None else self.measured_s
        if not self.predicts:
            self.memory = PredictorMemory()
        timing = Timing(now, age_s, round_trip_s, HOLD_S)
        found, self.memory = predicted_setpoint(LAW, PX4_LOOP, self.memory, state, reference, timing)
        assert found is not None
        return found.vel_enu_mps, found.acc_enu_mps2


def swinging(t: float) -> Reference:
    """One axis of the circle of 5 m at 2 m/s."""
    w, r = 0.4, 5.0
    position = (r - r * math.cos(w * t), 0.0, 0.0)
    return Reference(position, 0.0, (r * w * math.sin(w * t), 0.0, 0.0), (r * w * w * math.cos(w * t), 0.0, 0.0))


def rms(errors: list[float], after_s: float = 15.0) -> float:
    judged = errors[round(after_s / GRID_S) :]
    return math.sqrt(sum(e * e for e in judged) / len(judged))


def there(_: float) -> Reference:
    return Reference((3.0, 0.0, 0.0))


def timing(now: float, age_s: float = 0.05, round_trip_s: float = 0.8) -> Timing:
    return Timing(now, age_s, round_trip_s, HOLD_S)


@each("delay_s", thinned([0.05, 0.2, 0.4, 0.8], 2, turn=1))
def test_a_moving_reference_is_followed_as_well_over_any_delay(delay_s: float) -> None:
    assert rms(Flight(delay_s).fly(swinging, 60.0)) < 0.15


@each("wrong", [0.7, 1.3])
def test_a_delay_that_is_wrong_by_30_percent_leaves_it_stable(wrong: float) -> None:
    errors = Flight(0.8 * wrong, measured_s=0.8).fly(there, 80.0)
    assert max(map(abs, errors[-2000:])) < 0.02


def test_without_what_is_under_way_the_same_law_swings() -> None:
    """The memory is what damps it: of a step of 3 m it overshoots less than without."""
    predicted, plain = (max(Flight(0.8, predicts=predicts).fly(there, 40.0)) for predicts in (True, False))
    assert predicted < 0.75 * plain


def test_a_steady_push_is_found_and_predicted() -> None:
    flight = Flight(0.4, vehicle=Vehicle(push_mps2=0.5, p=1.5, i=0.0, d=0.0))
    flight.fly(lambda _: Reference(), 20.0)
    assert flight.memory.disturbance_enu_mps2[0] == pytest.approx(0.5, abs=0.05)


def test_with_the_observer_gusts_disturb_less(monkeypatch: pytest.MonkeyPatch) -> None:
    class Gusty(Vehicle):
        n = 0

        def step(self, vel: float, acc: float) -> None:
            self.n += 1
            self.push_mps2 = 0.8 * math.sin(0.9 * self.n * GRID_S)
            super().step(vel, acc)

    observed = rms(Flight(0.2, vehicle=Gusty()).fly(swinging, 60.0))
    monkeypatch.setattr(velocity_predictor, "DISTURBANCE_MAX_MPS2", 0.0)
    assert observed < 0.75 * rms(Flight(0.2, vehicle=Gusty()).fly(swinging, 60.0))


def test_lost_states_are_bridged_by_the_model() -> None:
    """Four in a row, in the middle of a swing: 0.5 s of age."""
    whole, gappy = Flight(0.4), Flight(0.4, lost=range(200, 204))
    assert rms(gappy.fly(swinging, 40.0)) < 1.2 * rms(whole.fly(swinging, 40.0))
    assert len(gappy.memory.sent) > 20, "it did not begin anew"


def test_a_gap_longer_than_a_second_begins_anew() -> None:
    memory = PredictorMemory()
    for n in range(20):
        _, memory = predicted_setpoint(LAW, PX4_LOOP, memory, Estimate(ZERO, ZERO), there(0.0), timing(n * 0.1))
    assert len(memory.sent) == 20
    _, after = predicted_setpoint(LAW, PX4_LOOP, memory, Estimate(ZERO, ZERO), there(0.0), timing(3.1))
    _, backwards = predicted_setpoint(LAW, PX4_LOOP, memory, Estimate(ZERO, ZERO), there(0.0), timing(1.0))
    assert [len(m.sent) for m in (after, backwards)] == [1, 1]
    assert after.disturbance_enu_mps2 == ZERO


def test_the_first_step_makes_no_jump() -> None:
    """It flies past at 2 m/s, and the reference goes along with it: that is what is sent, whatever the delay."""
    state = Estimate((0.0, 0.0, 10.0), (2.0, 0.0, 0.0))
    moving = Reference(
        (0.0 + 2.0 * 0.45, 0.0, 10.0), 0.0, (2.0, 0.0, 0.0)
    )  # where it is by now: 0.4 s down, 0.05 s old
    found, _ = predicted_setpoint(LAW, PX4_LOOP, PredictorMemory(), state, moving, timing(0.0))
    assert found is not None
    assert found.vel_enu_mps == pytest.approx((2.0, 0.0, 0.0), abs=0.11), "half a period's lead of the reference"
    resting = Estimate((0.0, 0.0, 10.0), ZERO)
    found, _ = predicted_setpoint(LAW, PX4_LOOP, PredictorMemory(), resting, Reference((0.0, 0.0, 10.0)), timing(0.0))
    assert found is not None and found.vel_enu_mps == ZERO


def test_a_jump_of_the_delay_is_followed_slowly() -> None:
    memory, state = PredictorMemory(), Estimate(ZERO, (2.0, 0.0, 0.0))
    moving = Reference(ZERO, 0.0, (2.0, 0.0, 0.0))
    before = None
    for n in range(40):
        jumped = timing(n * 0.1, round_trip_s=0.1 if n < 10 else 0.6)
        found, memory = predicted_setpoint(LAW, PX4_LOOP, memory, state, moving, jumped)
        assert found is not None
        if before is not None:
            assert abs(found.round_trip_s - before) <= DELAY_SLEW * 0.1 + 1e-9
        before = found.round_trip_s
    assert before == pytest.approx(0.6)


def test_at_the_limit_of_the_acceleration_no_wind_is_seen() -> None:
    """An ArduCopter that is sent 40 m away speeds up by 2.5 m/s²: so does the model, and the observer keeps still."""
    memory, x, v = PredictorMemory(), 0.0, 0.0
    for n in range(20):
        state = Estimate((x, 0.0, 0.0), (v, 0.0, 0.0))
        far = Reference((40.0, 0.0, 0.0))
        found, memory = predicted_setpoint(LAW, ARDUCOPTER_LOOP, memory, state, far, timing(n * 0.1, 0.0, 0.0))
        assert found is not None and found.vel_enu_mps[0] <= LAW.vel_xy_max_mps
        assert memory.disturbance_enu_mps2 == ZERO
        x, v = x + v * 0.1 + 0.0125, v + 0.25


def test_an_axis_without_position_follows_its_velocity() -> None:
    climbing = Reference((0.0, 0.0, 99.0), 0.0, (0.0, 0.0, 0.7), velocity_only_z=True)
    found, _ = predicted_setpoint(LAW, PX4_LOOP, PredictorMemory(), Estimate(ZERO, ZERO), climbing, timing(0.0))
    assert found is not None and found.vel_enu_mps == (0.0, 0.0, 0.7)


numbers = st.one_of(st.floats(-1e7, 1e7), st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e300]))
vectors = st.tuples(numbers, numbers, numbers)


@given(st.lists(st.tuples(vectors, vectors, vectors, numbers, numbers, numbers), max_size=12))
def test_whatever_comes_in_what_goes_out_is_finite_and_bounded(steps: list[tuple[Any, ...]]) -> None:
    memory, now = PredictorMemory(), 0.0
    for position, velocity, place, by_s, age_s, round_trip_s in steps:
        now = now + by_s if abs(by_s) < 10 else now + 0.05
        before = memory
        found, memory = predicted_setpoint(
            LAW, PX4_LOOP, memory, Estimate(position, velocity), Reference(place), timing(now, age_s, round_trip_s)
        )
        assert len(memory.sent) <= MAX_COMMANDS
        if found is None:
            assert memory is before
            continue
        assert all(abs(v) <= LAW.vel_xy_max_mps for v in found.vel_enu_mps)
        assert all(abs(d) <= DISTURBANCE_MAX_MPS2 for d in found.disturbance_enu_mps2)


def test_the_memory_stays_bounded() -> None:
    memory = PredictorMemory()
    for n in range(500):
        _, memory = predicted_setpoint(LAW, PX4_LOOP, memory, Estimate(ZERO, ZERO), there(0.0), timing(n * 0.02))
    assert len(memory.sent) == MAX_COMMANDS
