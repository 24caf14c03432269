"""Skip a test whose program or file of the system is missing; in CI, which has to install it, the test fails."""

from __future__ import annotations

import os

import pytest

from support.system_programs import PROGRAMS, path_of


def needs(target: str, *names: str) -> str:
    """The path of the first of these programs and files of a target in `PROGRAMS`, all of which have to be there."""
    absent = dict.fromkeys(PROGRAMS[target][name] for name in names if path_of(name) is None)
    if absent:
        text = f"not installed: apt-get install {' '.join(absent)}"
        if os.environ.get("CI"):
            pytest.fail(text)
        pytest.skip(text)
    return path_of(names[0]) or ""
