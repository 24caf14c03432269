"""Settings of a radio: its speed, how it is shared, and the behaviour of an emulated one."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, Field

from skygcs.config.files import open_regular
from skygcs.config.tables import Model
from skygcs.core.radio_link.capacity import AirTiming, RadioRates
from skygcs.core.radio_link.stream_rates import rate_problem
from skygcs.errors import ConfigError
from skygcs.spelling import parse_toml

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
    timing_file: Path | None = None
    """Measured timing of this network's radios (`skygcs-cli radio measure`); None: that of open SiK is assumed."""
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
    timing = measured_timing(keys)
    return RadioRates(baud, keys.air_speed_kbps, keys.nodes, keys.duty_cycle, keys.uplink_share, timing)


# --- measured timing --------------------------------------------------------------------------------------------------

TIMING_KIND = "radio timing"
TIMING_VERSION = 1
MAX_TIMING_BYTES = 262_144
"""Largest timing file; one air speed has some 3 kB."""


def measured_timing(keys: RadioKeys) -> AirTiming | None:
    """The link's measured timing. None where there is no usable one: the file was checked with the fleet file, and a
    radio that comes back after the file was removed is opened all the same."""
    if keys.timing_file is None or keys.air_speed_kbps is None:
        return None
    try:
        return read_timings(keys.timing_file).get(keys.air_speed_kbps)
    except ConfigError:
        return None


def timing_problem(keys: RadioKeys, file: Path) -> str | None:
    """Why the link cannot use this timing file, and what to do; None if it can."""
    if keys.air_speed_kbps is None:
        return "needs air_speed_kbps: the radio's AIR_SPEED, for which the file must hold a measurement"
    try:
        timings = read_timings(file)
    except ConfigError as error:
        return f"{file}: {'; '.join(error.problems)}"
    if keys.air_speed_kbps not in timings:
        held = ", ".join(f"{speed:g}" for speed in timings)
        return (
            f"{file} was measured at AIR_SPEED {held}, and air_speed_kbps is {keys.air_speed_kbps:g}: "
            "correct the one that is wrong, or measure at this air speed: skygcs-cli radio measure"
        )
    return None


def read_timings(file: Path) -> dict[float, AirTiming]:
    """The measured timings of a file of `skygcs-cli radio measure`, by air speed in kbit/s. Raises ConfigError with
    everything that is wrong."""
    return timings_of(read_timing_document(file), str(file))


def read_timing_document(file: Path) -> dict[str, Any]:
    """The whole file, known to be one of `skygcs-cli radio measure`. Raises ConfigError."""
    try:
        with open_regular(file) as source:
            content = source.read(MAX_TIMING_BYTES + 1)
    except OSError as error:
        raise ConfigError(str(file), [f"cannot be read: {error.strerror or error}"]) from None
    if len(content) > MAX_TIMING_BYTES:
        raise ConfigError(str(file), [f"is longer than {MAX_TIMING_BYTES} bytes: this is not a timing file"])
    try:
        document = parse_toml(content.decode("utf-8"))
    except ValueError as error:  # not TOML, or not UTF-8
        raise ConfigError(str(file), [f"not a timing file: {error}"]) from None
    if document.get("kind") != TIMING_KIND or document.get("version") != TIMING_VERSION:
        text = f'kind must be "{TIMING_KIND}" and version {TIMING_VERSION}; is it written by skygcs-cli radio measure?'
        raise ConfigError(str(file), [text])
    return document


def timings_of(document: dict[str, Any], source: str) -> dict[float, AirTiming]:
    """The timings of a file's measurements. Raises ConfigError."""
    rows = document.get("measurement")
    if not isinstance(rows, list) or not rows or not all(isinstance(row, dict) for row in rows):
        raise ConfigError(source, ["measurement: must be at least one table [[measurement]]"])
    problems: list[str] = []
    timings: dict[float, AirTiming] = {}
    for index, row in enumerate(rows):
        found = [_wrong_number(row, key, *bounds) for key, bounds in _TIMING_BOUNDS.items()]
        texts = [text for text in found if text is not None]
        if not isinstance(row.get("date"), str) or not isinstance(row.get("banner"), str):
            texts.append("date and banner: must be text")
        if row.get("multipoint") is not True:
            texts.append("was measured with radios that are not multipoint: it says nothing of a network's timeslots")
        problems += [f"measurement[{index}].{text}" for text in texts]
        if not texts:
            origin = f"measured on {row['date'][:10]} with {row['banner'][:60]}"
            timing = AirTiming(float(row["slot_s"]), float(row["sync_s"]), float(row["slot_bytes"]), origin)
            if timings.setdefault(float(row["air_speed_kbps"]), timing) is not timing:
                problems.append(f"measurement[{index}].air_speed_kbps: {row['air_speed_kbps']:g} is there twice")
    if problems:
        raise ConfigError(source, [*problems, "measure again: skygcs-cli radio measure"])
    return timings


_TIMING_BOUNDS = {"air_speed_kbps": (0.1, 10_000), "slot_s": (1e-4, 60), "sync_s": (0, 60), "slot_bytes": (1, 1e6)}


def _wrong_number(row: dict[str, Any], key: str, least: float, most: float) -> str | None:
    value = row.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        return f"{key}: must be a number"
    return None if least <= value <= most else f"{key}: must be between {least:g} and {most:g}, not {value:g}"
