"""`companions install` on real sshd: from a bundle, offline, again, broken off, damaged, and onto a full disk."""

from __future__ import annotations

import base64
import csv
import hashlib
import io
import json
import os
import platform
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from lab.ssh_hosts import SshHost, make_key, prepare_sshd, short_folder, small_disk
from skygcs import __version__
from skygcs.ext.companions.bring_up.bundle import Bundle, read_bundle
from skygcs.ext.companions.bring_up.ssh_session import UPLOAD_BYTES
from support.needed import needs

SYSID = 3
CONFIG = """
[daemon]
log_dir = "logs"
[companion]
vehicle = "${vehicle}"
ground = "udp:127.0.0.1:14650"
[vehicles.${vehicle}]
sysid = ${sysid}
[links.autopilot]
type = "simulated"
px4 = 1
first_sysid = ${sysid}
dynamics = "kinematic"
"""


def stand_in_wheel(folder: Path, version: str = __version__) -> Path:
    """A wheel of skygcs whose programs are those of this environment: what is tested is the way to the companion."""
    module = "import os, sys\ndef {name}():\n    os.execv({program!r}, [{program!r}, *sys.argv[1:]])\n"
    info = f"skygcs-{version}.dist-info"
    programs = {"skygcs": "daemon", "skygcs-cli": "cli"}
    files = {
        f"skygcs_{name}.py": module.format(name="main", program=str(Path(sys.executable).with_name(program)))
        for program, name in programs.items()
    }
    files[f"{info}/METADATA"] = f"Metadata-Version: 2.1\nName: skygcs\nVersion: {version}\nProvides-Extra: companions\n"
    files[f"{info}/WHEEL"] = "Wheel-Version: 1.0\nGenerator: test\nRoot-Is-Purelib: true\nTag: py3-none-any\n"
    scripts = "".join(f"{program} = skygcs_{name}:main\n" for program, name in programs.items())
    files[f"{info}/entry_points.txt"] = f"[console_scripts]\n{scripts}"
    record = io.StringIO()
    rows = csv.writer(record, lineterminator="\n")
    for name, text in files.items():
        digest = base64.urlsafe_b64encode(hashlib.sha256(text.encode()).digest()).rstrip(b"=").decode()
        rows.writerow([name, f"sha256={digest}", len(text)])
    rows.writerow([f"{info}/RECORD", "", ""])
    path = folder / f"skygcs-{version}-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as wheel:
        for name, text in (files | {f"{info}/RECORD": record.getvalue()}).items():
            wheel.writestr(name, text)
    return path


class Ground:
    """The fleet file with one or two companions, and the command line."""

    def __init__(self, folder: Path, hosts: list[SshHost]) -> None:
        self.folder = folder
        self.hosts = hosts
        text = ""
        for number, host in enumerate(hosts):
            text += f"[vehicles.{host.name}]\nsysid = {SYSID + number}\n"
            text += f'[companions.{host.name}]\nhost = "127.0.0.1"\nssh_port = {host.port}\n'
        (folder / "fleet.toml").write_text(text)
        (folder / "companion.toml").write_text(CONFIG)
        (folder / "known_hosts").write_text("".join(host.public_key() + "\n" for host in hosts))

    def cli(self, *words: str | Path) -> subprocess.CompletedProcess[str]:
        environment = {k: v for k, v in os.environ.items() if not k.startswith(("SKYGCS", "SSH_"))}
        environment |= {"HOME": str(self.folder), "SKYGCS_FLEET": str(self.folder / "fleet.toml")}
        cli = Path(sys.executable).with_name("skygcs-cli")
        return subprocess.run(
            [str(cli), "companions", *map(str, words)], env=environment, capture_output=True, text=True
        )

    def outcome(self, name: str, action: str, *words: str | Path) -> Any:
        options = ("--identity", self.folder / "id", "--timeout", "600", "--json")
        done = self.cli(action, name, *words, *options)
        assert done.stdout, done.stderr
        return json.loads(done.stdout)["outcomes"][name]


@pytest.fixture
def ground() -> Iterator[Ground]:
    needs("test-lab", "sshd")
    prepare_sshd()
    with short_folder() as folder, small_disk(folder / "full", 1024) as mounted:
        make_key(folder / "id")
        hosts = [SshHost("alpha", folder, folder / "id")]
        if mounted:
            hosts.append(SshHost("fox", folder, folder / "id", folder / "full"))
        try:
            yield Ground(folder, hosts)
        finally:
            for host in hosts:
                host.close()


@pytest.fixture(scope="module")
def bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    folder = tmp_path_factory.mktemp("bundle")
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    words = ["companions", "bundle", "--arch", platform.machine(), "--python", python]
    words += ["--wheel", str(stand_in_wheel(folder)), "-o", str(folder / "bundle.tar")]
    cli = Path(sys.executable).with_name("skygcs-cli")
    done = subprocess.run([str(cli), *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return read_bundle(folder / "bundle.tar")


def test_a_companion_is_installed_without_a_network_and_again_without_harm(ground: Ground, bundle: Bundle) -> None:
    (alpha, *_) = ground.hosts
    # broken off before: the upload continues
    incoming = alpha.home / "skygcs" / "incoming"
    incoming.mkdir(parents=True)
    (incoming / f"{bundle.sha256}.part").write_bytes(bundle.path.read_bytes()[: bundle.bytes // 2])
    outcome = ground.outcome("alpha", "install", "--bundle", bundle.path, "--user-service")
    assert outcome["ok"], outcome
    there = alpha.home / "skygcs"
    assert os.readlink(there / "current") == f"versions/{bundle.identifier}"
    assert list(incoming.iterdir()) == []
    assert "--user enable skygcs.service" in alpha.calls()
    assert not any("start" in call.split() for call in alpha.calls())
    # both sides pin each other
    assert (there / "keys" / "ground.crt").read_text() == (ground.folder / "keys" / "ground.crt").read_text()
    pinned = (ground.folder / "keys" / "companions" / "alpha.crt").read_text()
    assert pinned == (there / "keys" / "companion.crt").read_text()
    assert (there / "keys" / "companion.key").stat().st_mode & 0o077 == 0
    # its own configuration, from the file for all
    text = (there / "companion.toml").read_text()
    assert f"[vehicles.alpha]\nsysid = {SYSID}" in text
    # again: nothing is done twice
    made = (there / "current" / ".complete").stat().st_mtime_ns
    again = ground.outcome("alpha", "install", "--bundle", bundle.path, "--user-service")
    assert again["ok"] and "was installed" in again["message"], again
    assert (there / "current" / ".complete").stat().st_mtime_ns == made
    _starts_takes_a_new_file_and_stops(ground, alpha)


def _starts_takes_a_new_file_and_stops(ground: Ground, alpha: SshHost) -> None:
    assert ground.outcome("alpha", "start")["message"] == "started"
    assert ground.outcome("alpha", "start")["message"] == "was running"
    status = ground.outcome("alpha", "status")
    assert status["ok"] and status["facts"]["version"] == __version__, status
    assert ground.outcome("alpha", "push")["message"] == "unchanged"
    file = ground.folder / "companion.toml"
    file.write_text(CONFIG + "[links.more]\ntype = 'udp_client'\nhost = '127.0.0.1'\nport = 14651\n")
    assert ground.outcome("alpha", "push")["message"] == "pushed, restarted"
    assert "links.more" in (alpha.home / "skygcs" / "companion.toml").read_text()
    file.write_text(CONFIG + "[links.more]\ntype = 'udp_clinet'\n")
    assert "did you mean udp_client?" in ground.outcome("alpha", "push")["message"]
    logs = ground.cli("logs", "alpha", "--identity", ground.folder / "id")
    assert "skygcs is up" in logs.stdout and all(line.startswith("alpha  ") for line in logs.stdout.splitlines())
    assert ground.outcome("alpha", "stop")["message"] == "stopped"


def test_a_damaged_upload_is_removed_and_the_next_one_succeeds(ground: Ground, bundle: Bundle) -> None:
    (alpha, *_) = ground.hosts
    incoming = alpha.home / "skygcs" / "incoming"
    incoming.mkdir(parents=True)
    assert bundle.bytes > UPLOAD_BYTES, "its first piece is kept, the one that was being written is not"
    (incoming / f"{bundle.sha256}.part").write_bytes(bytes(UPLOAD_BYTES + 1000))
    outcome = ground.outcome("alpha", "install", "--bundle", bundle.path, "--user-service")
    assert not outcome["ok"] and "damaged" in outcome["message"]
    assert not (alpha.home / "skygcs" / "current").exists()
    assert ground.outcome("alpha", "install", "--bundle", bundle.path, "--user-service")["ok"]


def test_a_full_disk_is_named_before_and_during_the_upload(ground: Ground, bundle: Bundle) -> None:
    if len(ground.hosts) == 1:
        pytest.skip("a small file system needs the right to mount one")
    fox = ground.hosts[1]
    before = ground.outcome("fox", "install", "--bundle", bundle.path, "--user-service")
    assert before["message"].startswith("disk: ") and "needed" in before["message"], before
    # a disk that fills up in the meantime: its report is that of a large one until the file is half there
    part = fox.home / "skygcs" / "incoming" / f"{bundle.sha256}.part"
    real = shutil.which("df")
    lines = (
        "#!/bin/sh",
        f'[ -s {part} ] && exec {real} "$@"',
        "echo F 1024-blocks Used Available",
        "echo none 9 9 9000000",
    )
    text = "\n".join((*lines, ""))
    fox.add_program("df", text)
    during = ground.outcome("fox", "install", "--bundle", bundle.path, "--user-service")
    assert during["message"].startswith("disk: ") and "remove old logs" in during["message"], during
    assert not (fox.home / "skygcs" / "current").exists()


def test_a_bundle_for_another_computer_is_refused_by_name(ground: Ground, bundle: Bundle) -> None:
    (alpha, *_) = ground.hosts
    alpha.add_program("uname", "#!/bin/sh\necho riscv64\n")
    outcome = ground.outcome("alpha", "install", "--bundle", bundle.path, "--user-service")
    assert f"the bundle is for {bundle.arch}, this computer is riscv64" in outcome["message"]
    assert not (alpha.home / "skygcs").exists()
