"""Places that a person cannot mean, and a latitude and longitude that were swapped."""

from __future__ import annotations

from skygcs.core.reach import swapped_hint

ASKED = "; did you swap latitude and longitude?"


def test_the_swap_is_asked_for_where_it_fits_and_only_there() -> None:
    here = (43.78, -79.46)
    assert swapped_hint(-79.46, 43.78, here, 1000.0) == ASKED
    assert swapped_hint(43.78, -79.47, here, 1000.0) == "", "near as it is"
    assert swapped_hint(10.0, 20.0, here, 1000.0) == "", "far both ways"
    assert swapped_hint(120.0, 45.0, (45.0, 120.0), 1000.0) == ASKED, "no place on earth as it is"
    assert swapped_hint(120.0, 45.0, None, 0.0) == ASKED and swapped_hint(45.0, 120.0, None, 0.0) == ""
    assert swapped_hint(float("nan"), 45.0, here, 1000.0) == ""
