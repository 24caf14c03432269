"""A compiled fast path of another version is not used."""

from __future__ import annotations

import pytest
import structlog.testing

from skygcs.config.dialects import offline_dialect
from skygcs.links import express

_express = pytest.importorskip("skygcs.links._express", reason="the fast path is not compiled")


def test_the_compiled_file_is_the_one_this_version_expects() -> None:
    assert _express.INTERFACE == express.INTERFACE
    assert express.new_table(offline_dialect(), recording=False) is not None


@pytest.mark.parametrize("compiled", [1, 99])
def test_one_of_another_version_is_left_aside_and_said(monkeypatch: pytest.MonkeyPatch, compiled: int) -> None:
    monkeypatch.setattr(_express, "INTERFACE", compiled)
    with structlog.testing.capture_logs() as told:
        assert express.new_table(offline_dialect(), recording=False) is None
    assert [line["log_level"] for line in told] == ["warning"]
    assert (told[0]["compiled"], told[0]["wanted"]) == (compiled, express.INTERFACE)
