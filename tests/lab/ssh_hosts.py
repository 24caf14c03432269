"""Companions on loopback: a real sshd each, with a home of its own and a stand-in for systemd.

The stand-in is a `systemctl` in the PATH of the SSH session: it writes down its calls, and starts and stops the program
of the unit in the background, as no service manager runs in a container.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from support.needed import needs
from support.process import free_port, wait_until

SYSTEMCTL = """#!/bin/sh
echo "$*" >> "$HOME/systemctl.calls"
[ "$1" = --user ] && shift
unit="$HOME/.config/systemd/user/skygcs.service"
pid="$HOME/skygcs.pid"
running() { [ -f "$pid" ] && kill -0 "$(cat "$pid")" 2>/dev/null; }
begin() {
    [ -f "$unit" ] || { echo "Unit skygcs.service not found." >&2; exit 5; }
    running && return
    rm -f "$XDG_RUNTIME_DIR/skygcs.sock"
    line=$(sed -n 's/^ExecStart=//p' "$unit")
    sh -c 'echo $$ > "$1"; shift; eval exec "$1"' sh "$pid" "$line" >> "$HOME/skygcs/skygcs.log" 2>&1 < /dev/null &
    while [ ! -S "$XDG_RUNTIME_DIR/skygcs.sock" ]; do
        sleep 0.1
        running || [ ! -f "$pid" ] || { echo "Job for skygcs.service failed." >&2; exit 1; }
    done
}
end() { running && kill "$(cat "$pid")"; while running; do sleep 0.1; done; rm -f "$pid"; }
case "$1" in
    start) begin ;;
    stop) end ;;
    restart) end; begin ;;
    is-active) if running; then echo active; else echo inactive; exit 3; fi ;;
esac
exit 0
"""

SHIM = '#!/bin/sh\nexec {program} "$@"\n'


class SshHost:
    """One computer. ``home`` is its home folder; ``stop_sshd`` takes it out of reach, ``new_key`` sets it up anew."""

    def __init__(self, name: str, folder: Path, client_key: Path, home: Path | None = None) -> None:
        self.name = name
        self.folder = folder / name
        self.home = home or self.folder / "home"
        self.runtime = self.folder / "run"
        for path in (self.home, self.runtime):
            path.mkdir(parents=True, exist_ok=True)
        self.programs = self.folder / "bin"
        self.add_program("systemctl", SYSTEMCTL)
        self.add_program("loginctl", "#!/bin/sh\nexit 0\n")
        self._authorized = self.folder / "authorized_keys"
        self._authorized.write_bytes(client_key.with_suffix(".pub").read_bytes())
        self._sshd: subprocess.Popen[bytes] | None = None
        for _ in range(5):  # another program may have taken the port in the meantime
            self.port = free_port(socket.SOCK_STREAM)
            if self._start_with_new_key():
                return
        raise AssertionError((self.folder / "sshd.log").read_text())

    def add_program(self, name: str, text: str) -> None:
        """In the PATH of the session, before all others."""
        self.programs.mkdir(exist_ok=True)
        path = self.programs / name
        path.write_text(text)
        path.chmod(0o755)

    def new_key(self) -> None:
        """A new host key, and an sshd that shows it, at the same port."""
        assert self._start_with_new_key(), (self.folder / "sshd.log").read_text()

    def _start_with_new_key(self) -> bool:
        self.stop_sshd()
        key = self.folder / "host_key"
        for path in (key, key.with_suffix(".pub")):
            path.unlink(missing_ok=True)
        make_key(key)
        config = self.folder / "sshd_config"
        path = f"{self.programs}:{os.environ['PATH']}"
        config.write_text(
            f"Port {self.port}\nListenAddress 127.0.0.1\nHostKey {key}\nAuthorizedKeysFile {self._authorized}\n"
            "PidFile none\nStrictModes no\nUsePAM no\nPermitRootLogin yes\nPasswordAuthentication no\n"
            "KbdInteractiveAuthentication no\nSubsystem sftp internal-sftp\nLogLevel ERROR\nMaxStartups 100\n"
            f"SetEnv HOME={self.home} XDG_RUNTIME_DIR={self.runtime} XDG_CONFIG_HOME={self.home}/.config PATH={path}\n"
        )
        with (self.folder / "sshd.log").open("ab") as log:
            self._sshd = subprocess.Popen(
                [needs("test-lab", "sshd"), "-D", "-e", "-f", str(config)], stdout=log, stderr=log
            )
        wait_until(lambda: self._answers() or self._ended(), f"sshd of {self.name} answers")
        return not self._ended()

    def _ended(self) -> bool:
        return self._sshd is None or self._sshd.poll() is not None

    def public_key(self) -> str:
        """A line of known_hosts."""
        return f"[127.0.0.1]:{self.port} " + " ".join((self.folder / "host_key.pub").read_text().split()[:2])

    def fingerprint(self) -> str:
        words = ["ssh-keygen", "-lf", str(self.folder / "host_key.pub")]
        return subprocess.run(words, check=True, capture_output=True, text=True).stdout.split()[1]

    def calls(self) -> list[str]:
        """Of `systemctl`."""
        path = self.home / "systemctl.calls"
        return path.read_text().splitlines() if path.exists() else []

    def stop_sshd(self) -> None:
        if self._sshd is not None:
            self._sshd.send_signal(signal.SIGTERM)
            self._sshd.wait(30)
            self._sshd = None

    def close(self) -> None:
        """End the service and sshd."""
        self.stop_sshd()
        pid = self.home / "skygcs.pid"
        if pid.exists():
            with contextlib.suppress(ProcessLookupError, ValueError):
                os.kill(int(pid.read_text()), signal.SIGTERM)

    def _answers(self) -> bool:
        try:
            with socket.create_connection(("127.0.0.1", self.port), timeout=1) as probe:
                return probe.recv(3) == b"SSH"
        except OSError:
            return False


def make_key(path: Path) -> None:
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-f", str(path)], check=True)


def install_programs(host: SshHost, version: str | None = None) -> None:
    """What `companions install` leaves, with this environment's programs behind it. ``version``: what they claim."""
    folder = host.home / "skygcs" / "current" / "bin"
    folder.mkdir(parents=True)
    for name in ("skygcs", "skygcs-cli"):
        text = SHIM.format(program=Path(sys.executable).with_name(name))
        if version is not None:
            text = text.replace("exec", f'[ "$1" = --version ] && {{ echo "skygcs {version}"; exit 0; }}\nexec', 1)
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)


@contextlib.contextmanager
def small_disk(folder: Path, kilobytes: int) -> Iterator[bool]:
    """A file system of this size at ``folder``; False where this user may not mount one."""
    folder.mkdir(parents=True, exist_ok=True)
    words = ["mount", "-t", "tmpfs", "-o", f"size={kilobytes}k", "none", str(folder)]
    mounted = shutil.which("mount") is not None and subprocess.run(words, capture_output=True).returncode == 0
    try:
        yield mounted
    finally:
        if mounted:
            subprocess.run(["umount", "-l", str(folder)], check=True)


@contextlib.contextmanager
def short_folder() -> Iterator[Path]:
    """With a path that leaves room for sockets in it."""
    folder = Path(tempfile.mkdtemp(prefix="skygcs-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def prepare_sshd() -> None:
    """The folder that sshd wants when root starts it; systemd makes it where systemd runs."""
    if os.getuid() == 0:
        Path("/run/sshd").mkdir(mode=0o755, exist_ok=True)
