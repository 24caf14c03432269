"""Tables of a vehicle, a type or the defaults: ``separation``, the space that it needs, and ``preflight``, what is
expected of it before it flies; and ``[monitor]``, which watches the first.

Every key is optional at every level; defaults are those of `core.separation` and
`core.params.expectations.Expectations`.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, model_validator

from skygcs.config.tables import Model
from skygcs.core.mavlink.param_encoding import NAME_CHARS, is_name
from skygcs.core.params.expectations import ControlMode, Expectations, Rule, version_problem
from skygcs.core.separation import Footprint

MonitorMode = Literal["off", "advisory", "acting"]


class MonitorConfig(Model):
    """[monitor]: the watch over the distances between vehicles."""

    mode: MonitorMode = "advisory"
    """off: no watch, and orders are not checked; advisory: report, and refuse orders that would bring two vehicles too
    close; acting: also hold the vehicle of lower priority."""


class SeparationSettings(Model):
    """The space that a vehicle needs; None: not set at this level."""

    wingspan_m: Annotated[float, Field(gt=0, le=30)] | None = None
    """Tip to tip, propellers included: 0.7."""
    position_error_m: Annotated[float, Field(ge=0, le=50)] | None = None
    """How far its reported position may be from the truth, against another vehicle beside it: 0.9; with RTK 0.1."""
    downwash_ratio: Annotated[float, Field(ge=1, le=10)] | None = None
    """Vertical distances are divided by it: 2. Of two vehicles the larger counts."""
    acceleration_mps2: Annotated[float, Field(ge=0, le=50)] | None = None
    """The acceleration with which it may have left its course since its last position: 3."""
    tracking_error_m: Annotated[float, Field(ge=0.05, le=20)] | None = None
    """How far it may be from its reference in a plan: 0.4 until it is measured in flight. The larger one counts."""
    priority: Annotated[int, Field(ge=-1000, le=1000)] | None = None
    """The vehicle of lower priority holds when two are about to meet: 0. Equal: the later name."""

    def over(self, lower: SeparationSettings) -> SeparationSettings:
        """These settings, completed key by key from ``lower``."""
        given = {key: value for key in type(self).model_fields if (value := getattr(self, key)) is not None}
        return lower.model_copy(update=given)

    def footprint(self) -> Footprint:
        """The same footprint for `core.separation`."""
        keys = ("wingspan_m", "position_error_m", "downwash_ratio", "acceleration_mps2")
        return Footprint(**{key: value for key in keys if (value := getattr(self, key)) is not None})


ParamValue = int | float
Mask = Annotated[int, Field(ge=1, lt=1 << 32)]
Limit = Annotated[float, Field(ge=0)]


def _param_name(text: str) -> str:
    if not is_name(text):
        raise ValueError(f"{text!r} is not a parameter's name: letters, digits and _, at most {NAME_CHARS}")
    return text.upper()


def _version(text: str) -> str:
    problem = version_problem(text)
    if problem is not None:
        raise ValueError(problem)
    return text


def _span(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError("is [least, most], and the first is above the second")
    return span


Span = Annotated[tuple[Limit, Limit], AfterValidator(_span)]
ParamName = Annotated[str, AfterValidator(_param_name)]
Version = Annotated[str, AfterValidator(_version)]


class RuleSettings(Model):
    """Comparisons with one parameter; all that are given must hold."""

    one_of: Annotated[tuple[ParamValue, ...], Field(min_length=1)] | None = Field(None, alias="in")
    min: ParamValue | None = None
    max: ParamValue | None = None
    bits: Mask | None = None
    """A mask of bits that must be set."""
    no_bits: Mask | None = None
    """A mask of bits that must be clear."""
    set: ParamValue | None = None
    """Value that --fix sets; default: the permitted value nearest to its present one."""
    why: str = ""
    optional: bool = False
    """A vehicle that has no such parameter passes."""

    @model_validator(mode="after")
    def _possible(self) -> RuleSettings:
        if self.min is not None and self.max is not None and self.min > self.max:
            raise ValueError(f"min {self.min:g} is above max {self.max:g}: no value satisfies both")
        if self.bits and self.no_bits and self.bits & self.no_bits:
            raise ValueError(f"bits and no_bits both have {self.bits & self.no_bits}: no value satisfies both")
        rule = self.rule()
        if self.one_of and not any(rule.holds(value) for value in self.one_of):
            raise ValueError("no value of in satisfies the rest of it")
        if self.set is not None and not rule.holds(self.set):
            raise ValueError(f"set {self.set:g} is itself not as expected ({rule})")
        return self

    def rule(self) -> Rule:
        """The same rule for `core.preflight`."""
        return Rule(
            one_of=self.one_of or (),
            least=self.min,
            most=self.max,
            bits=self.bits or 0,
            no_bits=self.no_bits or 0,
            set_to=self.set,
            why=self.why,
            optional=self.optional,
        )


class PreflightSettings(Model):
    """Settings of preflight; None: not set at this level. A limit of 0 turns its check off."""

    params: dict[ParamName, ParamValue | RuleSettings] | None = None
    """By name: a value, or a table of comparisons; an empty table takes a lower level's expectation away."""
    battery_min_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    gps_fix_min: Literal["no_gps", "no_fix", "2d", "3d", "dgps", "rtk_float", "rtk_fixed"] | None = None
    satellites_min: Annotated[int, Field(ge=0, le=99)] | None = None
    hdop_max: Limit | None = None
    estimator: bool | None = None
    prearm: bool | None = None
    sensors_required: tuple[str, ...] | None = None
    sensors_ignored: tuple[str, ...] | None = None
    home_max_m: Limit | None = None
    clock_max_s: Limit | None = None
    firmware_min: Version | None = None
    firmware: Version | tuple[Version, ...] | None = None
    loss_max_percent: Annotated[float, Field(ge=0, le=100)] | None = None
    radio_margin_min_db: Annotated[float, Field(ge=0, le=100)] | None = None
    rtl_height_m: Span | None = None
    geofence_required: bool | None = None
    transmitter: bool | None = None
    control_mode: ControlMode | Literal["none"] | None = None
    """How skygcs will fly it; default: "attitude" where there is a control table, else "none"."""

    def over(self, lower: PreflightSettings) -> PreflightSettings:
        """These settings, completed from ``lower``; params by name."""
        given = {key: value for key in type(self).model_fields if (value := getattr(self, key)) is not None}
        if self.params is not None and lower.params is not None:
            given["params"] = {**lower.params, **self.params}
        return lower.model_copy(update=given)

    def expectations(self, *, control: bool, setpoint_hz: float) -> Expectations:
        """``control``: whether the vehicle has a control table; ``setpoint_hz``: of its slowest control mode."""
        keys = {f.name for f in fields(Expectations)} & set(type(self).model_fields)
        given: dict[str, Any] = {key: value for key in keys if (value := getattr(self, key)) is not None}
        given["params"] = {name: _rule(value) for name, value in (self.params or {}).items()}
        if isinstance(self.firmware, str):
            given["firmware"] = (self.firmware,)
        control_mode = self.control_mode or ("attitude" if control else "none")
        return Expectations(**given, control=None if control_mode == "none" else control_mode, setpoint_hz=setpoint_hz)


def _rule(value: ParamValue | RuleSettings) -> Rule:
    return value.rule() if isinstance(value, RuleSettings) else Rule(one_of=(value,))
