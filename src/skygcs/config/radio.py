"""Settings of a radio: its speed, how it is shared, and the behaviour of an emulated one."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field

from skygcs.config.tables import Model
from skygcs.core.radio_link.pacing import RadioRates
from skygcs.core.radio_link.stream_rates import rate_problem

Profile = Literal["monitor", "nav", "control", "full", "custom"]
Nodes = Annotated[int, Field(ge=2, le=64)]
Kbps = Annotated[float, Field(ge=0.1, le=10_000)]
Share = Annotated[float, Field(ge=0.001, le=1)]


def _rate(rate_hz: float) -> float:
    if rate_hz >= 0 and (problem := rate_problem(rate_hz)) is not None:
        raise ValueError(problem)
    return rate_hz


RateHz = Annotated[float, Field(ge=0), AfterValidator(_rate)]
"""Rate of a message; 0 turns it off."""


class ThirdPartyKeys(Model):
    """Limits of what ground stations and programs behind other links may send into a radio
    (`core.radio_link.admission`)."""

    param_lists: Literal["one", "deny", "allow"] = "one"
    """PARAM_REQUEST_LIST: one vehicle's at a time, none, or all at once."""
    files: Literal["one", "deny", "allow"] = "one"
    """FILE_TRANSFER_PROTOCOL: with one vehicle at a time, with none, or with all at once."""
    streams: Literal["deny", "allow"] = "deny"
    """REQUEST_DATA_STREAM, MESSAGE_INTERVAL and SET_MESSAGE_INTERVAL to vehicles whose streams are planned."""
    logs: Literal["deny", "allow"] = "deny"
    rates: dict[str, RateHz] = Field(default_factory=dict)
    """Hz per message name or id, of each source, laid over the built-in ones; 0: none at all."""
    bytes_per_s: Annotated[float, Field(ge=1, le=1e9)] | None = None
    """Most of all third-party traffic; None: half of what goes up into the radio."""
    corrections_bytes_per_s: Annotated[float, Field(ge=0, le=1e9)] | None = None
    """Most of RTCM corrections; None: 0.4 of what goes up."""


class RadioKeys(BaseModel):
    """Keys of a serial link that count while its role is "radio"."""

    air_speed_kbps: Kbps | None = None
    """Air speed of a multipoint radio (its AIR_SPEED): its timeslots are counted then."""
    nodes: Nodes | None = None
    """Nodes of the multipoint network, the ground's included; None: as many as vehicles are heard, and one."""
    duty_cycle: Share = 1.0
    """Share of time in which the radio may send (its DUTY_CYCLE, as a share)."""
    uplink_share: Share | None = None
    """Share for the uplink: of the serial rate (default 0.5) or, with an air speed, of the ground's timeslot (0.9)."""
    downlink_share: Share = 0.5
    """Share of the serial rate and of a vehicle's timeslot that the planned streams may fill."""
    stream_profile: Profile = "custom"
    """Streams of every vehicle behind it if they fit; custom: its own ``streams``."""
    third_party: ThirdPartyKeys = ThirdPartyKeys()
    """Limits for the messages that third-party programs send into it."""


class EmulatedRadio(Model):
    """The radios between the daemon and simulated vehicles (`sim.tdm`)."""

    air_kbps: Kbps = 64.0
    baud: Annotated[int, Field(ge=1200, le=1_000_000)] = 57600
    nodes: Nodes | None = None
    """None: one for each vehicle and one."""
    loss: Annotated[float, Field(ge=0, lt=1)] = 0.0
    burst_loss: Annotated[float, Field(ge=0, le=0.9)] = 0.0
    burst_s: Annotated[float, Field(ge=0.001, le=60)] = 1.0
    rtscts: bool = False
    distances_m: tuple[Annotated[float, Field(gt=0, le=1e6)], ...] = ()


def _hop_counts(text: object) -> object:
    """Hop counts of "1:2:3", as they are written on a command line."""
    return tuple(text.split(":")) if isinstance(text, str) else text


class EmulatedXBees(Model):
    """An emulated network of XBee modules (`sim.xbee_mesh`)."""

    rf_kbps: Kbps = 200.0
    payload_bytes: Annotated[int, Field(ge=16, le=256)] = 256
    baud: Annotated[int, Field(ge=1200, le=1_000_000)] = 57600
    loss: Annotated[float, Field(ge=0, lt=1)] = 0.0
    hops: Annotated[tuple[Annotated[int, Field(ge=1, le=32)], ...], BeforeValidator(_hop_counts)] = ()
    api_mode: Literal[1, 2] = 2


def radio_rates(keys: RadioKeys, baud: int) -> RadioRates:
    """The rates of the radio at a serial port, by the link's keys."""
    return RadioRates(baud, keys.air_speed_kbps, keys.nodes, keys.duty_cycle, keys.uplink_share)
