"""`make soak` for a few seconds: what is delivered to whom, never how fast."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench import soak

pytestmark = pytest.mark.system


def test_mixed_traffic_beside_a_hostile_peer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soak, "MINUTES", 0.1)
    monkeypatch.setattr(soak, "RATE_PER_S", 300)  # a busy machine may keep a daemon waiting for seconds
    report = soak.Soak(tmp_path).run()
    assert soak.missed(report) == []
    assert report["traffic"]["frames delivered"] > 1_000
    assert report["traffic"]["junk datagrams"] > 10
    assert report["hostile peer"]["forged heartbeats"] > 5
    assert soak.table(report)
