"""Every test begins in an empty folder of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from skygcs.config.models import DaemonConfig
from support.process import ROOT


@pytest.mark.parametrize("turn", [1, 2])
def test_nothing_that_another_test_left_is_in_the_default_log_dir(turn: int) -> None:
    folder = DaemonConfig().log_dir.resolve()
    assert ROOT not in folder.parents
    assert list(Path.cwd().iterdir()) == []
    folder.mkdir()
