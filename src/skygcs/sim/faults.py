"""Faults that a test or a drill can set in a simulated vehicle."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class Faults:
    """Everything off by default; may be changed at any time and takes effect with the next tick."""

    refuse_arming: str = ""
    """The reason given for refusing to arm."""
    refuse_mode: str = ""
    """The reason given for refusing every change of mode that is asked for; failsafes still change it."""
    ack_loss: float = 0.0
    """Fraction of COMMAND_ACKs that are never sent."""
    gps_lost: bool = False
    satellites: int = 14
    hdop: float = 0.75
    """Horizontal dilution of its GPS: the value of so many satellites under open sky."""
    throttle_down: bool = False
    """A pilot's transmitter is on and lies there with its throttle down, as SITL's; else no receiver was ever seen."""
    unhealthy_sensors: int = 0
    """Bits of MAV_SYS_STATUS_SENSOR that SYS_STATUS reports as present, enabled and not healthy."""
    clock_error_s: float = 0.0
    """The vehicle's clock (SYSTEM_TIME) minus the true time."""
    nan_attitude: bool = False
    """ATTITUDE and ATTITUDE_QUATERNION report NaN."""
    mute: bool = False
    """The vehicle lives on and hears, but nothing it sends arrives (its sequence number goes on): telemetry is cut."""
    deaf: bool = False
    """Nothing sent to it arrives, it goes on sending; with ``mute`` the radio link is cut."""
    battery_drain: float = 1.0
    """Times the normal current. The charge itself: `SimVehicle.battery.set_percent`."""
    reboot: bool = False
    """Set it for one power cycle, in the air as well: the motors stop and it falls. Clears itself."""
