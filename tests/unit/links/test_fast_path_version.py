"""A compiled fast path of another version is not used."""

from __future__ import annotations

import pytest
import structlog.testing

from skygcs.config.dialects import offline_dialect
from skygcs.links import fast_path
from support.table import each

_fast_path = pytest.importorskip("skygcs.links._fast_path", reason="the fast path is not compiled")


def test_the_compiled_file_is_the_one_this_version_expects() -> None:
    assert _fast_path.INTERFACE == fast_path.INTERFACE
    assert fast_path.new_table(offline_dialect(), recording=False) is not None


@each("compiled", [1, 99])
def test_one_of_another_version_is_left_aside_and_said(monkeypatch: pytest.MonkeyPatch, compiled: int) -> None:
    monkeypatch.setattr(_fast_path, "INTERFACE", compiled)
    with structlog.testing.capture_logs() as reported:
        assert fast_path.new_table(offline_dialect(), recording=False) is None
    assert [line["log_level"] for line in reported] == ["warning"]
    assert (reported[0]["compiled"], reported[0]["wanted"]) == (compiled, fast_path.INTERFACE)
