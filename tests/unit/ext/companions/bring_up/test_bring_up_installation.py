"""Installation step by step: what was done is skipped, what fails is named, the version before stays in use."""

from __future__ import annotations

import hashlib
import json
import tarfile
from collections.abc import Callable
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest

from skygcs.errors import CompanionError, SkygcsError
from skygcs.ext.companions.bring_up.bundle import Bundle, platform_tags, read_bundle
from skygcs.ext.companions.bring_up.companion_file import CompanionFile, companion_file
from skygcs.ext.companions.bring_up.installation import InstallationWishes, install
from skygcs.ext.companions.bring_up.side_by_side import Progress
from skygcs.ext.companions.identity import make_identity
from support.fake_companion import ARMED, FakeSession, companion
from support.table import each

CONFIG = """
[companion]
vehicle = "${vehicle}"
ground = "udp:10.0.0.1:14650"
[vehicles.${name}]
sysid = ${sysid}
"""


def bundle(folder: Path, **changes: Any) -> Bundle:
    path = folder / "bundle.tar"
    path.write_bytes(b"wheels")
    facts = {"version": "0.1.0", "arch": "aarch64", "python": "3.11", "sha256": "ab" * 32, "bytes": 6}
    facts |= {"installed_bytes": 100, "pip_wheel": "pip-26-py3-none-any.whl"}
    return Bundle(path, **(facts | changes))


class Field:
    """A companion without skygcs, and the ground's keys."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.session = FakeSession(program="", installed="", unit="none", state="")
        self.bundle = bundle(folder)
        self.session.answer("sha256sum", 0, f"{self.bundle.sha256}  x\n")
        self.session.answer("test -e", 1)
        self.session.answer("sudo", 1)
        self.session.answer("cat ", 1)
        make_identity(folder / "there", "companion")
        self.session.files["/home/pi/skygcs/keys/companion.crt"] = (folder / "there" / "companion.crt").read_bytes()

    async def install(self, *, force: bool = False, repin: bool = False) -> str:
        config = CompanionFile(Path("companion.toml"), "[companion]\nvehicle = 'alpha'\n")
        wishes = InstallationWishes(user_service=False, force=force, repin=repin)
        progress = Progress("alpha")
        keys = self.folder / "keys"
        return await install(self.session, companion(), progress, self.bundle, config, keys, wishes)


@pytest.fixture
def field(tmp_path: Path) -> Field:
    return Field(tmp_path)


async def test_everything_is_done_in_order_and_nothing_is_started(field: Field) -> None:
    assert await field.install() == "skygcs 0.1.0 installed, user service"
    session = field.session
    assert [offset for _, offset in session.uploads] == [0]
    order = [
        *("sha256sum", "--no-index", "check", "current.new"),
        *("companion identity", "companion pin", "service install"),
    ]
    at = [next(i for i, command in enumerate(session.commands) if part in command) for part in order]
    assert at == sorted(at)
    assert not session.ran("systemctl")
    pinned = (field.folder / "keys" / "companions" / "alpha.crt").read_bytes()
    assert pinned == session.files["/home/pi/skygcs/keys/companion.crt"]
    assert session.files["/home/pi/skygcs/.ground.crt"] == (field.folder / "keys" / "ground.crt").read_bytes()


async def test_an_upload_that_was_broken_off_goes_on(field: Field) -> None:
    """From the beginning of its last piece, which may have holes; a file that is too long is begun anew."""
    field.bundle = replace(field.bundle, bytes=4 << 20)
    for there, offset in (((2 << 20) + 5, 2 << 20), (2 << 20, 1 << 20), (0, 0), (5 << 20, 0)):
        field.session.answer("wc -c", 0, f"{there}\n")
        await field.install()
        assert field.session.uploads[-1][1] == offset


async def test_a_version_that_is_there_is_not_uploaded_again(field: Field) -> None:
    field.session.answer(".complete", 0)
    assert "was installed" in await field.install()
    assert field.session.uploads == [] and not field.session.ran("--no-index")


async def test_a_running_service_is_restarted_with_the_new_version(field: Field) -> None:
    field.session.facts |= {"state": "active", "unit": "user", "program": "p", "installed": "versions/old"}
    assert (await field.install()).endswith(", restarted")
    assert field.session.ran("systemctl --user restart skygcs")


async def test_nothing_is_done_while_its_vehicle_is_armed(field: Field) -> None:
    field.session.facts |= {"state": "active", "unit": "user", "program": "p"}
    field.session.answer("status", 0, ARMED)
    with pytest.raises(CompanionError, match="alpha is armed or in the air"):
        await field.install()
    assert field.session.uploads == [] and len(field.session.commands) == 2


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"machine": "x86_64"}, "the bundle is for aarch64, this computer is x86_64; skygcs-cli companions"),
        ({"machine": "aarch64", "bits": "32"}, "this computer is armv7l"),
        ({"python": "3.12"}, "this computer has 3.12; skygcs-cli companions bundle --python 3.12"),
        ({"python": ""}, "this computer has none"),
        ({"free_kb": "1000"}, "disk: 1 MB free"),
    ],
)
async def test_a_companion_that_does_not_fit_is_refused_before_anything_is_done(
    field: Field, facts: dict[str, str], words: str
) -> None:
    field.session.facts |= facts
    with pytest.raises(CompanionError) as caught:
        await field.install()
    assert words in str(caught.value)
    assert field.session.uploads == []


@pytest.mark.parametrize(
    ("part", "step", "words"),
    [
        ("--no-index", "install", "ERROR: no wheel"),
        (" check ", "configure", "companion.toml is refused there: ERROR: no wheel"),
        ("companion identity", "keys", "ERROR: no wheel"),
        ("service install", "service", "ERROR: no wheel"),
    ],
)
async def test_a_step_that_fails_is_named(field: Field, part: str, step: str, words: str) -> None:
    field.session.answer(part, 1, stderr="more\nERROR: no wheel\n" if step != "configure" else "ERROR: no wheel\n")
    with pytest.raises(CompanionError) as caught:
        await field.install()
    assert caught.value.step == step and words in str(caught.value)
    assert field.session.ran("current.new") is (step in ("keys", "service"))


async def test_a_bundle_that_arrived_damaged_is_removed(field: Field) -> None:
    field.session.answer("sha256sum", 0, "00  x\n")
    with pytest.raises(CompanionError, match="arrived damaged"):
        await field.install()
    assert field.session.ran("rm -f") and not field.session.ran("--no-index")


async def test_a_connection_that_breaks_says_that_the_upload_goes_on_next_time(field: Field) -> None:
    field.session.broken = CompanionError("ssh", "connection lost")
    with pytest.raises(CompanionError, match="upload: connection lost; again: it continues"):
        await field.install()


async def test_another_certificate_than_the_pinned_one_needs_repin(field: Field) -> None:
    await field.install()
    make_identity(field.folder / "anew", "companion")
    field.session.files["/home/pi/skygcs/keys/companion.crt"] = (field.folder / "anew" / "companion.crt").read_bytes()
    with pytest.raises(CompanionError, match=r"keys: .*pins another certificate.*--repin"):
        await field.install()
    await field.install(repin=True)
    pinned = (field.folder / "keys" / "companions" / "alpha.crt").read_bytes()
    assert pinned == (field.folder / "anew" / "companion.crt").read_bytes()


# --- the configuration ------------------------------------------------------------------------------------------------


def test_the_file_for_all_is_filled_in_and_one_of_its_own_comes_before_it(tmp_path: Path) -> None:
    (tmp_path / "companion.toml").write_text(CONFIG)
    found = companion_file(companion(), tmp_path)
    assert 'vehicle = "alpha"' in found.text and "sysid = 1" in found.text and "$" not in found.text
    assert found.key_dir("/home/pi", "/home/pi/skygcs") == "/home/pi/skygcs/keys"
    (tmp_path / "companions").mkdir()
    own = tmp_path / "companions" / "alpha.toml"
    own.write_text(CONFIG.replace("[vehicles", 'key_dir = "~/k"\n[vehicles'))
    found = companion_file(companion(), tmp_path)
    assert (found.source, found.key_dir("/home/pi", "/x")) == (own, "/home/pi/k")


@each(
    ("text", "words"),
    [
        (None, "there is no"),
        ("[vehicles.alpha]\nsysid = 1\n", "has no table"),
        (CONFIG.replace("${vehicle}", "bravo").replace("${name}", "bravo"), "is for vehicle bravo, alpha is on alpha"),
        (CONFIG.replace("${sysid}", "7"), "system id 7, the fleet file 1"),
        (CONFIG.replace("ground", "grund"), "did you mean ground"),
        ("\x00", "problem"),
    ],
)
def test_a_file_that_does_not_fit_is_refused_here(tmp_path: Path, text: str | None, words: str) -> None:
    if text is not None:
        (tmp_path / "companion.toml").write_text(text)
    with pytest.raises(CompanionError) as caught:
        companion_file(companion(), tmp_path)
    assert words in str(caught.value) or words == "problem"


# --- bundles ----------------------------------------------------------------------------------------------------------


def tar(path: Path, files: dict[str, bytes], change: Callable[[tarfile.TarInfo], None] = lambda entry: None) -> Path:
    with tarfile.open(path, "w") as archive:
        for name, data in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            change(entry)
            archive.addfile(entry, BytesIO(data))
    return path


def manifest(**changes: Any) -> bytes:
    digest = hashlib.sha256(b"C").hexdigest()
    facts = {"format": 1, "version": "0.1.0", "arch": "aarch64", "python": "3.11", "pip_wheel": "pip-1.whl"}
    facts |= {"installed_bytes": 1, "files": {"pip-1.whl": {"sha256": digest, "bytes": 1}}}
    return json.dumps(facts | changes).encode()


def test_a_bundle_is_read(tmp_path: Path) -> None:
    found = read_bundle(tar(tmp_path / "b.tar", {"manifest.json": manifest(), "wheels/pip-1.whl": b"C"}))
    assert (found.version, found.arch, found.python) == ("0.1.0", "aarch64", "3.11")
    assert found.identifier.startswith("0.1.0-") and found.needed_bytes == 2 * found.bytes + 1


@each(
    "files",
    [
        {},
        {"manifest.json": b"{}"},
        {"manifest.json": b"["},
        {"manifest.json": manifest(format=2), "wheels/pip-1.whl": b"C"},
        {"manifest.json": manifest(version="$(reboot)"), "wheels/pip-1.whl": b"C"},
        {"manifest.json": manifest(files={"../../x.whl": {}}), "wheels/pip-1.whl": b"C"},
        {"manifest.json": manifest(files=[]), "wheels/pip-1.whl": b"C"},
        {"manifest.json": manifest(files=["pip-1.whl"]), "wheels/pip-1.whl": b"C"},
        {"manifest.json": manifest(files={"pip-1.whl": 1}), "wheels/pip-1.whl": b"C"},
        {"manifest.json": manifest(), "wheels/pip-1.whl": b"D"},
        {"manifest.json": manifest(), "wheels/pip-1.whl": b"C", "../evil": b"x"},
        {"manifest.json": manifest()},
        {"wheels/pip-1.whl": b"C", "manifest.json": manifest()},
    ],
)
def test_what_is_no_bundle_or_was_changed_is_refused(tmp_path: Path, files: dict[str, bytes]) -> None:
    with pytest.raises(SkygcsError, match=r"b\.tar"):
        read_bundle(tar(tmp_path / "b.tar", files))


def test_a_file_that_is_no_tar_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "b.tar"
    path.write_bytes(b"PK" * 1000)
    with pytest.raises(SkygcsError, match="is not a bundle"):
        read_bundle(path)
    with pytest.raises(SkygcsError, match="No such file"):
        read_bundle(tmp_path / "none.tar")


def test_wheels_of_older_systems_are_taken_too() -> None:
    assert platform_tags("aarch64")[0] == "manylinux_2_36_aarch64"
    assert {"manylinux_2_17_aarch64", "manylinux2014_aarch64", "linux_aarch64"} <= set(platform_tags("aarch64"))
    assert "manylinux1_x86_64" in platform_tags("x86_64")
