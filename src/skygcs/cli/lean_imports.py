"""Import the daemon's libraries without what it never uses of them: a tenth of its resident memory.

- asyncio and uvloop import ssl, and with it OpenSSL. Most daemons speak no TLS: they get a stand-in with the names that
  they look up while they are imported. Any other name of it imports ssl itself.
- hashlib imports OpenSSL's hashes, too. Those built into the interpreter are the same, and 0.5 µs slower for a signed
  frame; where a distribution has built it without them, OpenSSL's are used.
- pydantic imports importlib.metadata, and with it email and zipfile, to look for plugins, which are switched off;
  zoneinfo, and with it sysconfig's thousand settings of the build, for fields that are time zones, of which skygcs has
  none; and uuid, which imports platform to learn that this is Linux.
- tempfile and argparse import shutil, which looks for the libraries of three kinds of archives.
- structlog imports pickle for the name of an error.

Whatever imports one of these later gets the real module. `skygcs web`, which serves TLS, is a process of its own that
does not come here.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import sys
import tomllib
from collections.abc import Iterator, Mapping
from importlib import util
from types import ModuleType
from typing import Any

BUILT_IN_HASHES = (
    "_md5",
    "_sha1",
    "_sha3",
    "_blake2",
    *(("_sha2",) if sys.version_info >= (3, 12) else ("_sha256", "_sha512")),
)
"""All that hashlib looks for; it reports each one that is missing."""

TABLES_WITH_TLS = ("companion", "companions")
"""Tables of extensions that serve or call over TLS inside the daemon. They stand here because OpenSSL is loaded with
asyncio or never: before anything is imported that could find an extension and ask it."""

TLS_IN_AN_ADDRESS = "ntrips://"
"""And [corrections] calls over TLS if its address begins so."""

_ERRORS = (
    "CertificateError",
    "SSLError",
    "SSLSyscallError",
    "SSLWantReadError",
    "SSLWantWriteError",
    "SSLZeroReturnError",
)
_CLASSES = ("MemoryBIO", "SSLContext", "SSLObject", "SSLSocket")
_NUMBERS = {"SSL_ERROR_WANT_READ": 2, "SSL_ERROR_WANT_WRITE": 3, "SSL_ERROR_SYSCALL": 5}
"""Values of OpenSSL's ssl.h; uvloop keeps them as C integers."""


MAX_FLEET_BYTES = 4 << 20
MAX_DOTS_OF_A_LINE = 2000
"""A fleet of 250 vehicles has 40 kB; a list of numbers in one line may have some hundred dots."""


def needs_tls(arguments: list[str]) -> bool:
    """True if one of these files has one of `TABLES_WITH_TLS`, or corrections from a caster over TLS."""
    for argument in arguments:
        try:
            text = _beginning(argument) if argument.endswith(".toml") else b""
        except OSError:
            continue  # what is wrong with it is reported when it is read
        if any(name.encode() in text for name in (*TABLES_WITH_TLS, TLS_IN_AN_ADDRESS)) and _speaks_tls(text):
            return True
    return False


def _beginning(file: str) -> bytes:
    """The whole of a fleet file; of /dev/zero and the like not more than one can have. Raises OSError."""
    with open(file, "rb") as opened:
        return opened.read(MAX_FLEET_BYTES)


def _speaks_tls(text: bytes) -> bool:
    if any(line.count(b".") > MAX_DOTS_OF_A_LINE for line in text.splitlines()):
        return False  # tomllib would need gigabytes; it is refused when it is read
    try:
        table = tomllib.loads(text.decode("utf-8-sig"))
    except (ValueError, RecursionError):
        return False
    corrections = table.get("corrections")
    address = corrections.get("ntrip") if isinstance(corrections, dict) else None
    return any(name in table for name in TABLES_WITH_TLS) or str(address).startswith(TLS_IN_AN_ADDRESS)


def prepare_daemon(*, tls: bool = False) -> None:
    """Import asyncio, uvloop, hashlib, pydantic and structlog as above; does nothing for those that are imported
    already. ``tls``: with OpenSSL, as the daemon serves or calls over TLS."""
    if not tls and "_hashlib" not in sys.modules and all(util.find_spec(name) for name in BUILT_IN_HASHES):
        with _instead_of("_hashlib", None):
            importlib.import_module("hashlib")
            importlib.import_module("hmac")
    if not tls and "ssl" not in sys.modules and "asyncio" not in sys.modules:
        with _instead_of("ssl", StandIn("ssl", _ssl_names())):
            importlib.import_module("asyncio")
            if util.find_spec("uvloop") is not None:
                importlib.import_module("uvloop")
    if "shutil" not in sys.modules:
        with contextlib.ExitStack() as stack:
            for name in ("bz2", "lzma", "zlib"):
                if name not in sys.modules:
                    stack.enter_context(_instead_of(name, None))
            importlib.import_module("shutil")
    if "pydantic" not in sys.modules:
        _import_pydantic()
    if "structlog" not in sys.modules and "pickle" not in sys.modules:
        _import_structlog()


def _import_pydantic() -> None:
    stand_ins = (
        StandIn("importlib.metadata", {"entry_points": _entry_points}),
        StandIn("platform", {"system": lambda: os.uname().sysname}),
        StandIn("zoneinfo", {"ZoneInfo": type("ZoneInfo", (), {}), "ZoneInfoNotFoundError": KeyError}),
    )
    with contextlib.ExitStack() as stack:
        for stand_in in stand_ins:
            if stand_in.__name__ not in sys.modules:
                stack.enter_context(_instead_of(stand_in.__name__, stand_in))
        importlib.import_module("pydantic.plugin")
        for name in ("pydantic.fields", "pydantic.type_adapter"):  # and all that makes a schema
            importlib.import_module(name)
        with contextlib.suppress(ImportError):  # no public module: where it is absent it is imported by nothing
            importlib.import_module("pydantic.plugin._loader")


def _import_structlog() -> None:
    from skygcs.cli.process import import_structlog  # which imports asyncio

    with _instead_of("pickle", StandIn("pickle", {"PicklingError": type("PicklingError", (Exception,), {})})):
        import_structlog()


@contextlib.contextmanager
def _instead_of(name: str, module: ModuleType | None) -> Iterator[None]:
    """An import of that name in the body returns ``module``; None: it is not installed."""
    sys.modules[name] = module  # type: ignore[assignment]
    try:
        yield
    finally:
        if sys.modules.get(name) is module:
            del sys.modules[name]


class StandIn(ModuleType):
    """A module with the names that others look up while they are imported; any other one imports the module itself."""

    def __init__(self, name: str, names: Mapping[str, Any]) -> None:
        super().__init__(name)
        self.__dict__.update(names)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # importlib looks for these, and does without
            raise AttributeError(name)
        if sys.modules.get(self.__name__) is self:
            del sys.modules[self.__name__]
        return getattr(importlib.import_module(self.__name__), name)


def _ssl_names() -> dict[str, Any]:
    errors = {name: type(name, (OSError,), {}) for name in _ERRORS}
    classes = {name: type(name, (), {}) for name in _CLASSES}
    return {**errors, **classes, **_NUMBERS, "create_default_context": _no_tls}


def _no_tls(*_: Any, **__: Any) -> Any:
    raise RuntimeError("this process was started without TLS")


def _entry_points(**selection: Any) -> Any:
    return importlib.import_module("importlib.metadata").entry_points(**selection)
