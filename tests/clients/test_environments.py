"""Environments of programs: one that cannot be made is reported with the package that is missing."""

from __future__ import annotations

from pathlib import Path

import pytest

from clients import environments
from clients.environments import Client, main


def test_a_package_that_cannot_be_had_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PIP_NO_INDEX", "1")  # as without a network, but at once
    monkeypatch.setattr(environments, "FOLDER", tmp_path)
    client = Client("kite", ("a-package-that-nobody-has",))
    monkeypatch.setattr(environments, "CLIENTS", {"kite": client})
    assert main() == 1
    said = capsys.readouterr().err
    assert "kite" in said and "a-package-that-nobody-has" in said
    assert not client.is_installed
