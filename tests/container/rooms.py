"""Roots as a container has them: a base that debootstrap made, and a Containerfile carried out in it by chroot."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
from pathlib import Path

from container.containerfile import Stage, arguments, copied
from support.process import ROOT
from support.system_programs import missing_lines

FIRST_ENV = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"}
"""As the base image has it."""

CERTIFICATES = Path("/etc/ssl/certs/ca-certificates.crt")
HOST_CERTIFICATES = "tmp/certificates-of-the-host.crt"
NETWORK = ("etc/resolv.conf", "etc/hosts")
"""What a runtime gives a container of the host's network."""

IN_A_ROOT = 'mount --rbind /proc "$1/proc" && mount --rbind /dev "$1/dev" && shift 2 && exec "$@"'


def missing() -> list[str]:
    """What keeps the steps from being carried out here, with what to do; []: nothing."""
    found = missing_lines("test-container")
    if os.geteuid() != 0:
        return [*found, "chroot and mounts are root's: sudo make test-container"]
    if not found and subprocess.run(["unshare", "--mount", "true"], capture_output=True).returncode != 0:
        found.append("mounts are not permitted here: run it on the machine itself or in a privileged container")
    return found


def base_root(folder: Path, suite: str, mirror: str) -> Path:
    """The folder of a minimal Debian, made once. Raises CalledProcessError."""
    made = folder / f"base-{suite}"
    if not made.exists():
        half = folder / f"base-{suite}.half"
        shutil.rmtree(half, ignore_errors=True)
        subprocess.run(["debootstrap", "--variant=minbase", suite, str(half), mirror], check=True)
        half.rename(made)
    return made


class Root:
    """One stage, as far as it was carried out."""

    def __init__(self, path: Path, base: Path) -> None:
        subprocess.run(["rm", "-rf", "--one-file-system", str(path)], check=True)
        subprocess.run(["cp", "-a", "--reflink=auto", str(base), str(path)], check=True)
        self.path = path
        self.folder, self.user = "/", "root"
        self.env = dict(FIRST_ENV)
        self.entrypoint: list[str] = []
        self.command: list[str] = []
        for name in NETWORK:
            shutil.copyfile(f"/{name}", path / name)
        if CERTIFICATES.exists():
            shutil.copyfile(CERTIFICATES, path / HOST_CERTIFICATES)
        self._of_the_host = of_the_host(path)

    def carry_out(self, stage: Stage, others: dict[str, Root], context: Path) -> None:
        """All steps. ``context``: the folder that COPY copies from. Raises CalledProcessError, FileNotFoundError."""
        for instruction, text in stage.steps:
            print(f"   {instruction} {text[:100]}", flush=True)
            match instruction:
                case "RUN":
                    subprocess.run(self.words(["/bin/sh", "-c", text]), check=True)
                case "COPY":
                    self._copy(text, others, context)
                case "WORKDIR":
                    self.folder = text
                    self._inside(text).mkdir(parents=True, exist_ok=True)
                case "ENV":
                    self.env |= dict([text.split("=", 1)])
                case "USER":
                    self.user = text
                case "ENTRYPOINT":
                    self.entrypoint = arguments(text)
                case "CMD":
                    self.command = arguments(text)

    def words(self, words: list[str]) -> list[str]:
        """The command that runs this one in the root: as its user, in its folder, with its environment and no other."""
        env = {**self._of_the_host, **self.env, "HOME": "/root" if self.user == "root" else f"/home/{self.user}"}
        there = ["/bin/sh", "-c", f"cd {shlex.quote(self.folder)} && exec {shlex.join(words)}"]
        inside = ["chroot", f"--userspec={self.user}", str(self.path), "/usr/bin/env", "-i"]
        inside += [*(f"{key}={value}" for key, value in env.items()), *there]
        return ["unshare", "--mount", "--", "/bin/sh", "-c", IN_A_ROOT, "sh", str(self.path), "--", *inside]

    def write(self, name: str, text: str) -> None:
        """A file of the stage's user in the stage's folder, as a volume would bring it."""
        path = self._inside(self.folder) / name
        path.write_text(text, encoding="utf-8")
        owner = path.parent.stat()
        os.chown(path, owner.st_uid, owner.st_gid)

    def _inside(self, place: str) -> Path:
        return self.path / place.lstrip("/")

    def _copy(self, text: str, others: dict[str, Root], context: Path) -> None:
        stage, sources, destination = copied(text)
        top = context if stage is None else others[stage].path
        to = self._inside(os.path.join(self.folder, destination))
        for name in sources:
            source = top / name.lstrip("/")
            if source.is_dir():  # its content, as COPY does it
                shutil.copytree(source, to, symlinks=True, dirs_exist_ok=True)
            elif destination.endswith("/"):
                to.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, to)
            else:
                to.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(source, to)


def of_the_host(root: Path) -> dict[str, str]:
    """Where packages come from, as this machine has it: indexes and certificates of a lab's network."""
    kept = {k: v for k, v in os.environ.items() if k.lower().endswith("_proxy") or k == "PIP_INDEX_URL"}
    for program, key, name in (
        ("pip", "global.index-url", "PIP_INDEX_URL"),
        ("npm", "registry", "npm_config_registry"),
    ):
        if shutil.which(program) is not None:
            done = subprocess.run([program, "config", "get", key], capture_output=True, text=True)
            value = done.stdout.strip()
            if done.returncode == 0 and value.startswith("http"):
                kept[name] = value
    if (root / HOST_CERTIFICATES).exists():
        names = ("PIP_CERT", "SSL_CERT_FILE", "NODE_EXTRA_CA_CERTS", "npm_config_cafile")
        kept |= dict.fromkeys(names, f"/{HOST_CERTIFICATES}")
    return kept


def context_of(folder: Path) -> Path:
    """What is in git, as it is in the work tree: a checkout's other files are not part of an image."""
    shutil.rmtree(folder, ignore_errors=True)
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    for name in filter(None, listed.split("\0")):
        if not name.startswith("tests/") and (ROOT / name).is_file():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    return folder
