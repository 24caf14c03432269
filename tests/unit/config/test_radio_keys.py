"""Keys of radios in the fleet file: what they come to, and what does not go together."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.loader import load_fleet
from skygcs.config.models import SerialLinkConfig
from skygcs.config.radio import radio_rates
from skygcs.core.radio_link.pacing import RadioRates
from skygcs.errors import ConfigError

SERIAL = '[links.r]\ntype = "serial"\ndevice = "/dev/ttyUSB0"\n'
SIMULATED = '[links.r]\ntype = "simulated"\nrole = "radio"\npx4 = 4\n'


def load(tmp_path: Path, text: str) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    load_fleet(path)


def test_the_keys_of_a_serial_link_are_the_rates_of_its_radio() -> None:
    link = SerialLinkConfig(device="/dev/x", air_speed_kbps=125, nodes=9, duty_cycle=0.5, uplink_share=0.8)
    assert radio_rates(link, 115200) == RadioRates(115200, 125, 9, 0.5, 0.8)


@pytest.mark.parametrize(
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


@pytest.mark.parametrize(
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
