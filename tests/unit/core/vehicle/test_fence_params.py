"""The fence that parameters make, and the words in which autopilots tell of a breach."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.vehicle import fence_params
from skygcs.core.vehicle.message_cache import WATCHED
from skygcs.errors import RefusedError
from support.table import each

PX4 = {"GF_MAX_HOR_DIST": 0.0, "GF_MAX_VER_DIST": 0.0, "GF_ACTION": 0.0}
COPTER = {"FENCE_RADIUS": 300.0, "FENCE_ALT_MAX": 100.0, "FENCE_ACTION": 1.0, "FENCE_TYPE": 4.0, "FENCE_ENABLE": 0.0}
HELD = {"px4": PX4, "ardupilot": COPTER}

sizes = st.none() | st.just(0.0) | st.floats(1, 1000)


@given(
    family=st.sampled_from(["px4", "ardupilot"]),
    radius_m=sizes,
    height_m=sizes,
    action=st.sampled_from(fence_params.ACTIONS),
)
def test_what_is_set_is_what_is_told_afterwards(
    family: str, radius_m: float | None, height_m: float | None, action: str
) -> None:
    held = HELD[family]
    if family == "ardupilot" and action == "terminate":
        with pytest.raises(RefusedError, match="no fence action"):
            fence_params.changes(family, held, radius_m=radius_m, height_m=height_m, action=action)
        return
    changed = fence_params.changes(family, held, radius_m=radius_m, height_m=height_m, action=action)
    assert set(changed) <= set(fence_params.NAMES[family])
    now = fence_params.settings_of(family, {**held, **changed})
    assert now.enabled is (action != "none")
    if not now.enabled:
        assert str(now) == "off"
        return
    assert now.action == action
    assert (now.radius_m, now.height_m) == (radius_m or None, height_m or None)
    assert now.follows_list, "the polygons that were watched still are"


def test_what_is_not_given_stays() -> None:
    held = {**COPTER, "FENCE_TYPE": 7.0, "FENCE_ENABLE": 1.0}
    assert fence_params.changes("ardupilot", held, radius_m=None, height_m=9.0, action=None) == {
        "FENCE_ALT_MAX": 9.0,
        "FENCE_TYPE": 7.0,
        "FENCE_ENABLE": 1.0,
    }
    assert fence_params.changes("px4", PX4, radius_m=5.0, height_m=None, action=None) == {"GF_MAX_HOR_DIST": 5.0}


def test_a_fence_is_switched_on_last_and_off_first() -> None:
    changed = fence_params.changes("ardupilot", COPTER, radius_m=2.0, height_m=0.0, action="return")
    assert list(changed)[-1] == "FENCE_ENABLE"
    back = fence_params.back_to("ardupilot", COPTER, changed)
    assert next(iter(back)) == "FENCE_ENABLE" and {**changed, **back}.items() <= COPTER.items()
    assert all(changed[name] != COPTER[name] for name in back), "what was not changed is not put back"


@each(
    ("text", "reported"),
    [
        ("Geofence violation: exceeding maximum distance to Home", True),
        ("Geofence violation: approaching or outside geofence", True),
        ("Circle fence breached", True),
        ("Max Alt fence breached", True),
        ("PreArm: Vehicle breaching Circle fence", True),
        ("Fence breach cleared", False),
        ("Reposition is outside geofence", False),
        ("Fence received", False),
        ("Failsafe activated: entering Hold for 5 seconds", False),
    ],
)
def test_a_breach_is_known_by_the_words_of_either_autopilot(text: str, reported: bool) -> None:
    assert fence_params.reports_breach(text) is reported


def test_what_the_ceiling_is_known_by_is_kept() -> None:
    assert {name for names in fence_params.NAMES.values() for name in names} <= WATCHED
