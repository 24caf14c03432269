"""The gains that one vehicle is flown by, and the delay up to which they may fly it by attitude. Pure.

what                 taken from                                         lasts until
------------------   ------------------------------------------------   --------------------------------
gains and limits     the fleet file; `change`                           the next `change`
hover thrust         the fleet file or `change`; else the vehicle's     the next entry, if the vehicle's
                     own report
limit of the delay   the smaller of the fleet file's and what the       the next `limit_delay`
                     gains bear at this hover thrust and rate
the same, forced     the fleet file's, whatever the gains bear          the next `change`
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import asdict, replace
from functools import lru_cache
from typing import Any

from skygcs.config.control import ControlSettings
from skygcs.core.control.analysis import LEAST_DELAY_S, bearable_delay_s, why_not_delay
from skygcs.core.control.delay import FAST_PERIOD_S, PING_BYTES
from skygcs.core.control.gains import ControlConfig
from skygcs.core.control.guard import ControlMode
from skygcs.core.radio_link.capacity import FRAME_BYTES
from skygcs.core.vehicle import offboard_entry, orders
from skygcs.core.vehicle.offboard_controller import OffboardConfig, OffboardController
from skygcs.core.vehicle.vehicle import Vehicle
from skygcs.errors import ConfigError, RefusedError

SHORTEST_DELAY_S = 0.001
"""Least limit of the guard."""


class ControlTuning:
    """Gains of one vehicle's ``controller``. What somebody changed outlives an engagement, not the daemon."""

    def __init__(self, controller: OffboardController, vehicle: Vehicle, settings: ControlSettings) -> None:
        self._controller = controller
        self._vehicle = vehicle
        self._settings = settings
        self._attitude_delay_s = settings.guard().attitude_delay_s
        """Configured limit of the attitude delay; a flight uses the smaller of it and the delay that the gains bear."""
        self._forced = False
        """True if somebody insisted on gains that bear less."""
        self._law_changed = False
        self._hover_thrust_set = False

    def begin(self) -> None:
        """Control begins: take the vehicle's own hover thrust. Raises RefusedError if that cannot be right."""
        self._controller.config = self._config_now()

    def renew_hover_thrust(self) -> None:
        """While it flies: position and velocity were begun without the vehicle's own hover thrust, attitude is not.
        Raises RefusedError if that cannot be right."""
        law = self._controller.config.law
        hover_thrust = self._config_now().law.hover_thrust
        if hover_thrust != law.hover_thrust:
            self._controller.change_law(replace(law, hover_thrust=hover_thrust))

    def check(self, control_mode: ControlMode, *, force: bool) -> str | None:
        """Raises RefusedError if the gains bear less delay than any link has, unless ``force``. Returns a warning where
        they bear less than the limit that is set: attitude is then flown up to what they bear."""
        if control_mode is not ControlMode.ATTITUDE or self._forced:
            return None
        law, wanted_s = self._law_in_use(), self._attitude_delay_s
        bears_s = _bearable_delay_s(law)
        if bears_s is None or bears_s >= wanted_s:
            return None
        least_s = min(LEAST_DELAY_S, wanted_s)
        if bears_s < least_s and not force:
            raise RefusedError(f"{why_not_delay(law, least_s)}; or {orders.FORCE_HINT}")
        self._forced = bears_s < least_s
        self.limit_delay()
        if self._forced:
            return None
        return (
            f"attitude is flown with up to {bears_s:g} s of delay instead of {wanted_s:g} s: the gains bear no "
            f"more at its hover thrust of {law.hover_thrust:.3g} and {1 / law.period_s:.3g} setpoints a second"
        )

    def change(self, changes: Mapping[str, Any], *, force: bool) -> str | None:
        """Part of xy, z and hover_thrust; checked as the fleet file's are, and, unless ``force``, against the delay
        with which attitude control may fly. Returns why they are refused; None: they are in use."""
        law = self._controller.config.law
        try:
            new = replace(
                law,
                xy=replace(law.xy, **changes.get("xy", {})),
                z=replace(law.z, **changes.get("z", {})),
                hover_thrust=changes.get("hover_thrust", law.hover_thrust),
            )
        except ConfigError as error:
            return "; ".join(error.problems)
        why = why_not_delay(new, self._controller.config.guard.attitude_delay_s)
        if why is not None and not force:
            return f"{why}; insist with force (--force)"
        self._forced = why is not None
        self._controller.change_law(new)
        self.limit_delay()
        self._law_changed = True
        self._hover_thrust_set |= "hover_thrust" in changes
        return None

    def share_link(self, bytes_per_s: float) -> None:
        """The link leaves this to the vehicle's setpoints. It decides how many attitude setpoints a second are flown,
        and whether pings five times a second beside them, which come out of the same share."""
        controller, frame_bytes = self._controller, FRAME_BYTES["SET_ATTITUDE_TARGET"]
        left = bytes_per_s - PING_BYTES / FAST_PERIOD_S
        controller.fast_pings = left >= controller.config.rate_min_hz * frame_bytes
        controller.attitude_hz_allowed = (left if controller.fast_pings else bytes_per_s) / frame_bytes
        self.limit_delay()

    def limit_delay(self) -> None:
        """Have attitude flown with no more delay than the gains bear, on the vehicle's own hover thrust and at the rate
        that the link leaves. Raw flight has a controller of its own."""
        law_counts = not self._forced and self._controller.wanted is not ControlMode.RAW
        bears_s = _bearable_delay_s(self._law_in_use()) if law_counts else None
        limit_s = self._attitude_delay_s if bears_s is None else min(self._attitude_delay_s, bears_s)
        self._controller.limit_attitude_delay(max(limit_s, SHORTEST_DELAY_S))

    def _law_in_use(self) -> ControlConfig:
        return replace(self._controller.config.law, period_s=1.0 / self._controller.attitude_hz)

    def _config_now(self) -> OffboardConfig:
        """The fleet file's, with gains that were changed since, and the vehicle's own hover thrust unless one is set.
        Raises RefusedError if that cannot be right."""
        hover_thrust = offboard_entry.reported_hover_thrust(self._vehicle)
        try:
            config = offboard_config(self._settings, hover_thrust)
            if self._law_changed:
                law = self._controller.config.law
                if not self._hover_thrust_set:  # only other gains were changed: the vehicle's own value still holds
                    law = replace(law, hover_thrust=config.law.hover_thrust)
                config = replace(config, law=law)
        except ConfigError as error:
            why = "; ".join(error.problems)
            raise RefusedError(
                f"it says its hover thrust is {hover_thrust:g}, and {why}; give hover_thrust in the fleet file"
            ) from None
        return config


def offboard_config(settings: ControlSettings, hover_thrust: float | None) -> OffboardConfig:
    """The control law of these settings; ``hover_thrust``: what the autopilot reports. Raises ConfigError."""
    config = OffboardConfig(settings.law(hover_thrust), settings.guard(), raw=settings.raw_limits())
    rates = {"attitude_hz": settings.rate_hz, "velocity_hz": settings.velocity_hz, "position_hz": settings.position_hz}
    others = {"rate_min_hz": settings.rate_min_hz, "velocity_predictor": settings.velocity_predictor}
    given: dict[str, Any] = {k: v for k, v in {**rates, **others}.items() if v is not None}
    shared: OffboardConfig = first_equal(replace(config, **given))
    return shared


def law_json(law: ControlConfig) -> dict[str, Any]:
    """Gains and limits, as control.gains shows them."""
    return {
        "xy": asdict(law.xy),
        "z": asdict(law.z),
        "hover_thrust": law.hover_thrust,
        "limits": {
            "thrust_min": law.thrust_min,
            "thrust_max": law.thrust_max,
            "tilt_max_deg": round(math.degrees(law.tilt_max_rad), 2),
            "vel_xy_max_mps": law.vel_xy_max_mps,
            "vel_z_max_mps": law.vel_z_max_mps,
            **({} if law.acc_xy_max_mps2 is None else {"acc_xy_max_mps2": law.acc_xy_max_mps2}),
            **({} if law.acc_z_max_mps2 is None else {"acc_z_max_mps2": law.acc_z_max_mps2}),
        },
    }


@lru_cache(maxsize=256)
def first_equal(value: Hashable) -> Any:
    """The first of several equal values: with a hundred vehicles it is then still in the CPU's caches when the next one
    ticks (measured there: 4 % of a tick)."""
    return value


_bearable_delay_s = lru_cache(maxsize=256)(bearable_delay_s)
"""0.2 ms, asked for every second by each vehicle under control."""
