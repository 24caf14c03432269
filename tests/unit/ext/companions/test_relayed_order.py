"""How long a relayed order is asked for."""

from __future__ import annotations

from skygcs.ext.companions.relayed_order import LEAST_REPEAT_S, MOST_REPEAT_S, RelayedOrder, unknown


def test_it_is_asked_again_after_a_round_trip_until_patience_is_over() -> None:
    order = RelayedOrder(1, "s", start_by=3.0, give_up_at=7.0)
    assert order.wait_s(0.0, 0.01) == LEAST_REPEAT_S
    assert order.wait_s(0.0, 1.6) == 2.0
    assert order.wait_s(0.0, None) == order.wait_s(0.0, 60.0) == MOST_REPEAT_S
    assert order.wait_s(6.9, 1.6) == 7.0 - 6.9
    assert order.wait_s(7.0, 0.01) is None


def test_an_unknown_outcome_says_so() -> None:
    outcome = unknown("no answer came", 7.0)
    assert not outcome.ok and "not known" in outcome.message and outcome.elapsed_s == 7.0
