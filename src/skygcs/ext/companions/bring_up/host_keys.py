"""The SSH host keys of companions: known by a file, never accepted silently.

Two files in OpenSSH's format are read: ``known_hosts`` beside the fleet file, and the user's own. If the first names a
host, only its keys count. `HostKeys.trust` writes the first; nothing writes the user's.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skygcs.config.files import write_whole
from skygcs.errors import CompanionError, ConfigError

if TYPE_CHECKING:
    from asyncssh import SSHKey, SSHKnownHosts

FILE_NAME = "known_hosts"
SSH_PORT = 22

MAX_FILE_BYTES = 4 << 20
"""A file of 10,000 hosts has 1 MB."""


@dataclass(frozen=True, slots=True)
class Known:
    """Host keys of one host in the files. ``source`` is the file that counts; None: no file names the host."""

    keys: tuple[SSHKey, ...]
    authorities: tuple[SSHKey, ...]
    revoked: tuple[SSHKey, ...]
    source: Path | None


class HostKeys:
    """The two files, read at construction. Raises ConfigError for a file that cannot be read or has a wrong line."""

    def __init__(self, fleet_folder: Path, users_file: Path | None = None) -> None:
        self.path = fleet_folder / FILE_NAME
        users = Path("~/.ssh/known_hosts").expanduser() if users_file is None else users_file
        self._files = [(path, _read(path)) for path in (self.path, users)]

    def known(self, host: str, address: str, port: int) -> Known:
        """The keys of a host; ``address`` is its numeric address, or "" if that is not known."""
        revoked: list[SSHKey] = []
        found: Known | None = None
        for path, hosts in self._files:
            if hosts is None:
                continue
            keys, authorities, withdrawn, *_ = hosts.match(host, address, None if port == SSH_PORT else port)
            revoked += withdrawn
            if found is None and (keys or authorities):
                found = Known(_each_once(keys), tuple(authorities), (), path)
        if found is None:
            return Known((), (), _each_once(revoked), None)
        return Known(found.keys, found.authorities, _each_once(revoked), found.source)

    def trust(self, host: str, port: int, key: SSHKey) -> None:
        """Write this key to the file beside the fleet file, in place of any other one of this host."""
        pattern = host if port == SSH_PORT else f"[{host}]:{port}"
        line = " ".join((pattern, *key.export_public_key("openssh").decode("ascii").split()[:2]))
        before = self.path.read_text(encoding="utf-8").splitlines() if self.path.exists() else []
        kept = [other for other in before if other.startswith("@") or pattern not in _patterns(other)]
        _write(self.path, "\n".join([*kept, line]) + "\n")
        self._files[0] = (self.path, _read(self.path))


def refusal(known: Known, presented: SSHKey | None, name: str, place: str) -> CompanionError:
    """Why a host's key is not accepted, with fingerprints and what to do."""
    new = "unknown" if presented is None else fingerprint(presented)
    if presented is not None and presented in known.revoked:
        return CompanionError(
            "host key", f"{place} shows a revoked key, {new}: do not connect", "find out which host it is"
        )
    if known.source is None:
        return CompanionError(
            "host key",
            f"{place} is not known; it shows {new}",
            "compare it (there: ssh-keygen -lf /etc/ssh/ssh_host_ed25519_key.pub), then "
            f"skygcs-cli companions trust {name}",
        )
    old = ", ".join(fingerprint(key) for key in known.keys) or "one of an authority"
    return CompanionError(
        "host key",
        f"{place} has changed its key: {old} in {known.source}, now {new}",
        "another computer may answer there; if it was set up anew, compare the new one and "
        f"skygcs-cli companions trust {name}",
    )


def fingerprint(key: SSHKey) -> str:
    """The fingerprint as ssh-keygen -l shows it, with the kind of key."""
    return f"{key.get_algorithm().removeprefix('ssh-')} {key.get_fingerprint()}"


def _each_once(keys: Iterable[SSHKey]) -> tuple[SSHKey, ...]:
    """A numeric host is found by name and by address."""
    once: list[SSHKey] = []
    once += (key for key in keys if key not in once)
    return tuple(once)


def _patterns(line: str) -> list[str]:
    return line.split(None, 1)[0].split(",") if line.strip() and not line.startswith("#") else []


def _read(path: Path) -> SSHKnownHosts | None:
    """None if there is no such file."""
    from asyncssh import import_known_hosts

    try:
        with path.open("rb") as file:
            data = file.read(MAX_FILE_BYTES + 1)
        if len(data) > MAX_FILE_BYTES:
            raise ConfigError(str(path), [f"is larger than {MAX_FILE_BYTES >> 20} MiB: is it a known_hosts file?"])
        return import_known_hosts(data.decode("utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror or error}"]) from None
    except ValueError as error:
        raise ConfigError(str(path), [f"is not a known_hosts file: {str(error)[:200]}"]) from None


def _write(path: Path, text: str) -> None:
    """Raises ConfigError."""
    try:
        write_whole(path, text.encode(), 0o600)
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be written: {error.strerror or error}"]) from None
