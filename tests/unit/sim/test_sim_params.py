"""Parameters of a simulated vehicle in both encodings, and its seeded chance and battery."""

from __future__ import annotations

import struct

import pytest

from skygcs.sim.battery import Battery
from skygcs.sim.param_table import Param, Params
from skygcs.sim.rng import Rng
from support.table import each

INT32, INT8, FLOAT = 6, 2, 9


def make(bytewise: bool) -> Params:
    return Params(
        [Param("B_INT", 7, INT32), Param("A_FLOAT", 2.5, FLOAT), Param("C_BYTE", -3, INT8)], bytewise=bytewise
    )


def as_float(value: int) -> float:
    result: float = struct.unpack("<f", struct.pack("<i", value))[0]
    return result


def test_px4_sends_an_integers_bytes_and_ardupilot_its_value() -> None:
    found = make(True).find("B_INT")
    assert found is not None
    assert make(True).encode(found[1]) == as_float(7)
    assert make(False).encode(found[1]) == 7


@each("bytewise", [True, False])
def test_what_is_set_is_what_is_read(bytewise: bool) -> None:
    params = make(bytewise)
    for name, value in (("B_INT", -123456), ("C_BYTE", 100), ("A_FLOAT", -0.25)):
        wire = as_float(int(value)) if bytewise and name != "A_FLOAT" else value
        param = params.set(name, wire)
        assert param is not None and params[name] == value
        assert struct.pack("<f", params.encode(param)) == struct.pack("<f", wire)


@each("bad", [float("nan"), float("inf"), 300.0])
def test_a_value_the_type_cannot_hold_changes_nothing(bad: float) -> None:
    params = make(False)
    assert params.set("C_BYTE", bad) is not None
    assert params["C_BYTE"] == -3


def test_an_unknown_name_is_not_made_up() -> None:
    params = make(True)
    assert params.set("NOPE", 1.0) is None
    assert params.find("NOPE") is None
    assert params.at(3) is None and params.at(-1) is None


def test_indices_follow_the_alphabet() -> None:
    params = make(True)
    assert [params.at(i).name for i in range(len(params))] == ["A_FLOAT", "B_INT", "C_BYTE"]  # type: ignore[union-attr]


def test_the_same_seed_gives_the_same_numbers_and_another_others() -> None:
    def draw(seed: int) -> list[float]:
        rng = Rng(seed)
        return [rng.random() for _ in range(5)]

    assert draw(7) == draw(7)
    assert draw(7) != draw(8)
    assert draw(0) != draw(1)


def test_probabilities_are_kept() -> None:
    rng = Rng(42)
    values = [rng.random() for _ in range(20_000)]
    assert all(0 <= v < 1 for v in values)
    for decile in range(10):
        assert sum(decile / 10 <= v < (decile + 1) / 10 for v in values) == pytest.approx(2000, abs=200)
    assert sum(rng.happens(0.3) for _ in range(10_000)) == pytest.approx(3000, abs=200)
    assert not any(rng.happens(0.0) for _ in range(100))


def test_a_battery_lasts_about_twenty_minutes_of_hover_and_its_voltage_falls() -> None:
    battery = Battery()
    full = battery.volts
    minutes = 0
    while battery.percent > 0 and minutes < 100:
        battery.step(60.0, flying=True)
        minutes += 1
    assert 15 <= minutes <= 25
    assert battery.volts < full - 3
    battery.set_percent(42)
    assert battery.percent == 42
