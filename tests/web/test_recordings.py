"""Recordings in the browser: listed, replayed on a page of their own, with marks of events; ended with the daemon."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from support.axe import AXE, findings
from support.browser import until
from support.page_steps import fits
from support.process import wait_until

CAPTURE = Path(__file__).parents[1] / "data" / "px4-battery-low.tlog"
NAME = "20261128T181512Z-0001.tlog"


@pytest.fixture(scope="module")
def recorded(make_station):
    found = make_station(more="[recordings]", daemon="record = false")
    shutil.copy(CAPTURE, found.folder / "logs" / NAME)
    return found


def opened(page: Page) -> None:
    page.get_by_role("navigation", name="Pages").get_by_role("button", name="Recordings").click()
    expect(page.get_by_role("table")).to_contain_text(NAME)


@pytest.mark.parametrize("theme", ["dark", "light"])
@pytest.mark.parametrize(("width", "height"), [(1600, 900), (390, 844)])
def test_recordings_are_listed(recorded, open_page, shot, width, height, theme) -> None:
    page = open_page(recorded, width=width, height=height, theme=theme)
    opened(page)
    expect(page.get_by_role("button", name=f"Replay {NAME}")).to_be_visible()
    fits(page)
    page.evaluate(AXE.read_text())
    assert findings(page) == []
    shot(page, f"recordings-{width}-{theme}")
    assert not page.errors


def test_one_is_replayed_on_a_page_of_its_own_with_marks(recorded, open_page, shot) -> None:
    page = open_page(recorded)
    opened(page)
    page.get_by_role("button", name=f"Replay {NAME}").click()
    link = page.get_by_role("link", name="Open the replay")
    expect(link).to_be_visible(timeout=120_000)
    address = link.get_attribute("href") or ""
    assert re.match(r"http://127\.0\.0\.1:\d+/\?token=", address)
    shot(page, "recordings-replayed-1600-dark")
    other = page.context.new_page()
    other.goto(address)
    bar = other.get_by_role("group", name="Replay")
    expect(bar).to_contain_text(NAME)
    until(other, "document.querySelectorAll('.replay .ticks i').length > 0")
    bar.get_by_role("button", name="Next event").click()
    expect(bar.locator(".lastmark")).to_be_visible()
    first = bar.locator(".lastmark").inner_text()
    bar.get_by_role("button", name="Next event").click()
    expect(bar.locator(".lastmark")).not_to_have_text(first)
    bar.get_by_role("button", name="Previous event").click()
    expect(bar.locator(".lastmark")).to_have_text(first)
    other.evaluate(AXE.read_text())
    assert findings(other) == []
    fits(other)
    shot(other, "replay-marks-1600-dark")
    other.set_viewport_size({"width": 390, "height": 844})
    fits(other)
    shot(other, "replay-marks-390-dark")
    other.close()
    # ended from the page
    page.get_by_role("button", name="End the replay").click()
    expect(link).to_have_count(0)
    assert recorded.call("recordings.list")["replays"] is None
    assert not page.errors


def test_a_viewer_sees_the_list_and_starts_nothing(recorded, open_page) -> None:
    page = open_page(recorded, role="view")
    opened(page)
    expect(page.get_by_role("button", name=re.compile("^Replay"))).to_have_count(0)


def test_names_outside_of_the_folder_are_refused_and_the_replay_ends_with_the_daemon(make_station) -> None:
    own = make_station(more="[recordings]", daemon="record = false")
    shutil.copy(CAPTURE, own.folder / "logs" / NAME)
    (own.folder / "secret.tlog").write_bytes(b"x")
    for name in ("../secret.tlog", "secret.tlog", str(own.folder / "secret.tlog")):
        with pytest.raises(Exception, match=r"recording|No such file"):
            own.call("recordings.replay", name=name)
    first = own.call("recordings.replay", name=NAME)["address"]
    again = own.call("recordings.replay", name=NAME)["address"]
    assert first.split("?")[0] == again.split("?")[0] and first != again, "one page, one address for each browser"
    (control,) = own.folder.glob("gcs.sock.replay.web-*[0-9]")
    pids = replaying(control)
    assert len(pids) == 1
    own.close()
    wait_until(lambda: not any(is_running(pid) for pid in pids), "end of the replay")


def is_running(pid: int) -> bool:
    """False for one that has ended and waits for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def replaying(control: Path) -> list[int]:
    """Processes that serve this replay."""
    base = str(control).rpartition(".web-")[0]
    found = []
    for entry in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            line = entry.read_bytes().split(b"\0")
        except OSError:
            continue
        if base.encode() in line:
            found.append(int(entry.parent.name))
    return found
