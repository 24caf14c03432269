"""`skygcs demo` without what its page needs says what to install, in full."""

from __future__ import annotations

import pytest
from rich.console import Console

from skygcs.cli import demo


def test_a_plain_install_is_told_which_extra_the_page_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    """It printed "needs the package aiohttp", a restart warning and two wrong hints."""
    monkeypatch.setattr(demo, "find_spec", lambda name: None)
    missing = demo._missing_page()
    console = Console(record=True, width=100)
    console.print(f"web page: {missing}", highlight=False, markup=False)
    assert "pip install 'skygcs[web]'" in console.export_text()
    monkeypatch.setattr(demo, "find_spec", lambda name: name)
    monkeypatch.setattr(demo, "is_built", lambda: False)
    assert "make web" in str(demo._missing_page())
    monkeypatch.setattr(demo, "is_built", lambda: True)
    assert demo._missing_page() is None
