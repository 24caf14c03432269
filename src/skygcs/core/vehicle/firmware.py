"""Firmware versions, from AUTOPILOT_VERSION and from ArduPilot's banner text."""

from __future__ import annotations

import re

_STAGES = ((255, ""), (192, "-rc"), (128, "-beta"), (64, "-alpha"), (0, "-dev"))
"""FIRMWARE_VERSION_TYPE, lowest value of each."""

_BANNER = re.compile(
    r"^(Ardu\w+|AP\w+(?::\w+)?|Blimp|Rover|AntennaTracker) V(\d+\.\d+\.\d+(?:-?[a-z]+\d*)?)\b", re.ASCII
)


def firmware_from_version(flight_sw_version: int) -> str | None:
    """``4.5.1``, ``1.16.0-rc2``; None for 0, which is "unknown"."""
    if not flight_sw_version:
        return None
    major, minor, patch = flight_sw_version >> 24 & 0xFF, flight_sw_version >> 16 & 0xFF, flight_sw_version >> 8 & 0xFF
    kind = flight_sw_version & 0xFF
    least, stage = next((low, name) for low, name in _STAGES if kind >= low)
    number = str(kind - least) if stage and kind > least else ""
    return f"{major}.{minor}.{patch}{stage}{number}"


def firmware_from_banner(text: str) -> str | None:
    """The version in ``ArduCopter V4.5.1 (f4a2dcba)``; None if the text is not a banner."""
    match = _BANNER.match(text)
    return match[2] if match else None


def banner_program(text: str) -> str | None:
    """The program in a banner, as it names itself: "ArduCopter"; None if the text is not a banner."""
    match = _BANNER.match(text)
    return match[1] if match else None
