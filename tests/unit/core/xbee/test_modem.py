"""The module at our port: its window, what became of requests, and hostile answers."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from skygcs.core.xbee import api_frames as api
from skygcs.core.xbee.api_frames import ApiParser, FrameType
from skygcs.core.xbee.modem import ASK_S, LOST_AFTER_S, QUESTIONS, WINDOW, XBeeModem

NODE = 0x0013A20041A7B2C3


def opened(now: float = 0.0, payload_bytes: int = 256) -> XBeeModem:
    modem = XBeeModem(escaped=False)
    questions = ApiParser(bytes, escaped=False).feed(b"".join(modem.start(now)))
    assert [q[2:4].decode() for q in questions] == list(QUESTIONS)
    for question in questions:
        value = {"NP": payload_bytes.to_bytes(2, "big"), "AP": b"\1"}.get(question[2:4].decode(), b"\0\1")
        modem.feed(answer(question[1], question[2:4].decode(), value), now)
    assert modem.state == "open"
    modem.admit(NODE)
    return modem


def answer(frame_id: int, name: str, value: bytes, status: int = 0) -> bytes:
    data = bytes((FrameType.AT_RESPONSE, frame_id)) + name.encode() + bytes([status]) + value
    return api.encode(data, escaped=False)


def delivery(frame_id: int, status: int = 0, retries: int = 0) -> bytes:
    data = bytes((FrameType.TRANSMIT_STATUS, frame_id, 0xFF, 0xFE, retries, status, 0))
    return api.encode(data, escaped=False)


def received(address: int, payload: bytes) -> bytes:
    data = bytes([FrameType.RECEIVE_PACKET]) + address.to_bytes(8, "big") + b"\xff\xfe\x01" + payload
    return api.encode(data, escaped=False)


def frame_id_of(request: bytes) -> int:
    (data,) = ApiParser(bytes, escaped=False).feed(request)
    return data[1]


def test_nothing_is_given_to_a_module_before_it_answered_or_had_the_time() -> None:
    modem = XBeeModem(escaped=True)
    assert not modem.has_room()
    modem.start(10.0)
    assert not modem.has_room() and modem.next_expiry() == 10.0 + ASK_S
    assert modem.expire(10.0 + ASK_S) and modem.has_room()
    assert "API mode (AP=2)" in str(modem.why_mute())


def test_an_answer_that_comes_late_counts() -> None:
    modem = XBeeModem(escaped=False)
    modem.start(0.0)
    modem.expire(ASK_S)
    assert modem.payload_bytes == 72
    modem.feed(answer(1, "NP", b"\1\0"), ASK_S + 1.0)
    assert modem.payload_bytes == 256 and modem.why_mute() is None


def test_the_window_holds_and_a_status_makes_room() -> None:
    modem = opened()
    ids = [frame_id_of(modem.transmit(NODE, b"x", 0.0)) for _ in range(WINDOW)]
    assert not modem.has_room()
    modem.feed(delivery(ids[1], retries=2), 0.1)
    assert modem.has_room()
    node = modem.nodes[NODE]
    assert (node.sent, node.delivered, node.retries) == (WINDOW, 1, 2)
    modem.feed(delivery(ids[0], status=0x21), 0.2)
    assert (node.failed, node.last_failure) == (1, "no acknowledgement from the network")
    modem.feed(delivery(ids[0]), 0.3)
    assert modem.counters.unasked == 1


def test_a_status_that_never_comes_is_given_up() -> None:
    modem = opened()
    for n in range(WINDOW):
        modem.transmit(NODE, b"x", float(n) / 10)
    assert modem.next_expiry() == LOST_AFTER_S
    assert not modem.expire(LOST_AFTER_S - 0.01)
    assert modem.expire(LOST_AFTER_S) and modem.outstanding == WINDOW - 1
    assert modem.nodes[NODE].unknown == 1


def test_a_restarted_module_is_asked_again_and_forgets_what_it_had() -> None:
    modem = opened(payload_bytes=100)
    modem.transmit(NODE, b"x", 0.0)
    heard = modem.feed(api.encode(bytes((FrameType.MODEM_STATUS, 1)), escaped=False), 5.0)
    assert len(heard.questions) == len(QUESTIONS)
    assert (modem.state, modem.outstanding, modem.counters.restarts) == ("asking", 0, 1)


def test_the_wrong_api_mode_is_named() -> None:
    modem = XBeeModem(escaped=True)
    modem.start(0.0)
    modem.feed(api.encode(bytes((FrameType.AT_RESPONSE, 4)) + b"AP\0\1", escaped=True), 0.0)
    assert modem.why_wrong_mode() == "the module's AP is 1, this link's api_mode is 2: set one of them"


@given(
    data=st.lists(
        st.one_of(
            st.binary(max_size=60),
            st.builds(delivery, st.integers(0, 255), st.integers(0, 255), st.integers(0, 255)),
            st.builds(received, st.integers(0, 2**64 - 1), st.binary(max_size=20)),
            st.builds(answer, st.integers(0, 255), st.sampled_from(QUESTIONS), st.binary(max_size=12)),
        ),
        max_size=30,
    )
)
def test_any_input_leaves_a_module_that_can_be_used(data: list[bytes]) -> None:
    modem = XBeeModem(escaped=False)
    modem.start(0.0)
    for n, piece in enumerate(data):
        modem.feed(piece, n / 10)
        if modem.has_room():
            modem.transmit(NODE, b"x" * min(modem.payload_bytes, 9), n / 10)
        assert modem.outstanding <= WINDOW and 1 <= modem.payload_bytes <= 256
    modem.status()
    modem.on_silence(100.0)
    modem.expire(1000.0)
    assert modem.has_room()
