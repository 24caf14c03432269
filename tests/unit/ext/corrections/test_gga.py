"""GGA sentences against pynmeagps, and the vehicle whose position they are."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from pynmeagps import NMEAReader

from skygcs.ext.corrections.gga import GgaPosition, chosen_place, gga_sentence
from support.table import each


@given(
    lat=st.floats(-90, 90),
    lon=st.floats(-180, 180),
    alt=st.floats(-400, 9000),
    utc_s=st.floats(0, 2**32),
    satellites=st.integers(0, 200),
)
@example(lat=-0.9999999999, lon=179.9999999999, alt=0.0, utc_s=86399.999, satellites=0)
@example(lat=59.99999999999, lon=-1e-12, alt=-0.001, utc_s=0.0, satellites=12)
def test_an_independent_parser_reads_the_place(
    lat: float, lon: float, alt: float, utc_s: float, satellites: int
) -> None:
    raw = gga_sentence(GgaPosition("a", lat, lon, alt, satellites), utc_s)
    parsed: Any = NMEAReader.parse(raw)  # it checks the checksum
    assert parsed.msgID == "GGA"
    assert (float(parsed.lat), float(parsed.lon)) == pytest.approx((lat, lon), abs=2e-8)
    assert parsed.alt == pytest.approx(alt, abs=0.006)
    assert parsed.quality == 1 and 4 <= parsed.numSV <= 99
    second = int(utc_s) % 86400
    assert (parsed.time.hour, parsed.time.minute, parsed.time.second) == (
        second // 3600,
        second // 60 % 60,
        second % 60,
    )
    assert len(raw) <= 84


def fix(fix: str | None = "3d", lat: float | None = 1.0, **more: Any) -> dict[str, Any]:
    return {"fix": fix, "lat_deg": lat, "lon_deg": 2.0, "alt_amsl_m": 3.0, "satellites": 9, **more}


def test_the_first_with_a_fix_is_taken_and_stays() -> None:
    fixes = [("alpha", fix("none")), ("bravo", fix()), ("charlie", fix("rtk_fixed"))]
    assert chosen_place(fixes) == GgaPosition("bravo", 1.0, 2.0, 3.0, 9)
    assert chosen_place(fixes, last="charlie") == GgaPosition("charlie", 1.0, 2.0, 3.0, 9)
    fixes[0] = ("alpha", fix())
    assert chosen_place(fixes, last="bravo") == GgaPosition("bravo", 1.0, 2.0, 3.0, 9)
    fixes[1] = ("bravo", fix("2d"))
    assert chosen_place(fixes, last="bravo") == GgaPosition("alpha", 1.0, 2.0, 3.0, 9)


def test_a_vehicle_that_was_chosen_is_the_only_one() -> None:
    fixes = [("alpha", fix()), ("bravo", fix("none"))]
    assert chosen_place(fixes, only="bravo") is None
    assert chosen_place(fixes, only="alpha") == GgaPosition("alpha", 1.0, 2.0, 3.0, 9)


@each("gps", [{}, fix(None), fix("2d"), fix(lat=None), fix(lat=float("nan")), fix(lat=91.0), fix(lon_deg=None)])
def test_what_is_no_position_is_not_sent(gps: dict[str, Any]) -> None:
    assert chosen_place([("alpha", gps)]) is None


def test_a_place_without_height_or_satellites() -> None:
    assert chosen_place([("a", fix(alt_amsl_m=None, satellites=None))]) == GgaPosition("a", 1.0, 2.0, 0.0, 12)
