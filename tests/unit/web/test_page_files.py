"""Files of the built page: what is found, however an installer put them there, and what is not."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from skygcs.web import http_server
from skygcs.web.http_server import Assets


def page(folder: Path) -> Path:
    (folder / "assets").mkdir(parents=True)
    (folder / "index.html").write_text("the page")
    (folder / "assets" / "a.js").write_text("a")
    return folder


def found(assets: Assets, name: str) -> bytes | None:
    asset = assets.find(name)
    return None if asset is None else asset.body


def test_an_installer_may_link_the_files(tmp_path: Path) -> None:
    """As uv does with --link-mode=symlink: each file of a package is a link to its cache, its folders are none. The
    whole page was 404 then."""
    cache, installed = page(tmp_path / "cache"), tmp_path / "site-packages"
    (installed / "assets").mkdir(parents=True)
    for name in ("index.html", "assets/a.js"):
        (installed / name).symlink_to(cache / name)
    assets = Assets(installed)
    assert (found(assets, "index.html"), found(assets, "assets/a.js")) == (b"the page", b"a")


def test_an_installer_may_link_a_folder(tmp_path: Path) -> None:
    cache, installed = page(tmp_path / "cache"), tmp_path / "site-packages"
    installed.mkdir()
    (installed / "assets").symlink_to(cache / "assets")
    assert found(Assets(installed), "assets/a.js") == b"a"


def test_a_link_to_another_file_of_the_same_time_is_read_again(tmp_path: Path) -> None:
    assets = Assets(page(tmp_path))
    for text in ("old", "new"):
        (tmp_path / f"{text}.txt").write_text(text)
        os.utime(tmp_path / f"{text}.txt", ns=(10**18, 10**18))
    link = tmp_path / "assets" / "b.txt"
    link.symlink_to(tmp_path / "old.txt")
    assert found(assets, "assets/b.txt") == b"old"
    link.unlink()
    link.symlink_to(tmp_path / "new.txt")
    assert found(assets, "assets/b.txt") == b"new"


@pytest.mark.parametrize(
    "name", ["assets/../secret.txt", "../secret.txt", "assets/x/a.js", "other/a.js", "assets/a.sh", "assets/a\0.js", ""]
)
def test_nothing_else_is_found(tmp_path: Path, name: str) -> None:
    folder = page(tmp_path / "page")
    for other in ("secret.txt", "page/assets/a.sh", "page/other/a.js", "page/assets/x/a.js"):
        (tmp_path / other).parent.mkdir(exist_ok=True)
        (tmp_path / other).write_text("key")
    assert Assets(folder).find(name) is None


def test_what_is_no_file_or_too_large_is_not_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(http_server, "MAX_ASSET_BYTES", 4)
    folder = page(tmp_path)
    os.mkfifo(folder / "assets" / "pipe.txt")
    (folder / "assets" / "folder.txt").mkdir()
    (folder / "assets" / "large.txt").write_text("12345")
    (folder / "assets" / "small.txt").write_text("1234")
    assets = Assets(folder)
    wanted = [*(None, None, None), b"1234"]
    assert [found(assets, f"assets/{name}.txt") for name in ("pipe", "folder", "large", "small")] == wanted
