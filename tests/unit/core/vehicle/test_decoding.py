from __future__ import annotations

from skygcs.core.vehicle.decoding import firmware_from_banner, firmware_from_version
from support.table import each


@each(
    ("number", "text"),
    [
        (0x040501FF, "4.5.1"),
        (0x011000FF, "1.16.0"),
        (0x04070000, "4.7.0-dev"),
        (0x010E0042, "1.14.0-alpha2"),
        (0x01100080, "1.16.0-beta"),
        (0x040600C1, "4.6.0-rc1"),
        (0, None),
    ],
)
def test_versions_read_as_their_makers_write_them(number: int, text: str | None) -> None:
    assert firmware_from_version(number) == text


@each(
    ("banner", "text"),
    [
        ("ArduCopter V4.5.1 (f4a2dcba)", "4.5.1"),
        ("ArduPlane V4.5.5 (abc)", "4.5.5"),
        ("APM:Copter V3.3.3 (acf75d25)", "3.3.3"),
        ("ArduCopter V4.7.0-dev (12345678)", "4.7.0-dev"),
        ("ChibiOS: 6a85082c", None),
        ("EKF3 IMU0 is using GPS", None),
        ("my ArduCopter V4.5.1", None),
    ],
)
def test_ardupilots_banner_tells_the_version(banner: str, text: str | None) -> None:
    assert firmware_from_banner(banner) == text
