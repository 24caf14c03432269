"""What a site sends of its vehicles: any daemon's state makes a batch that can be read; anything else is refused."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.geo import Origin
from skygcs.ext.federation.protocol import state_batch
from skygcs.ext.federation.protocol.state_batch import (
    RowLease,
    StateBatch,
    VehicleRow,
    aged,
    decode_batch,
    encode_batch,
    row_from_state,
)
from support.table import each

STATE: dict[str, Any] = {
    "name": "alpha",
    "sysid": 1,
    "compid": 1,
    "autopilot": "px4",
    "type": "QUADROTOR",
    "groups": ["red"],
    "connected": True,
    "last_heartbeat_age_s": 0.42,
    "armed": True,
    "mode": "AUTO.LOITER",
    "landed": "in_air",
    "failsafe": False,
    "control": None,
    "gps": {"fix": "rtk_fixed", "satellites": 21, "age_s": 0.1},
    "battery": {"percent": 87, "volts": 15.92, "age_s": 0.5},
    "position": {
        "lat_deg": 43.7806123,
        "lon_deg": -79.4653456,
        "alt_amsl_m": 201.5,
        "alt_rel_m": 12.34,
        "heading_deg": 0.0,
        "vel_enu_mps": [1.0, -2.0, 0.5],
        "age_s": 0.08,
    },
}


def row(**changes: Any) -> VehicleRow:
    made = row_from_state(STATE | changes)
    assert made is not None
    return made


def batch(*rows: VehicleRow) -> StateBatch:
    return StateBatch("north", "5f0c", 17, 1790000000.25, 0.1, True, Origin(43.78, -79.46, 180.0, 75.0), rows)


def test_a_batch_comes_back_as_it_was() -> None:
    leased = row()._replace(lease=RowLease("south", 12, 2.25))
    sent = batch(leased, row(name="bravo", position=None, gps=None, battery=None, control={"state": "flying"}))
    assert decode_batch(encode_batch(sent)) == sent
    assert sent.vehicles[0].yaw_rad == pytest.approx(math.pi / 2, abs=1e-3)
    assert sent.vehicles[1].lat_deg is None and sent.vehicles[1].position_age_s is None


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=80),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=6,
)
states = st.fixed_dictionaries(
    {"name": st.text(max_size=70), "sysid": st.integers(-1, 260), "compid": st.integers(-1, 260)},
    optional={
        **{key: json_values for key in state_batch.STATE_GROUPS if key not in ("compid", "position")},
        "position": st.dictionaries(st.sampled_from(list(STATE["position"])), json_values),
    },
)


@given(states)
def test_whatever_a_vehicle_reports_makes_a_batch_that_can_be_read(state: dict[str, Any]) -> None:
    made = row_from_state(state)
    if made is not None:
        try:
            encoded = encode_batch(batch(made))
        except UnicodeEncodeError:
            return
        assert decode_batch(encoded).vehicles == (made,)


@given(st.binary(max_size=300))
def test_bytes_are_a_batch_or_refused_in_one_line(data: bytes) -> None:
    with pytest.raises(ValueError) as error:
        decode_batch(data)
    assert "\n" not in str(error.value)


BAD: dict[str, Any] = {
    "site": "North",
    "run": "",
    "seq": -1,
    "sent_s": "1790000000",
    "period_s": 0.0,
    "daemon": 1,
    "origin": {"lat_deg": 91.0, "lon_deg": 0.0, "alt_amsl_m": 0.0},
    "vehicles": {},
    "v": 2,
}


@each("key", BAD)
def test_a_header_out_of_bounds_is_refused(key: str) -> None:
    good = json.loads(encode_batch(batch(row())))
    assert decode_batch(json.dumps(good).encode()).seq == 17
    with pytest.raises(ValueError):
        decode_batch(json.dumps(good | {key: BAD[key]}).encode())
    del good[key]
    with pytest.raises(ValueError):
        decode_batch(json.dumps(good).encode())


BAD_VALUES: dict[str, Any] = {
    "name": "a/b",
    "sysid": 256,
    "compid": 1.5,
    "autopilot": "x" * 33,
    "type": None,
    "groups": ["g"] * 9,
    "mode": 4,
    "armed": 1,
    "landed": ["in_air"],
    "heard": None,
    "failsafe": "no",
    "age_s": -0.1,
    "position_age_s": 1e8,
    "lat_deg": 90.1,
    "lon_deg": -181,
    "alt_amsl_m": 1e9,
    "alt_rel_m": "12",
    "vel_enu_mps": [1.0, 2.0],
    "yaw_rad": 4.0,
    "battery_percent": 101,
    "battery_volts": 1e4,
    "gps_fix": 3,
    "satellites": -1,
    "control": {},
    "lease": ["South", 1, 0.0],
}


@each("field", VehicleRow._fields)
def test_a_row_with_one_value_out_of_bounds_is_refused(field: str) -> None:
    good = json.loads(encode_batch(batch(row())))
    good["vehicles"][0][VehicleRow._fields.index(field)] = BAD_VALUES[field]
    with pytest.raises(ValueError, match="vehicles"):
        decode_batch(json.dumps(good).encode())


def test_fields_and_keys_of_a_later_version_are_left_out() -> None:
    later = json.loads(encode_batch(batch(row())))
    later["weather"] = {"wind_mps": 4}
    later["vehicles"][0] += [{"payload": "camera"}, 7]
    assert decode_batch(json.dumps(later).encode()) == batch(row())


def test_sizes_are_bounded() -> None:
    many = [row(name=f"v{i}") for i in range(state_batch.MAX_VEHICLES_OF_SITE + 1)]
    assert len(decode_batch(encode_batch(batch(*many[:-1]))).vehicles) == 300
    with pytest.raises(ValueError, match="vehicles"):
        decode_batch(encode_batch(batch(*many)))
    with pytest.raises(ValueError, match="bytes"):
        decode_batch(b" " * (state_batch.MAX_BATCH_BYTES + 1))
    longest = row(name="n" * 64, groups=["g" * 64] * 8, mode="m" * 32, type="t" * 32)
    whole = batch(*[longest._replace(name=f"{i:03}".ljust(64, "n")) for i in range(300)])
    assert len(encode_batch(whole)) < state_batch.MAX_BATCH_BYTES


def test_250_vehicles_are_one_message_of_less_than_64_kilobytes() -> None:
    assert len(encode_batch(batch(*[row(name=f"alpha{i}", sysid=i % 250 + 1) for i in range(250)]))) < 64_000


def test_ages_grow_and_what_has_none_has_none() -> None:
    later = aged(row(), 1.5)
    assert (later.age_s, later.position_age_s) == (1.92, 1.58)
    assert aged(row(position=None, last_heartbeat_age_s=None), 1.0).age_s is None
    assert replace(batch(later), seq=18).vehicles == (later,)


HOSTILE = (
    *("\x1b]0;mine\x07", "a\nb", "\x9b2J", "\u202eevil", "\u2028", "all", "7", "a,b"),
    *("a-b", "2-5", "a-2-3", "-2", "a-2\n", "a b", "a/b", ""),
)


@each("name", HOSTILE)
def test_a_name_that_no_fleet_file_may_have_is_refused(name: str) -> None:
    good = json.loads(encode_batch(batch(row())))
    good["vehicles"][0][0] = name
    with pytest.raises(ValueError) as error:
        decode_batch(json.dumps(good).encode())
    assert str(error.value).isprintable()
    assert row_from_state(STATE | {"name": name}) is None  # nor does a site send it


def test_a_batch_in_which_two_vehicles_have_one_name_is_refused() -> None:
    with pytest.raises(ValueError, match="two have one name"):
        decode_batch(encode_batch(batch(row(), row(sysid=2))))


@each("text", ["\x1b[2J", "\x7f", "\x9b", "\u202e", "a\nb"])
@each("ascii_only", [True, False])
def test_texts_of_another_site_are_printable(text: str, ascii_only: bool) -> None:
    good = json.loads(encode_batch(batch(row(control={"state": "flying"}))))
    for field in ("autopilot", "type", "mode", "landed", "gps_fix", "control"):
        good["vehicles"][0][VehicleRow._fields.index(field)] = text
    good["vehicles"][0][VehicleRow._fields.index("groups")] = [text]
    found = decode_batch(json.dumps(good | {"run": text}, ensure_ascii=ascii_only).encode())
    shown = found.vehicles[0]
    texts = (found.run, shown.autopilot, shown.type, shown.mode, shown.landed, shown.gps_fix, shown.control)
    assert all(one and one.isprintable() for one in (*texts, *shown.groups))


@each("number", ["1e999", "-1e999", "1" + 400 * "0", "NaN", "Infinity"])
def test_numbers_without_bounds_are_refused(number: str) -> None:
    encoded = encode_batch(batch(row())).decode()
    for known in ("1790000000.25", '"seq":17', "43.7806123"):
        assert known in encoded
        with pytest.raises(ValueError):
            decode_batch(encoded.replace(known, known.replace("17", number) if ":" in known else number).encode())


def test_the_second_autopilot_of_a_system_is_sent_by_the_name_that_the_daemon_gives_it() -> None:
    second = row_from_state(STATE | {"name": "alpha-191"})
    assert second is not None and decode_batch(encode_batch(batch(second))).vehicles == (second,)
