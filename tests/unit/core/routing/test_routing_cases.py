"""The 22 checkable routing cases that peer routers were measured with, byte for byte through parser and router."""

from __future__ import annotations

from fastcrc.crc16 import mcrf4xx

from skygcs.core.mavlink.frame import encode_payload
from support.routed import DIALECT, RoutedNet, five_ports, heartbeat, message
from support.table import each


def command(target: int, component: int, sysid: int = 250, compid: int = 190, seq: int = 1) -> bytes:
    return message(
        "COMMAND_LONG", sysid, compid, seq, target_system=target, target_component=component, command=400, param1=1.0
    )


def crc_of(body: bytes) -> bytes:
    info = DIALECT.messages[body[7] | body[8] << 8 | body[9] << 16]
    return mcrf4xx(bytes(body[1:]) + info.crc_extra_byte).to_bytes(2, "little")


def signed(raw: bytes) -> bytes:
    """A frame with the signature flag, its CRC made right again, and 13 bytes nobody here can check."""
    body = raw[:2] + b"\1" + raw[3:-2]
    return body + crc_of(body) + bytes(range(13))


def unknown_frame(sysid: int, compid: int) -> bytes:
    """A frame whose id no dialect here knows; its CRC is arbitrary."""
    return bytes((0xFD, 4, 0, 0, 9, sysid, compid, 0x40, 0xEE, 0x02)) + b"abcd" + b"\x12\x34"


ATTITUDE = message("ATTITUDE", 1, seq=5, roll=0.5)


@each(
    ("case", "port", "frame", "expected"),
    [
        ("01 broadcast without target", "V0", heartbeat(1, seq=1), {"V1", "V2", "G0", "G1"}),
        ("02 target_system 0 from a GCS", "G0", command(0, 0), {"V0", "V1", "V2", "G1"}),
        ("03 target 2/1", "G0", command(2, 1), {"V1"}),
        ("04 target 2/0", "G0", command(2, 0), {"V1"}),
        ("05 unknown system 99", "G0", command(99, 1), set()),
        ("06 known system, unknown component", "G0", command(2, 77), {"V1"}),
        ("07 second component on the same channel", "G0", command(1, 100), {"V0"}),
        ("08 addressee on the incoming channel", "V0", command(1, 100, sysid=1, compid=1), set()),
        (
            "09 ack to the GCS that asked",
            "V1",
            message("COMMAND_ACK", 2, 1, 1, command=400, target_system=250, target_component=190),
            {"G0"},
        ),
        ("10 unknown message id of a verified source", "V0", unknown_frame(1, 1), {"V1", "V2", "G0", "G1"}),
        ("11 signed frame", "V0", signed(ATTITUDE), {"V1", "V2", "G0", "G1"}),
        ("12 MAVLink 1", "V0", heartbeat(1, seq=2, version=1), {"V1", "V2", "G0", "G1"}),
        ("13 vehicle to vehicle, targeted", "V0", command(3, 1, sysid=1, compid=1), {"V2"}),
        ("14 known id with a wrong CRC", "V0", ATTITUDE[:-1] + bytes((ATTITUDE[-1] ^ 1,)), set()),
        ("19 zero-trimmed target component", "G0", message("PARAM_REQUEST_LIST", 250, 190, 3, target_system=2), {"V1"}),
        (
            "20 zero-trimmed target system is broadcast",
            "G0",
            message("PARAM_REQUEST_LIST", 250, 190, 4),
            {"V0", "V1", "V2", "G1"},
        ),
    ],
)
def test_one_frame_reaches_exactly_these_channels(case: str, port: str, frame: bytes, expected: set[str]) -> None:
    net = five_ports()
    net.datagram(port, frame)
    assert net.reached() == expected, case
    assert all(got == [frame] for got in net.got.values()), "forwarded bytes are the received bytes"


def attitudes(count: int) -> list[bytes]:
    return [message("ATTITUDE", 1, seq=n, roll=n * 0.01, yawspeed=0.5) for n in range(count)]


@each("count", [5, 33])
def test_case_15_and_16_every_frame_of_a_datagram_is_forwarded(count: int) -> None:
    net = five_ports()
    net.datagram("V0", b"".join(attitudes(count)))
    assert net.got["G0"] == net.got["G1"] == attitudes(count)


def test_case_17_a_corrupt_length_byte_does_not_cost_the_good_frames_behind_it() -> None:
    first, *good = attitudes(7)
    data = first[:1] + bytes((200,)) + first[2:] + b"".join(good)
    datagram, stream = five_ports(), five_ports()
    datagram.datagram("V0", data)
    stream.stream("V0", data)
    stream.silence("V0")
    assert datagram.got["G0"] == stream.got["G0"] == good


def test_case_18_a_truncated_datagram_does_not_eat_the_following_ones() -> None:
    net = five_ports()
    first, *good = attitudes(4)
    for data in (first[:20], *good):
        net.datagram("V0", data)
    assert net.got["G0"] == good


def test_case_21_a_system_seen_on_a_second_channel_is_reached_there() -> None:
    net = five_ports()
    net.datagram("V1", message("HEARTBEAT", 1, 1, 77, type=2, autopilot=3, mavlink_version=3, custom_mode=4))
    net.clear()
    net.datagram("G0", command(1, 1))
    assert {"V1"} <= net.reached() <= {"V0", "V1"}


def test_case_22_twenty_vehicles_on_one_port_get_only_their_own_commands() -> None:
    """Every UDP peer is a channel of its own, whatever port it shares."""
    net = RoutedNet()
    net.open("G0")
    for sysid in range(1, 21):
        net.open(f"peer{sysid}")
        net.datagram(f"peer{sysid}", heartbeat(sysid))
    net.clear()
    for sysid in range(1, 21):
        net.clear()
        net.datagram("G0", command(sysid, 1, seq=sysid))
        assert net.reached() == {f"peer{sysid}"}


def test_an_untrimmed_payload_stays_untrimmed() -> None:
    """PARAM_REQUEST_LIST 2/0 with its zero byte on the wire: both encodings are forwarded as they are."""
    net = five_ports()
    info = DIALECT.find("PARAM_REQUEST_LIST")
    trimmed = encode_payload(info, info.pack({"target_system": 2}), sysid=250, compid=190, seq=9)
    body = trimmed[:1] + bytes((trimmed[1] + 1,)) + trimmed[2:-2] + b"\0"
    untrimmed = body + crc_of(body)
    net.datagram("G0", untrimmed)
    assert net.got == {"V1": [untrimmed]}
