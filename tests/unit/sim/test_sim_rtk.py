"""A simulated vehicle's fix tells whether corrections reach it whole."""

from __future__ import annotations

from skygcs.core.radio_link.corrections import fragments_of
from skygcs.sim.rtk import BASE_S, CONVERGENCE_S, OBSERVATIONS_S, RtkReceiver
from support.rtcm import STANDARD_1005, rtcm_frame
from support.table import each

FIX_3D, FLOAT, FIXED = 3, 5, 6


def tell(receiver: RtkReceiver, message: bytes, now: float, sequence: int = 0, *, lost: int | None = None) -> None:
    for number, values in enumerate(fragments_of(message, sequence)):
        if number != lost:
            receiver.on_message(values, now)


@each("whole_messages", [True, False])
def test_the_base_and_its_observations_make_a_float_and_then_a_fixed_solution(whole_messages: bool) -> None:
    receiver = RtkReceiver(whole_messages=whole_messages)
    fixes = []
    for second in range(int(CONVERGENCE_S) + 3):
        now = float(second)
        tell(receiver, rtcm_frame(1077, epoch=second, body_bytes=500), now, second)
        if second == 1:
            tell(receiver, STANDARD_1005, now, 31)
        fixes.append(receiver.fix_type(now))
    assert fixes == [FIX_3D] + [FLOAT] * int(CONVERGENCE_S) + [FIXED] * 2
    assert receiver.types == {1005: 1, 1077: int(CONVERGENCE_S) + 3}


def test_a_solution_ends_without_observations_and_begins_anew_with_them() -> None:
    receiver = RtkReceiver(whole_messages=True)
    for now in (0.0, CONVERGENCE_S):
        tell(receiver, STANDARD_1005, now)
        tell(receiver, rtcm_frame(1077), now)
    end = CONVERGENCE_S + OBSERVATIONS_S
    assert [receiver.fix_type(now) for now in (CONVERGENCE_S, end, end + 0.1)] == [FIXED, FIXED, FIX_3D]
    tell(receiver, rtcm_frame(1087), end + 1)
    assert receiver.fix_type(end + 1) == FLOAT


def test_observations_alone_are_of_no_use() -> None:
    receiver = RtkReceiver(whole_messages=True)
    tell(receiver, STANDARD_1005, 0.0)
    fixes = []
    for second in range(int(BASE_S) + 2):
        tell(receiver, rtcm_frame(1077), float(second))
        fixes.append(receiver.fix_type(float(second)))
    assert fixes[-2:] == [FIXED, FIX_3D]


@each("whole_messages", [True, False])
@each("lost", [0, 1, 2])
def test_a_message_without_one_of_its_fragments_does_not_count(whole_messages: bool, lost: int) -> None:
    receiver = RtkReceiver(whole_messages=whole_messages)
    tell(receiver, rtcm_frame(1077, body_bytes=500), 0.0, 1, lost=lost)
    tell(receiver, rtcm_frame(1087, body_bytes=700), 0.0, 2)
    tell(receiver, rtcm_frame(1097, body_bytes=700), 0.0, 3)
    assert 1077 not in receiver.types
    assert receiver.types[1097] == 1
