"""The table while no vehicle was heard: each link, what came through it, and the next step."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from support.page_steps import fits
from support.process import ROOT, free_port
from support.web_station import WebStation

LINKS = """
[links.cable]
type = "serial"
device = "/dev/skygcs-no-such-port"

[links.radio]
type = "serial"
device = "{pty}"
baud = 57600

[links.wifi]
type = "udp_server"
host = "127.0.0.1"
port = {port}

[links.tablet]
type = "udp_client"
host = "127.0.0.1"
port = 9
role = "gcs"
"""


@pytest.fixture(scope="module")
def silent(make_station: Callable[..., WebStation]) -> Iterator[WebStation]:
    near, far = os.openpty()
    port = free_port(socket.SOCK_DGRAM)
    station = make_station((0, 0), links=LINKS.format(pty=os.ttyname(far), port=port))
    os.write(near, b"\r\nPX4 bootloader: 57600 8N1 \x80\x81\x82\r\n" * 40)
    yield station
    os.close(near)
    os.close(far)


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize("width", [1600, 390])
def test_each_link_says_what_came_and_what_to_do(
    silent: WebStation,
    open_page: Callable[..., Page],
    shot: Callable[[Page, str], Path],
    width: int,
    theme: str,
) -> None:
    page = open_page(silent, width=width, height=844, theme=theme, touch=width < 500, role="view")
    empty = page.get_by_role("region", name="No vehicle was heard yet")
    expect(empty.locator("li")).to_have_count(4)
    radio = empty.locator("[data-link=radio]")
    expect(radio).to_contain_text("up")
    expect(radio).to_contain_text("0 frames")
    expect(radio).to_contain_text("wrong baud rate")
    expect(empty.locator("[data-link=cable]")).to_contain_text("no such device")
    expect(empty.locator("[data-link=wifi]")).to_contain_text("firewall")
    expect(empty.locator("[data-link=tablet]")).to_contain_text("no vehicle is expected here")
    assert fits(page)
    shot(page, f"empty-fleet-{width}-{theme}")
    page.evaluate((ROOT / "src/skygcs/web/page/node_modules/axe-core/axe.min.js").read_text())
    assert page.evaluate("async () => (await axe.run()).violations.map(({id}) => id)") == []
    assert not page.errors  # type: ignore[attr-defined]
