"""The simulator against `skygcs.sim.behaviours`, flown as tests/firmware/test_0_behaviours.py flies real firmware."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

from skygcs.sim.behaviours import COPTER, PX4, Fact, Firmware
from support.behaviour_checks import CHECKS, fly
from support.behaviour_flights import get_ready
from support.behaviour_rig import SimRig
from support.behaviour_table import items
from support.examples import thinned
from support.table import each

FLIGHTS = [
    (firmware, name)
    for number, name in enumerate(CHECKS)
    for firmware in (("px4", "ardupilot") if number % 2 else ("ardupilot", "px4"))
]


@each(("firmware", "name"), thinned(FLIGHTS, len(CHECKS)))
def test_the_simulator_does_what_the_table_says(firmware: str, name: str) -> None:
    rig = SimRig(firmware)
    get_ready(rig, 20.0)
    figures, problems = fly(name, rig)
    assert not problems, figures


@each(
    ("firmware", "name"),
    [("ardupilot", "circle"), ("px4", "position and velocity"), ("ardupilot", "velocity then silence")],
)
def test_a_vehicle_slower_than_real_time_is_measured_by_its_own_clock(firmware: str, name: str) -> None:
    """As a firmware's simulator is on a busy machine: it loses time for good."""
    rig = SimRig(firmware, rate=0.7)
    get_ready(rig, 30.0)
    figures, problems = fly(name, rig)
    assert not problems, figures


@each("firmware", [PX4, COPTER], ids=["px4", "ardupilot"])
def test_every_value_names_its_source(firmware: Firmware) -> None:
    for field in fields(firmware):
        fact = getattr(firmware, field.name)
        if field.name in ("name", "version"):
            continue
        assert isinstance(fact, Fact)
        path = fact.source.split(":")[0].split(" ")[0]
        assert path.endswith((".cpp", ".h", ".hpp", ".c", ".yaml")), f"{field.name}: {fact.source}"
        assert fact.used is None or fact.why, f"{field.name} differs without a reason"


def test_the_page_of_the_table_is_up_to_date() -> None:
    page = Path(__file__).parents[3] / "docs" / "reference" / "simulated-firmware.md"
    assert items() in page.read_text(encoding="utf-8"), "PYTHONPATH=tests python -m support.behaviour_table"
