"""File descriptors: the process raises its limit, and knows the last of them."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import os, resource
from skygcs.descriptors import DESCRIPTORS_KEPT, WANTED, is_of_the_last, raise_limit
soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
opened = []
while not is_of_the_last(fd := os.open(os.devnull, os.O_RDONLY)):
    opened.append(fd)
assert fd == 256 - DESCRIPTORS_KEPT, fd
for _ in range(DESCRIPTORS_KEPT - 1):
    os.open(os.devnull, os.O_RDONLY)
raise_limit()
soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
assert soft == (WANTED if hard == resource.RLIM_INFINITY else min(WANTED, hard)), (soft, hard)
assert not is_of_the_last(os.open(os.devnull, os.O_RDONLY)) or hard < 256 + DESCRIPTORS_KEPT
"""


def test_the_last_descriptors_are_known_and_the_limit_is_raised() -> None:
    subprocess.run([sys.executable, "-c", PROGRAM], check=True, timeout=60)


def test_no_file_of_ours_becomes_a_standard_stream() -> None:
    code = """
import os
for number in (0, 2):
    os.close(number)
from skygcs.descriptors import hold_standard
hold_standard()
print(os.open(os.devnull, os.O_RDONLY))
"""
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(ran.stdout) > 2


@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&- <&-"])
def test_an_order_needs_no_standard_stream(closed: str) -> None:
    """A cron job that closes its output still lands. 3: it found no daemon, so it has tried."""
    python = "import sys; from skygcs.__main__ import cli; sys.argv[1:] = ['land', 'all']; cli()"
    line = ["/bin/sh", "-c", f'exec "$@" {closed}', "sh", sys.executable, "-c", python]
    ran = subprocess.run(line, check=False, capture_output=True, env={**os.environ, "SKYGCS_SOCKET": "/nowhere"})
    assert ran.returncode == 3
