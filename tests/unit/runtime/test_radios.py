"""What radios need is made with the first of them, and knows what was asked before."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.config.models import FleetConfig
from skygcs.runtime.air_planner import AirPlanner
from skygcs.runtime.radios import Radios
from support.frames import dialect


def test_a_selection_of_before_the_first_radio_counts_when_it_opens(monkeypatch: pytest.MonkeyPatch) -> None:
    planned: list[set[int]] = []
    monkeypatch.setattr(AirPlanner, "tick", lambda planner, now: planned.append(planner.selected))
    wire = SimpleNamespace(air=None, link=SimpleNamespace(shares_air=False))
    hub: Any = SimpleNamespace(channels={1: wire}, dialect=dialect())
    fleet: Any = SimpleNamespace(vehicles={})
    watch: Any = None
    radios = Radios(FleetConfig(), hub, fleet, watch, lambda event: None)
    radios.select({257})
    radios.tick(0.0)
    radios.step(0.1)
    assert (planned, radios.status(0.1), radios.radios(0.1)) == ([], [], [])
    hub.channels[2] = SimpleNamespace(air=None, link=SimpleNamespace(shares_air=True))
    radios.tick(1.0)
    radios.select({258})
    del hub.channels[2]
    radios.tick(2.0)
    assert planned == [{257}, {258}], "it goes on after the radio has gone: its vehicles leave the plan"
