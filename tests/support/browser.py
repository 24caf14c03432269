"""Waiting for what a page of the browser tests knows: Playwright's wait_for_function needs eval, which CSP forbids."""

from __future__ import annotations

import time
from typing import Any

from playwright.sync_api import Page, expect

from support.hanging import HANG_S

expect.set_options(timeout=HANG_S * 1000)


def until(page: Page, expression: str) -> Any:
    """Wait until a JavaScript expression is true; what it then is. Fails with the expression."""
    if "skygcs" in expression:  # the page defines it with its first drawing, which may come after its load
        expression = f"'skygcs' in window && ({expression})"
    deadline = time.monotonic() + HANG_S
    while not (value := page.evaluate(expression)):
        assert time.monotonic() < deadline, f"never true: {expression}"
        page.wait_for_timeout(50)
    return value
