"""The XBee benchmark measures what it says, on a small cell."""

from __future__ import annotations

from bench.xbee.cell import measure


def test_a_cell_with_skygcs_hears_all_and_loses_no_order() -> None:
    told = measure("skygcs", 2, settle_s=12.0, measure_s=10.0).as_dict()
    assert told["heard"] == 2
    assert 0 < told["age_p50_s"] <= told["age_p95_s"] < 2.5
    assert told["positions_per_vehicle_per_s"] < 2.5, "planned, not the four that an ArduCopter sends off a station"
    assert told["commands"] == 4 and told["lost_commands"] == 0


def test_the_script_reads_older_positions_than_the_network_brought() -> None:
    told = measure("plain", 3, settle_s=5.0, measure_s=10.0).as_dict()
    assert told["heard"] == 3
    assert told["commands"] > 0
    assert told["age_p95_s"] > 1.0, "forty packets stand before each that comes"
