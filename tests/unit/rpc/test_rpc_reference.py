"""docs/reference/rpc.md says what the methods say."""

from __future__ import annotations

from pathlib import Path

from skygcs.config.loader import MAX_LINK_CHARS
from skygcs.core.vehicle.targets import MAX_CHARS
from skygcs.rpc import client_peer, dispatch, sessions, work_gate
from skygcs.rpc.dispatch import MAX_MEMBERS
from skygcs.rpc.models import MAX_TEXT_CHARS
from skygcs.rpc.replies import MOST
from support.extension_parts import ALL_METHODS
from support.rpc_reference import reference, shared

PAGE = Path(__file__).parents[3] / "docs" / "reference" / "rpc.md"


def test_every_method_and_parameter_is_described_as_it_is() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert reference(ALL_METHODS.values()) in text
    assert all(f"{line}\n" in text for line in shared(ALL_METHODS.values()).values())


def test_the_limits_are_those_of_the_server() -> None:
    text = PAGE.read_text(encoding="utf-8")
    bounds = ", ".join(str(most) for _, most in MOST.values())
    for row in (
        f"| a line | {sessions.MAX_LINE_BYTES >> 20} MiB |",
        f"| lists and objects, keys, commas in a line, those in texts aside | {bounds} |",
        f"| requests in a batch | {sessions.MAX_BATCH} |",
        f"| characters of a text without a bound of its own, of all targets | {MAX_TEXT_CHARS}, {MAX_CHARS} |",
        f"| members of one parameter, characters of a link's description | {MAX_MEMBERS}, {MAX_LINK_CHARS} |",
        f"| clients | {sessions.MAX_SESSIONS} |",
        f"| connections beyond | {sessions.MAX_RESERVE} |",
        f"| TCP clients before authentication | {sessions.MAX_UNAUTHENTICATED} |",
        f"| pending requests of one client | {sessions.MAX_IN_FLIGHT} |",
        f"| orders to single vehicles that one client waits for | {work_gate.MAX_ITEMS_OF_A_CLIENT}, and one call |",
        f"| the same of all clients together | {work_gate.MAX_ITEMS}, and one call each |",
        f"| subscriptions of one client | {sessions.MAX_SUBSCRIPTIONS} |",
        f"| unread output of one client | {client_peer.MAX_OUTPUT_BYTES >> 20} MiB |",
    ):
        assert row in text


def test_every_error_code_is_explained() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for code in (-32700, -32600, -32601, -32602, -32603, *dispatch.ERRORS):
        assert f"| {code} |" in text


if __name__ == "__main__":
    print(reference(ALL_METHODS.values()))
