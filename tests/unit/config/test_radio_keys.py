"""Keys of radios in the fleet file: what they come to, and what does not go together."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.loader import load_fleet, parse_link
from skygcs.config.models import SerialLinkConfig
from skygcs.config.radio import radio_rates
from skygcs.core.radio_link.capacity import RadioRates
from skygcs.core.radio_link.pacing import Pacer
from skygcs.errors import ConfigError
from support.table import each

SERIAL = '[links.r]\ntype = "serial"\ndevice = "/dev/ttyUSB0"\n'
SIMULATED = '[links.r]\ntype = "simulated"\nrole = "radio"\npx4 = 4\n'


def load(tmp_path: Path, text: str) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    load_fleet(path)


def test_the_keys_of_a_serial_link_are_the_rates_of_its_radio() -> None:
    link = SerialLinkConfig(device="/dev/x", air_speed_kbps=125, nodes=9, duty_cycle=0.5, uplink_share=0.8)
    assert radio_rates(link, 115200) == RadioRates(115200, 125, 9, 0.5, 0.8)


@each(
    "text",
    [
        SERIAL + 'role = "radio"\nair_speed_kbps = 64\nnodes = 16\nduty_cycle = 0.1\n',
        SERIAL,
        SIMULATED + "radio = { nodes = 5, distances_m = [10, 20, 30, 40] }",
        SIMULATED + 'stream_profile = "monitor"\ndownlink_share = 0.3\nradio = {}',
        SIMULATED + '[links.r.third_party]\nlogs = "allow"\nrates = { TIMESYNC = 0.5, 110 = 0 }\nbytes_per_s = 100',
    ],
)
def test_what_goes_together_is_accepted(tmp_path: Path, text: str) -> None:
    load(tmp_path, text)


@each(
    ("text", "complaint"),
    [
        (
            SERIAL + "air_speed_kbps = 64",
            'air_speed_kbps (line 4): has an effect only with role = "radio"; the role is "peer"',
        ),
        (
            SERIAL + 'role = "gcs"\nstream_profile = "nav"',
            'stream_profile (line 5): has an effect only with role = "radio"',
        ),
        (SERIAL + 'role = "radio"\nduty_cycle = 0', "duty_cycle"),
        (SERIAL + 'role = "radio"\nnodes = 1', "nodes"),
        (SERIAL + 'role = "radio"\nstream_profile = "fast"', "stream_profile"),
        (SIMULATED + "radio = { nodes = 3 }", "3 nodes are too few for 4 vehicles and the ground"),
        (SIMULATED + "radio = { distances_m = [1, 2, 3, 4, 5] }", "5 distances are too many for 4 vehicles"),
        (SIMULATED + "radio = { loss = 1.0 }", "loss"),
        (
            SERIAL + '[links.r.third_party]\nlogs = "deny"',
            'third_party (line 4): has an effect only with role = "radio"',
        ),
        (SIMULATED + '[links.r.third_party]\nparam_lists = "two"', "param_lists"),
        (
            SERIAL + 'role = "radio"\n[links.r.foreign]\nlogs = "deny"',
            "foreign (line 5): is called third_party now: rename the key",
        ),
        (SIMULATED + "[links.r.third_party]\nrates = { TIMESYNK = 1 }", "did you mean TIMESYNC?"),
        (SIMULATED + "[links.r.third_party]\nrates = { TIMESYNC = -1 }", "TIMESYNC"),
        (SIMULATED + "[links.r.third_party]\nbytes_per_s = 0", "bytes_per_s"),
        (SIMULATED + "radio = { speed = 64 }", "speed"),
    ],
)
def test_what_does_not_is_named_with_its_key(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ConfigError) as refused:
        load(tmp_path, text)
    (problem,) = refused.value.problems
    assert complaint in problem


RADIO = SERIAL + 'role = "radio"\n'
TIMING = """
kind = "radio timing"
version = 1
[[measurement]]
date = "2026-11-28T10:00:00+00:00"
banner = "RFD SiK 3.00MP"
multipoint = true
air_speed_kbps = 64
slot_s = 0.1
sync_s = 0.03
slot_bytes = 480.0
"""


def test_a_timing_file_takes_the_place_of_assumed_timeslots(tmp_path: Path) -> None:
    (tmp_path / "timing.toml").write_text(TIMING)
    (tmp_path / "fleet.toml").write_text(RADIO + 'air_speed_kbps = 64\nnodes = 5\ntiming_file = "timing.toml"\n')
    link = load_fleet(tmp_path / "fleet.toml").links["r"]
    assert isinstance(link, SerialLinkConfig) and link.timing_file == tmp_path / "timing.toml"
    rates = radio_rates(link, 57600)
    assert rates.round_s(2) == pytest.approx(0.53)
    assert rates.base_bytes_per_s(2) == pytest.approx(0.9 * 480 / 0.53)
    pacer = Pacer(rates)
    assert pacer.status(0.0)["timing"] == "measured on 2026-11-28 with RFD SiK 3.00MP"
    # the file was removed while the radio was unplugged
    (tmp_path / "timing.toml").unlink()
    assert Pacer(radio_rates(link, 57600)).status(0.0)["timing"] == "assumed, as open SiK multipoint"


@each(
    ("keys", "content", "complaint"),
    [
        ("", TIMING, "timing_file (line 5): needs air_speed_kbps"),
        ("air_speed_kbps = 125", TIMING, "was measured at AIR_SPEED 64, and air_speed_kbps is 125: correct"),
        ("air_speed_kbps = 64", None, "cannot be read: No such file"),
        ("air_speed_kbps = 64", "x = 1", 'kind must be "radio timing"'),
        ("air_speed_kbps = 64", "x = ", "not a timing file"),
        ("air_speed_kbps = 64", "\0\xff", "not a timing file"),
        ("air_speed_kbps = 64", "x = " + "[" * 5000, "not a timing file"),
        ("air_speed_kbps = 64", "#" * 300_000, "longer than"),
        ("air_speed_kbps = 64", 'kind = "radio timing"\nversion = 1', "at least one table [[measurement]]"),
        ("air_speed_kbps = 64", TIMING.replace("0.1", "-1"), "measurement[0].slot_s: must be between"),
        ("air_speed_kbps = 64", TIMING.replace("0.1", "nan"), "measurement[0].slot_s: must be a number"),
        ("air_speed_kbps = 64", TIMING.replace("480.0", "true"), "measurement[0].slot_bytes: must be a number"),
        ("air_speed_kbps = 64", TIMING.replace("480.0", "[1]"), "measurement[0].slot_bytes: must be a number"),
        ("air_speed_kbps = 64", TIMING.replace("= true", "= false"), "radios that are not multipoint"),
        ("air_speed_kbps = 64", TIMING + TIMING[TIMING.index("[[") :], "64 is there twice"),
    ],
)
def test_a_timing_file_that_the_link_cannot_use_is_named_with_what_to_do(
    tmp_path: Path, keys: str, content: str | None, complaint: str
) -> None:
    if content is not None:
        (tmp_path / "timing.toml").write_text(content, encoding="latin-1")
    with pytest.raises(ConfigError) as refused:
        load(tmp_path, RADIO + f'timing_file = "timing.toml"\n{keys}\n')
    (problem,) = refused.value.problems
    assert complaint in problem and "links.r.timing_file (line 5)" in problem


def test_a_link_added_at_run_time_is_checked_as_well(tmp_path: Path) -> None:
    table = {"type": "serial", "device": "/dev/x", "role": "radio", "air_speed_kbps": 64}
    with pytest.raises(ConfigError, match="timing_file"):
        parse_link("r", {**table, "timing_file": str(tmp_path / "none.toml")})
    (tmp_path / "timing.toml").write_text(TIMING)
    parse_link("r", {**table, "timing_file": str(tmp_path / "timing.toml")})
