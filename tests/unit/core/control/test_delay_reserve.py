"""Whether gains bear the delay that attitude control is let fly with."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.control.analysis import Loop, margins, slowed, why_not_delay
from skygcs.core.control.gains import GRAVITY_MPS2, AxisGains, ControlConfig
from skygcs.core.control.guard import GuardConfig

SEED = ControlConfig()


def margin_s(gains: AxisGains, hover_thrust: float) -> float:
    found = margins(Loop(gains, GRAVITY_MPS2 / hover_thrust))
    assert found is not None
    return found.delay_margin_s


def test_default_gains_bear_the_delay_the_guard_lets_them_fly_with() -> None:
    assert why_not_delay(SEED, GuardConfig().attitude_delay_s) is None


def test_says_of_which_axis_by_how_much_and_what_to_do() -> None:
    assert why_not_delay(SEED, 0.11) == (
        "z: these gains are unstable from 0.213 s of delay on, and 2 times 0.11 s plus half a period (0.01 s) is "
        "0.230 s; allow at most 0.101 s of delay, or divide pos_p_per_s and vel_p by 1.08 and vel_i by its square"
    )
    both = why_not_delay(SEED, 0.3)
    assert both is not None
    assert both.startswith("xy: ") and "; z: " in both


def test_what_it_advises_helps() -> None:
    text = why_not_delay(SEED, 0.11) or ""
    allowed, factor = (float(n) for n in re.findall(r"at most ([\d.]+) s of delay, .* vel_p by ([\d.]+)", text)[0])
    assert why_not_delay(SEED, allowed) is None
    assert why_not_delay(SEED, allowed + 0.001) is not None
    assert why_not_delay(replace(SEED, z=slowed(SEED.z, factor)), 0.11) is None
    assert why_not_delay(replace(SEED, z=slowed(SEED.z, factor - 0.01)), 0.11) is not None


def test_a_slower_loop_bears_less() -> None:
    slow = replace(SEED, period_s=0.05)
    assert why_not_delay(slow, 0.1) is not None
    assert why_not_delay(slow, 0.094) is None
    assert (why_not_delay(replace(SEED, period_s=0.5), 0.0) or "").endswith("a faster loop, or slower gains")


def test_refuses_what_is_unstable_or_unknown() -> None:
    assert why_not_delay(replace(SEED, xy=AxisGains(0.0, 0.08, 0.02)), 0.0) == (
        "xy: these gains are unstable without any delay"
    )
    assert why_not_delay(replace(SEED, xy=AxisGains(0.95, 0.08, 0.02, vel_d=0.01)), 0.0) == (
        "xy: nobody knows which delay these gains bear: the analysis knows no derivative gain"
    )
    for none in (float("nan"), float("inf"), -0.1):
        with pytest.raises(ValueError, match="not possible"):
            why_not_delay(SEED, none)
    with pytest.raises(ValueError, match="reserve"):
        why_not_delay(SEED, 0.1, reserve=0.9)


@given(
    st.builds(AxisGains, st.floats(0.1, 3), st.floats(0.02, 1), st.just(0.0) | st.floats(1e-4, 0.1)),
    st.floats(0.2, 0.8),
    st.floats(0.0, 1.0),
)
def test_agrees_with_the_delay_margin_of_the_true_plant(gains: AxisGains, hover: float, delay_s: float) -> None:
    if margins(Loop(gains, GRAVITY_MPS2 / hover)) is None:
        return
    config = replace(SEED, xy=gains, z=gains, hover_thrust=hover)
    left_s = margin_s(gains, hover) - 2 * delay_s - 0.01
    if abs(left_s) > 1e-9:
        assert (why_not_delay(config, delay_s) is None) is (left_s > 0)


def test_does_without_numpy() -> None:
    code = (
        "import sys; from skygcs.core.control.analysis import why_not_delay; "
        "from skygcs.core.control.gains import ControlConfig; why_not_delay(ControlConfig(), 0.1); "
        "sys.exit('numpy' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
