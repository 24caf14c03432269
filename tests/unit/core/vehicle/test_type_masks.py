"""Masks that follow from what is given: the values known to be right, and that the wrong ones cannot be made."""

from __future__ import annotations

import itertools

import pytest

from skygcs.core.vehicle.setpoint import ALL, ATTITUDE_AND_THRUST, NONE, position_target_mask
from support.table import each

AXES = list(itertools.product((False, True), repeat=3))


@each(
    ("given", "mask"),
    [
        ({"pos": ALL, "yaw": True}, 0x9F8),
        ({"pos": ALL}, 0xDF8),
        ({"vel": ALL}, 0xDC7),
        ({"acc": ALL}, 0xC3F),
        ({"pos": ALL, "vel": ALL, "acc": ALL, "yaw": True, "yaw_rate": True}, 0),
        ({"pos": (False, False, True), "vel": (True, True, False)}, 0b1101_1110_0011),
    ],
)
def test_a_mask_ignores_what_is_not_given(given: dict[str, object], mask: int) -> None:
    assert position_target_mask(**given) == mask  # type: ignore[arg-type]


def every_mask() -> dict[int, tuple[object, ...]]:
    made = {}
    for pos, vel, acc, yaw, rate in itertools.product(AXES, AXES, AXES, (False, True), (False, True)):
        if any((*pos, *vel, *acc)):
            made[position_target_mask(pos=pos, vel=vel, acc=acc, yaw=yaw, yaw_rate=rate)] = (pos, vel, acc, yaw, rate)
    return made


def test_the_masks_of_the_papers_script_mean_what_was_not_given() -> None:
    """0x4F8, "position": one digit short, yaw ignored and yaw rate flown. 0x5C0, "velocity": position 0, 0, 0 flown."""
    made = every_mask()
    _, _, _, yaw, rate = made[0x4F8]
    assert not yaw and rate, "only who gives a yaw rate gets it"
    pos, *_ = made[0x5C0]
    assert pos == ALL, "only who gives a position gets it"


def test_no_mask_turns_an_acceleration_into_a_force_or_sets_a_bit_beyond() -> None:
    assert all(mask & 0x200 == 0 and mask < 0x1000 for mask in every_mask())


def test_a_target_that_gives_nothing_is_none() -> None:
    with pytest.raises(ValueError, match="at least one"):
        position_target_mask(pos=NONE, yaw=True)


def test_an_attitude_ignores_all_three_rates_and_neither_attitude_nor_thrust() -> None:
    assert ATTITUDE_AND_THRUST == 0x07
