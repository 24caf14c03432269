"""Which of the announced ground stations a companion sends to."""

from __future__ import annotations

from skygcs.ext.companions.ground_choice import GROUND_SILENT_S, MAX_ADDRESSES, MAX_STATIONS, Candidate, GroundChoice
from support.table import each

NEVER = float("inf")


def test_the_one_that_is_heard_stays_whatever_else_is_announced() -> None:
    choice = GroundChoice()
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    assert choice.decide(0.0, NEVER) == Candidate("lab", "udp", "10.0.0.1", 14650)
    choice.found("aaa", "udp", ["10.0.0.66"], 14650)  # before it by name
    assert choice.decide(100.0, 1.0) == Candidate("lab", "udp", "10.0.0.1", 14650)
    choice.gone("lab")  # a false goodbye does not part them either
    assert choice.decide(101.0, 1.0) == Candidate("lab", "udp", "10.0.0.1", 14650)


def test_each_address_is_tried_for_a_while_until_one_is_heard() -> None:
    choice = GroundChoice()
    choice.found("a", "udp", ["10.0.0.1", "192.168.1.1"], 14650)
    choice.found("b", "tcp", ["10.0.0.2"], 5770)
    tried = []
    for step in range(4):
        found = choice.decide(step * GROUND_SILENT_S, NEVER)
        assert choice.decide(step * GROUND_SILENT_S + GROUND_SILENT_S / 2, NEVER) == found
        tried.append(None if found is None else found.host)
    assert tried == ["10.0.0.1", "192.168.1.1", "10.0.0.2", "10.0.0.1"]


def test_one_that_moves_is_followed_when_it_is_silent() -> None:
    choice = GroundChoice()
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    choice.decide(0.0, NEVER)
    choice.found("lab", "udp", ["10.0.0.9"], 14650)
    heard = choice.decide(60.0, 1.0)
    assert heard is not None and heard.host == "10.0.0.1"
    moved = choice.decide(70.0, 10.0)
    assert moved is not None and moved.host == "10.0.0.9"


def test_the_only_one_stays_although_it_is_silent() -> None:
    choice = GroundChoice()
    assert choice.decide(0.0, NEVER) is None
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    for now in (0.0, 100.0, 200.0):
        assert choice.decide(now, NEVER) is not None
    choice.gone("lab")
    assert choice.decide(300.0, NEVER) == Candidate("lab", "udp", "10.0.0.1", 14650)


def test_only_the_named_station_is_followed() -> None:
    choice = GroundChoice("lab")
    choice.found("other", "udp", ["10.0.0.66"], 14650)
    assert choice.decide(0.0, NEVER) is None
    choice.found("lab", "udp", ["10.0.0.1"], 14650)
    assert choice.decide(1.0, NEVER) is not None
    assert choice.ignored == 1


@each(
    ("transport", "hosts", "port"),
    [
        ("udp", [], 14650),
        ("udp", ["0.0.0.0"], 14650),
        ("udp", ["224.0.0.1", "::", "ff02::1"], 14650),
        ("udp", ["lab.example", "10.0.0"], 14650),
        ("quic", ["10.0.0.1"], 14650),
        ("udp", ["10.0.0.1"], 0),
        ("udp", ["10.0.0.1"], 65536),
    ],
)
def test_announcements_of_no_use_are_ignored(transport: str, hosts: list[str], port: int) -> None:
    choice = GroundChoice()
    choice.found("x", transport, hosts, port)
    assert (choice.candidates, choice.ignored) == ([], 1)


def test_a_flood_of_announcements_takes_no_memory() -> None:
    choice = GroundChoice()
    for number in range(MAX_STATIONS + 50):
        choice.found(f"s{number}", "udp", [f"10.0.{i}.1" for i in range(MAX_ADDRESSES + 20)], 14650)
    assert len(choice.candidates) == MAX_STATIONS * MAX_ADDRESSES
    assert choice.ignored == 50
    choice.found("s3", "udp", ["10.9.9.9"], 14650)  # a known one may change
    assert Candidate("s3", "udp", "10.9.9.9", 14650) in choice.candidates
