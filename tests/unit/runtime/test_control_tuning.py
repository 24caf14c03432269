"""The gains in use and the delay that they bear, without a loop, a link or a vehicle's answers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mav

from skygcs.config.control import ControlSettings
from skygcs.core.control.analysis import bearable_delay_s
from skygcs.core.control.guard import ControlMode
from skygcs.core.radio_link.capacity import FRAME_BYTES
from skygcs.core.vehicle.decoding import Decoder
from skygcs.core.vehicle.offboard_controller import OffboardController
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import RefusedError
from skygcs.runtime.control_tuning import SHORTEST_DELAY_S, ControlTuning, law_json, offboard_config
from support.table import each
from support.vehicles import PX4, PX4_LOITER, Voice, flight_dialect

ATTITUDE, VELOCITY, RAW = ControlMode.ATTITUDE, ControlMode.VELOCITY, ControlMode.RAW
SLOWER = {"vel_p": 0.1, "pos_p_per_s": 0.5, "vel_i": 0.005}
"""Gains of the vertical axis, which bear 0.1 s at a hover thrust of 0.3."""


class Tuned:
    """A PX4, its controller and the tuning; ``reported``: the vehicle's own hover thrust."""

    def __init__(self, reported: float | None = None, **settings: Any) -> None:
        self.voice = Voice(1)
        self.vehicle = Vehicle(1, 1, flight_dialect(), name="alpha", decoder=Decoder(flight_dialect()))
        self.vehicle.on_frame(self.voice.beat(PX4, PX4_LOITER, armed=True, status=4), 100.0)
        known = ControlSettings(**settings)
        self.controller = OffboardController(self.vehicle, offboard_config(known, None))
        self.tuning = ControlTuning(self.controller, self.vehicle, known)
        if reported is not None:
            self.report(reported)

    def report(self, hover_thrust: float) -> None:
        told = mav.MAVLink_param_value_message(b"MPC_THR_HOVER", hover_thrust, 9, 1, 0)
        self.vehicle.on_frame(self.voice.say(told), 100.0)

    @property
    def hover_thrust(self) -> float:
        return self.controller.config.law.hover_thrust

    @property
    def limit_s(self) -> float:
        """The delay up to which attitude is flown."""
        return self.controller.config.guard.attitude_delay_s


@pytest.mark.parametrize(
    ("reported", "settings", "wanted"), [(0.38, {}, 0.38), (None, {}, 0.45), (0.38, {"hover_thrust": 0.5}, 0.5)]
)
def test_the_hover_thrust_is_the_files_else_the_vehicles_else_the_seeds(
    reported: float | None, settings: dict[str, float], wanted: float
) -> None:
    t = Tuned(reported, **settings)
    assert t.hover_thrust == settings.get("hover_thrust", 0.45)
    t.tuning.begin()
    assert t.hover_thrust == pytest.approx(wanted)


def test_in_flight_only_the_hover_thrust_is_renewed() -> None:
    t = Tuned()
    t.tuning.begin()
    assert t.tuning.change({"xy": {"vel_p": 0.07}}, force=False) is None
    before = t.controller.config.law
    t.report(0.38)
    t.tuning.renew_hover_thrust()
    assert t.hover_thrust == pytest.approx(0.38)
    assert replace(t.controller.config.law, hover_thrust=before.hover_thrust) == before


@each("method", ["begin", "renew_hover_thrust"])
def test_a_hover_thrust_that_cannot_be_flown_is_refused(method: str) -> None:
    t = Tuned(0.95)
    with pytest.raises(RefusedError, match=r"its hover thrust is 0.95, and .* give hover_thrust in the fleet file"):
        getattr(t.tuning, method)()
    assert t.hover_thrust == 0.45


def test_what_was_changed_outlives_an_engagement_and_the_vehicles_report() -> None:
    t = Tuned(0.4)
    t.tuning.begin()
    assert t.tuning.change({"xy": {"vel_p": 0.07}}, force=True) is None
    t.report(0.42)
    t.tuning.begin()
    law = t.controller.config.law
    assert (law.xy.vel_p, law.xy.pos_p_per_s) == (0.07, 0.95), "and the rest is as it was"
    assert law.hover_thrust == pytest.approx(0.42), "its own value still holds"
    assert t.tuning.change({"hover_thrust": 0.5}, force=False) is None
    t.tuning.begin()
    assert t.hover_thrust == 0.5


def test_gains_that_cannot_fly_or_bear_too_little_change_nothing() -> None:
    t = Tuned()
    before = t.controller.config
    refused = t.tuning.change({"hover_thrust": 0.95}, force=True)
    assert refused is not None and "hover_thrust" in refused and "\n" not in refused
    assert "insist with force" in str(t.tuning.change({"z": {"vel_p": 2.0}}, force=False))
    assert t.controller.config == before
    assert t.tuning.change({"z": {"vel_p": 2.0}}, force=True) is None
    assert law_json(t.controller.config.law)["z"]["vel_p"] == 2.0


def test_attitude_is_flown_up_to_the_delay_that_the_gains_bear_and_never_beyond_the_limit_that_is_set() -> None:
    t = Tuned(0.3)
    t.tuning.begin()
    warning = t.tuning.check(ATTITUDE, force=False)
    assert t.limit_s == bearable_delay_s(t.controller.config.law) and 0.05 < t.limit_s < 0.07
    assert f"up to {t.limit_s:g} s of delay instead of 0.1 s" in str(warning)
    assert t.tuning.check(VELOCITY, force=False) is None, "its delay is another"
    assert t.tuning.change({"z": SLOWER}, force=False) is None
    assert t.limit_s == 0.1, "these bear it, and more is not allowed"
    assert t.tuning.check(ATTITUDE, force=False) is None


def test_gains_that_bear_no_link_are_refused_or_forced_and_then_flown_with_the_limit_that_is_set() -> None:
    t = Tuned(0.15)
    t.tuning.begin()
    with pytest.raises(RefusedError, match=r"z: these gains are unstable from 0.0.*force"):
        t.tuning.check(ATTITUDE, force=False)
    assert t.tuning.check(ATTITUDE, force=True) is None
    t.tuning.limit_delay()
    assert t.limit_s == 0.1
    assert t.tuning.check(ATTITUDE, force=False) is None, "it was insisted on"
    assert t.tuning.change({"z": SLOWER, "hover_thrust": 0.45}, force=False) is None
    assert t.tuning.change({"hover_thrust": 0.3, "z": {"vel_p": 0.11}}, force=False) is None
    t.controller.change_law(replace(t.controller.config.law, hover_thrust=0.15))
    t.tuning.limit_delay()
    assert t.limit_s < 0.1, "that was about other gains"


def test_raw_flight_has_a_controller_of_its_own() -> None:
    t = Tuned(0.3)
    t.tuning.begin()
    t.tuning.limit_delay()
    assert t.limit_s < 0.07
    t.controller.wanted = RAW
    t.tuning.limit_delay()
    assert t.limit_s == 0.1


def test_gains_that_bear_nothing_leave_the_guard_its_least_limit() -> None:
    t = Tuned(z={"vel_p": 20.0})
    assert bearable_delay_s(t.controller.config.law) == 0.0
    t.tuning.limit_delay()
    assert t.limit_s == SHORTEST_DELAY_S


@pytest.mark.parametrize(("bytes_per_s", "fast"), [(1200.0, True), (1100.0, False)])
def test_fast_pings_come_out_of_the_setpoints_share_where_enough_is_left(bytes_per_s: float, fast: bool) -> None:
    t = Tuned()
    t.tuning.share_link(bytes_per_s)
    assert t.controller.fast_pings is fast
    left = bytes_per_s - 140.0 if fast else bytes_per_s  # five pings a second of 28 bytes
    assert t.controller.attitude_hz_allowed == pytest.approx(left / FRAME_BYTES["SET_ATTITUDE_TARGET"])
    assert left >= 20.0 * FRAME_BYTES["SET_ATTITUDE_TARGET"] or not fast
