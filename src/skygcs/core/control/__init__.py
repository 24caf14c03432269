"""Flight control: the cascade that turns position errors into attitude and thrust."""

from skygcs.core.control.cascade import Estimate, Memory, Output, Reference, Saturation, step, velocity_step
from skygcs.core.control.gains import AxisGains, ControlConfig

__all__ = [
    "AxisGains",
    "ControlConfig",
    "Estimate",
    "Memory",
    "Output",
    "Reference",
    "Saturation",
    "step",
    "velocity_step",
]
