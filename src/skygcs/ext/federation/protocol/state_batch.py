"""The states of a site's vehicles at one moment, as a message of the hub: `state.<site>.fast`, `state.<site>.slow`.

    {"v":1,"site":"north","run":"5f0c…","seq":17,"sent_s":1790000000.25,"period_s":0.1,"daemon":true,
     "origin":{"lat_deg":…,"lon_deg":…,"alt_amsl_m":…,"x_heading_deg":90.0},"vehicles":[[…],[…]]}

Each vehicle is an array with the fields of `VehicleRow` in their order, which needs half the bytes of an object
(docs/developers/federation-figures.md has the figures). A later version may append fields and keys; readers ignore
them. Positions are degrees; velocities and yaw refer to true east and north. The origin is shown to people only.

Pure. `decode_batch` checks every value against bounds and refuses the whole batch if one is outside, because
`row_from_state` never writes one: it replaces values of a vehicle that are out of bounds by null. The same holds for a
name that no fleet file may have, and for one that two vehicles have. Other texts are made printable.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from pydantic_core import SchemaValidator, ValidationError, core_schema, to_json

from skygcs.core.geo import EAST_DEG, Origin, Vector
from skygcs.ext.federation.protocol.received_json import printable
from skygcs.ext.federation.protocol.site_names import MAX_NAME_CHARS, SITE_NAME, is_vehicle_name

VERSION = 1

MAX_BATCH_BYTES = 1 << 20
"""The default max_payload of nats-server. 250 vehicles take 45 kB."""

MAX_VEHICLES_OF_SITE = 300
"""Vehicles that a daemon has at most (`runtime.vehicle_services.MAX_VEHICLES`)."""

MAX_WORD_CHARS = 32
"""Longest mode, type, or other word of the daemon's state; longer ones are cut."""

MAX_GROUPS = 8
"""Groups of a vehicle that are sent; further ones are left out."""

MAX_AGE_S = 1e7
"""Largest age, four months. A value that was never received has no age."""

MAX_SPEED_MPS = 2000.0
MAX_ALTITUDE_M = 100_000.0
"""Bounds of plausible values: larger ones are errors of a sensor or of a sender."""

LEAST_PERIOD_S, MAX_PERIOD_S = 0.05, 10.0
"""Bounds of the period of batches. The least is that of the highest `rate_hz` of `[federation]`, 20."""

STATE_GROUPS = (
    *("compid", "autopilot", "type", "groups", "connected", "last_heartbeat_age_s", "armed", "mode", "landed"),
    *("failsafe", "control", "gps", "position", "battery"),
)
"""Telemetry groups that the bridge subscribes to at the daemon."""


class RowLease(NamedTuple):
    """The lease of a delegated vehicle: the site that holds it, the fencing token, and its remaining validity."""

    holder: str
    revision: int
    remaining_s: float


class VehicleRow(NamedTuple):
    """One vehicle of a batch, with the name it has at its site. None: the value is not known."""

    name: str
    sysid: int
    compid: int
    autopilot: str
    type: str
    groups: tuple[str, ...]
    mode: str
    armed: bool
    landed: str
    heard: bool
    """``connected`` of the daemon's state."""
    failsafe: bool
    age_s: float | None
    """Time from its last heartbeat to the sending of the batch."""
    position_age_s: float | None
    """Time from its last position to the sending of the batch."""
    lat_deg: float | None
    lon_deg: float | None
    alt_amsl_m: float | None
    alt_rel_m: float | None
    vel_enu_mps: Vector | None
    """True east, north, up."""
    yaw_rad: float | None
    """0 is true east, counter-clockwise."""
    battery_percent: float | None
    battery_volts: float | None
    gps_fix: str | None
    satellites: int | None
    control: str | None
    """State of control by setpoints; None: skygcs does not control it."""
    lease: RowLease | None


@dataclass(frozen=True, slots=True)
class StateBatch:
    """All shared vehicles of a site. The newest batch has the largest ``seq`` of the newest ``run``."""

    site: str
    run: str
    """Random identifier of one run of the site's bridge."""
    seq: int
    sent_s: float
    """Time of sending by the site's clock, which never steps within a run."""
    period_s: float
    """Time to the next batch."""
    daemon: bool
    """True if the bridge is connected to the site's daemon. If not, no state is renewed, and the ages grow."""
    origin: Origin | None
    vehicles: tuple[VehicleRow, ...]


def row_from_state(state: Mapping[str, Any]) -> VehicleRow | None:
    """The row of a daemon's state, which has STATE_GROUPS. None if its name or ids cannot be sent."""
    # identity: without a valid one there is no row
    name, sysid, compid = state.get("name"), state.get("sysid"), state.get("compid")
    if not isinstance(name, str) or not is_vehicle_name(name):
        return None
    if not isinstance(sysid, int) or not isinstance(compid, int) or not (0 <= sysid <= 255 and 0 <= compid <= 255):
        return None
    # parts of the state that may be missing or of a wrong type
    position, battery, gps, control = (
        part if isinstance(part := state.get(key), Mapping) else {} for key in ("position", "battery", "gps", "control")
    )
    lat_deg, lon_deg = _number(position.get("lat_deg"), 90.0, 7), _number(position.get("lon_deg"), 180.0, 7)
    placed = lat_deg is not None and lon_deg is not None
    heading_deg = _number(position.get("heading_deg"), 360.0, 2)
    groups = state.get("groups")
    names = [printable(group) for group in groups if _is_name(group)] if isinstance(groups, Sequence) else []
    # every value within its bounds, or None
    return VehicleRow(
        name=name,
        sysid=sysid,
        compid=compid,
        autopilot=_word(state.get("autopilot")) or "",
        type=_word(state.get("type")) or "",
        groups=tuple(names[:MAX_GROUPS]),
        mode=_word(state.get("mode")) or "",
        armed=state.get("armed") is True,
        landed=_word(state.get("landed")) or "",
        heard=state.get("connected") is True,
        failsafe=state.get("failsafe") is True,
        age_s=_age(state.get("last_heartbeat_age_s")),
        position_age_s=_age(position.get("age_s")) if placed else None,
        lat_deg=lat_deg if placed else None,
        lon_deg=lon_deg if placed else None,
        alt_amsl_m=_number(position.get("alt_amsl_m"), MAX_ALTITUDE_M, 2) if placed else None,
        alt_rel_m=_number(position.get("alt_rel_m"), MAX_ALTITUDE_M, 2),
        vel_enu_mps=_velocity(position.get("vel_enu_mps")) if placed else None,
        yaw_rad=None if heading_deg is None else round(math.remainder(math.radians(90.0 - heading_deg), math.tau), 3),
        battery_percent=_number(battery.get("percent"), 100.0, 1),
        battery_volts=_number(battery.get("volts"), 1000.0, 2),
        gps_fix=_word(gps.get("fix")),
        satellites=_count(gps.get("satellites")),
        control=_word(control.get("state")),
        lease=None,
    )


def aged(row: VehicleRow, seconds: float) -> VehicleRow:
    """The row with its ages larger by ``seconds``."""
    age_s, position_age_s = row.age_s, row.position_age_s
    return row._replace(
        age_s=None if age_s is None else round(min(age_s + seconds, MAX_AGE_S), 3),
        position_age_s=None if position_age_s is None else round(min(position_age_s + seconds, MAX_AGE_S), 3),
    )


def encode_batch(batch: StateBatch) -> bytes:
    """The message that `decode_batch` reads."""
    origin = batch.origin
    return to_json(
        {
            "v": VERSION,
            "site": batch.site,
            "run": batch.run,
            "seq": batch.seq,
            "sent_s": round(batch.sent_s, 4),
            "period_s": batch.period_s,
            "daemon": batch.daemon,
            "origin": None if origin is None else origin.as_dict(),
            "vehicles": batch.vehicles,
        },
        inf_nan_mode="null",
    )


def decode_batch(data: bytes) -> StateBatch:
    """The batch of a message. Raises ValueError that names the first problem in one line."""
    if len(data) > MAX_BATCH_BYTES:
        raise ValueError(f"a batch of {len(data)} bytes; at most {MAX_BATCH_BYTES}")
    try:
        found = _BATCH.validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ValueError(f"{where}: {first['msg']}" if where else str(first["msg"])) from None
    if found["v"] != VERSION:
        raise ValueError(f"a batch of version {found['v']}; this skygcs reads {VERSION}")
    origin = found["origin"]
    rows = [VehicleRow._make((*row[:_LEASE], _lease(row[_LEASE]))) for row in found["vehicles"]]
    names = {row[0] for row in rows}
    if len(names) < len(rows):
        raise ValueError("vehicles: two have one name")
    if not all(map(is_vehicle_name, names)):
        bad = next(name for name in names if not is_vehicle_name(name))
        raise ValueError(f"vehicles: {bad!a} is not a vehicle's name")
    if not data.isascii() or b"\\" in data or b"\x7f" in data:  # other JSON has printable texts only
        rows = [_shown(row) for row in rows]
    return StateBatch(
        found["site"],
        printable(found["run"]),
        found["seq"],
        found["sent_s"],
        found["period_s"],
        found["daemon"],
        None if origin is None else Origin(**origin),
        tuple(rows),
    )


# --- values of a daemon's state ---------------------------------------------------------------------------------------


def _number(value: object, largest: float, digits: int) -> float | None:
    if isinstance(value, bool) or not isinstance(value, int | float) or not -largest <= value <= largest:  # and NaN
        return None
    return round(float(value), digits)


def _age(value: object) -> float | None:
    age_s = _number(value, MAX_AGE_S, 3)
    return None if age_s is None else max(age_s, 0.0)


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 255 else None


def _word(value: object) -> str | None:
    return printable(value, MAX_WORD_CHARS) if isinstance(value, str) else None


def _is_name(value: object) -> bool:
    return isinstance(value, str) and 0 < len(value) <= MAX_NAME_CHARS


def _velocity(value: object) -> Vector | None:
    if not isinstance(value, Sequence) or len(value) != 3:
        return None
    east, north, up = (_number(axis, MAX_SPEED_MPS, 2) for axis in value)
    return None if east is None or north is None or up is None else (east, north, up)


def _shown(row: VehicleRow) -> VehicleRow:
    """The row with its texts as a person may see them."""
    return row._replace(
        autopilot=printable(row.autopilot),
        type=printable(row.type),
        groups=tuple(printable(group) for group in row.groups),
        mode=printable(row.mode),
        landed=printable(row.landed),
        gps_fix=None if row.gps_fix is None else printable(row.gps_fix),
        control=None if row.control is None else printable(row.control),
    )


def _lease(found: tuple[Any, ...] | None) -> RowLease | None:
    return None if found is None else RowLease(*found[:3])


# --- the bounds of what is read ---------------------------------------------------------------------------------------


def _between(least: float, most: float) -> core_schema.CoreSchema:
    return core_schema.float_schema(ge=least, le=most, allow_inf_nan=False, strict=True)


def _or_null(schema: core_schema.CoreSchema) -> core_schema.CoreSchema:
    return core_schema.nullable_schema(schema)


def _text(most: int, least: int = 0) -> core_schema.CoreSchema:
    return core_schema.str_schema(min_length=least, max_length=most, strict=True)


def _integer(most: int) -> core_schema.CoreSchema:
    return core_schema.int_schema(ge=0, le=most, strict=True)


def _growing(*items: core_schema.CoreSchema, spare: int = 64) -> core_schema.CoreSchema:
    """An array of these items, to which later versions may append up to ``spare`` items."""
    return core_schema.tuple_schema(
        [*items, core_schema.any_schema()], variadic_item_index=len(items), max_length=len(items) + spare, strict=False
    )


def _keys(**schemas: core_schema.CoreSchema) -> core_schema.CoreSchema:
    fields = {
        name: core_schema.typed_dict_field(schema, required=schema["type"] != "default")
        for name, schema in schemas.items()
    }
    return core_schema.typed_dict_schema(fields, extra_behavior="ignore")


_BOOL = core_schema.bool_schema(strict=True)
_SITE = core_schema.str_schema(pattern=f"^{SITE_NAME.pattern}$", max_length=16, strict=True)
_NUMBERS_3 = core_schema.tuple_schema([_between(-MAX_SPEED_MPS, MAX_SPEED_MPS)] * 3)

_ROW_SCHEMAS: dict[str, core_schema.CoreSchema] = {
    "name": _text(MAX_NAME_CHARS, 1),
    "sysid": _integer(255),
    "compid": _integer(255),
    "autopilot": _text(MAX_WORD_CHARS),
    "type": _text(MAX_WORD_CHARS),
    "groups": core_schema.tuple_schema([_text(MAX_NAME_CHARS)], variadic_item_index=0, max_length=MAX_GROUPS),
    "mode": _text(MAX_WORD_CHARS),
    "armed": _BOOL,
    "landed": _text(MAX_WORD_CHARS),
    "heard": _BOOL,
    "failsafe": _BOOL,
    "age_s": _or_null(_between(0.0, MAX_AGE_S)),
    "position_age_s": _or_null(_between(0.0, MAX_AGE_S)),
    "lat_deg": _or_null(_between(-90.0, 90.0)),
    "lon_deg": _or_null(_between(-180.0, 180.0)),
    "alt_amsl_m": _or_null(_between(-MAX_ALTITUDE_M, MAX_ALTITUDE_M)),
    "alt_rel_m": _or_null(_between(-MAX_ALTITUDE_M, MAX_ALTITUDE_M)),
    "vel_enu_mps": _or_null(_NUMBERS_3),
    "yaw_rad": _or_null(_between(-3.1416, 3.1416)),
    "battery_percent": _or_null(_between(-100.0, 100.0)),
    "battery_volts": _or_null(_between(-1000.0, 1000.0)),
    "gps_fix": _or_null(_text(MAX_WORD_CHARS)),
    "satellites": _or_null(_integer(255)),
    "control": _or_null(_text(MAX_WORD_CHARS)),
    "lease": _or_null(_growing(_SITE, _integer(1 << 62), _between(-MAX_AGE_S, MAX_AGE_S), spare=8)),
}
assert tuple(_ROW_SCHEMAS) == VehicleRow._fields
_LEASE = VehicleRow._fields.index("lease")

_BATCH = SchemaValidator(
    _keys(
        v=_integer(1 << 31),
        site=_SITE,
        run=_text(64, 1),
        seq=_integer(1 << 62),
        sent_s=_between(-1e11, 1e11),
        period_s=_between(LEAST_PERIOD_S, MAX_PERIOD_S),
        daemon=_BOOL,
        origin=_or_null(
            _keys(
                lat_deg=_between(-90.0, 90.0),
                lon_deg=_between(-180.0, 180.0),
                alt_amsl_m=_between(-MAX_ALTITUDE_M, MAX_ALTITUDE_M),
                x_heading_deg=core_schema.with_default_schema(_between(-360.0, 360.0), default=EAST_DEG),
            )
        ),
        vehicles=core_schema.list_schema(_growing(*_ROW_SCHEMAS.values()), max_length=MAX_VEHICLES_OF_SITE),
    )
)
