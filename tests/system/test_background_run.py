"""The suite as a background job of a shell, which starts it with SIGINT ignored."""

from __future__ import annotations

import subprocess
import sys

import pytest

from support.hanging import HANG_S
from support.process import ROOT

pytestmark = pytest.mark.system

SELECTED = "tests/system/test_control_process.py::test_ctrl_c_ends_it_quietly"
IGNORE_SIGINT = (
    "import os, signal, sys; signal.signal(signal.SIGINT, signal.SIG_IGN); os.execv(sys.argv[1], sys.argv[1:])"
)


def test_ctrl_c_is_tested_although_the_shell_ignores_it() -> None:
    pytest_run = [sys.executable, "-m", "pytest", "-q", "-n", "0", "-p", "no:cacheprovider", SELECTED]
    done = subprocess.run(
        [sys.executable, "-c", IGNORE_SIGINT, *pytest_run],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=HANG_S,
        check=False,
    )
    assert done.returncode == 0 and "3 passed" in done.stdout, done.stdout + done.stderr
