"""The suite's own daemon process: one that does not come up in time is not left behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from support import process
from support.process import DaemonProcess

pytestmark = pytest.mark.system


def test_a_daemon_that_is_late_is_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process, "HANG_S", 0.0)
    daemon = DaemonProcess(tmp_path, "")
    with pytest.raises(AssertionError, match="the daemon answers"), daemon:
        pass
    assert daemon.process is not None
    assert daemon.process.poll() is not None
