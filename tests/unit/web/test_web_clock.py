"""The page's process and the wall clock: a step of it signs nobody out, and keeps no address good."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from skygcs.config import files
from skygcs.web import web_process
from skygcs.web.sign_in import COOKIE_LIFE_S, SignIn
from skygcs.web.web_process import WebOptions, WebProcess

YEARS_S = 50 * 365 * 86400.0


@pytest.mark.parametrize("step_s", [YEARS_S, 3601.0, -3600.0, -YEARS_S])
async def test_a_step_of_the_wall_clock_changes_nothing_of_the_sign_in(
    step_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    web = WebProcess(WebOptions(str(tmp_path / "s.sock"), port=0))
    monkeypatch.setattr(web_process, "boot_s", lambda: 1000.0)
    first, second = (web.link("command").partition("=")[2] for _ in range(2))
    cookie = web.sign_in.exchange(first, web_process.boot_s(), lambda: False)
    assert cookie is not None
    now = time.time() + step_s
    monkeypatch.setattr(time, "time", lambda: now)
    monkeypatch.setattr(web_process, "boot_s", lambda: 1001.0)
    assert web.sign_in.role_of(cookie, web_process.boot_s()) == "command"
    assert web.sign_in.exchange(second, web_process.boot_s(), lambda: False) is not None
    third = web.link("view").partition("=")[2]
    monkeypatch.setattr(web_process, "boot_s", lambda: 1002.0 + 3600.0)
    assert web.sign_in.exchange(third, web_process.boot_s(), lambda: False) is None
    await asyncio.sleep(0)


def saved_process(path: Path, monkeypatch: pytest.MonkeyPatch, *, used_at_s: float, saved_at_s: float) -> str:
    """The cookie of a process that saved who is signed in, as it would be read by the next one."""
    web = WebProcess(WebOptions(str(path.with_suffix(".sock")), port=0))
    web._cookies = path
    cookie = web.sign_in.exchange(web.sign_in.issue("command", used_at_s), used_at_s, lambda: True)
    assert cookie is not None
    monkeypatch.setattr(web_process, "boot_s", lambda: saved_at_s)
    web._save_cookies()
    return cookie


def role_after_a_restart(path: Path, cookie: str) -> str | None:
    sign_in = SignIn(lambda: "")
    sign_in.restore(*web_process._read_cookies(path))
    return sign_in.role_of(cookie, web_process.boot_s())


@pytest.mark.parametrize("step_s", [YEARS_S, -YEARS_S])
async def test_a_process_killed_after_the_clock_was_set_knows_its_browsers(
    step_s: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "web.cookies"
    cookie = saved_process(path, monkeypatch, used_at_s=900.0, saved_at_s=1000.0)
    now = time.time() + step_s
    monkeypatch.setattr(time, "time", lambda: now)
    monkeypatch.setattr(web_process, "boot_s", lambda: 1100.0)
    assert role_after_a_restart(path, cookie) == "command"
    monkeypatch.setattr(web_process, "boot_s", lambda: 901.0 + COOKIE_LIFE_S)  # as long as that really passed
    assert role_after_a_restart(path, cookie) is None


@pytest.mark.parametrize(("away_s", "role"), [(60.0, "command"), (COOKIE_LIFE_S, None)])
async def test_over_a_start_of_the_computer_the_wall_clock_counts(
    away_s: float, role: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "web.cookies"
    cookie = saved_process(path, monkeypatch, used_at_s=900.0, saved_at_s=1000.0)
    (tmp_path / "boot_id").write_text("another\n")
    monkeypatch.setattr(files, "BOOT_ID", tmp_path / "boot_id")
    now = path.stat().st_mtime + away_s
    monkeypatch.setattr(time, "time", lambda: now)
    monkeypatch.setattr(web_process, "boot_s", lambda: 20.0)
    assert role_after_a_restart(path, cookie) == role


@pytest.mark.parametrize(
    "text", ['{"%s": ["command", 1.0]}' % ("0" * 64), '{"browsers": [], "saved_at_s": 1}', "[]", "{"]
)
async def test_a_file_of_another_form_signs_nobody_in(text: str, tmp_path: Path) -> None:
    path = tmp_path / "web.cookies"
    path.write_text(text)
    path.chmod(0o600)
    assert web_process._read_cookies(path)[0] == {}


async def test_the_last_use_is_saved_while_the_process_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "web.cookies"
    cookie = saved_process(path, monkeypatch, used_at_s=900.0, saved_at_s=1000.0)
    web = WebProcess(WebOptions(str(tmp_path / "s.sock"), port=0))
    web._cookies = path
    web.sign_in.restore(*web_process._read_cookies(path))
    late_s = 800.0 + COOKIE_LIFE_S
    assert web.sign_in.role_of(cookie, late_s) == "command"
    before = path.read_bytes()
    monkeypatch.setattr(web_process, "boot_s", lambda: late_s)
    monkeypatch.setattr(web_process, "SAVE_COOKIES_S", 0.001)
    saving = asyncio.create_task(web._save_cookies_often())
    async with asyncio.timeout(20):
        while path.read_bytes() == before:  # noqa: ASYNC110
            await asyncio.sleep(0.001)
    saving.cancel()
    monkeypatch.setattr(web_process, "boot_s", lambda: late_s + 3600.0)
    assert role_after_a_restart(path, cookie) == "command"
