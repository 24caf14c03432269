"""Requests of DDS on their way to a handler, at a real participant of the loopback."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from skygcs.core.ros.interfaces import ros2_interfaces
from skygcs.ext.ros.dds import MOST_UNDER_WAY_S, SERVICE_HEADER, DdsNode, Network
from skygcs.ext.ros.fresh_node import FreshNode
from skygcs.ext.ros.late_gate import LateGate

NOW_NS = 1_700_000_000 * 10**9

ROWS = [(0.0, True), (MOST_UNDER_WAY_S - 0.1, True), (-3600.0, True), (MOST_UNDER_WAY_S + 0.1, False)]


async def test_a_request_that_was_long_under_way_orders_nothing_but_the_end_of_a_flight(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("CYCLONEDDS_URI", raising=False)
    handled: list[bool] = []
    logged: list[str] = []

    async def handle(request: dict[str, Any]) -> dict[str, Any]:
        handled.append(bool(request["value"]))
        return {"success": True}

    interfaces, type_ = ros2_interfaces("1.16"), "mavros_msgs/srv/CommandBool"
    node = DdsNode(Network(87, True, ()), interfaces, asyncio.get_running_loop(), lambda: NOW_NS)
    fresh = FreshNode(node, LateGate(lambda: True), lambda name, reason: logged.append(f"{name}: {reason}"))
    try:
        fresh.serve("/alpha/mavros/cmd/arming", type_, handle)
        service = node.services["/alpha/mavros/cmd/arming"]
        answers: list[bytes] = []
        service.replies.write_bytes = answers.append  # type: ignore[method-assign]
        for arm in (True, False):
            data = interfaces.encode(f"{type_}_Request", {"value": arm})
            for age_s, _ in ROWS:
                service._on_request(data[:4] + SERVICE_HEADER.pack(1, 1) + data[4:], NOW_NS - round(age_s * 1e9))
            await asyncio.sleep(0.01)
    finally:
        node.close()
    head = 4 + SERVICE_HEADER.size
    read = [interfaces.decode(f"{type_}_Response", answer[:4] + answer[head:]) for answer in answers]
    assert [answer["success"] for answer in read] == [asked for _, asked in ROWS] + [True] * len(ROWS)
    assert handled == [True] * 3 + [False] * 4
    assert len(logged) == 1 and "5.1 s ago" in logged[0]
