"""The stand-ins of a daemon's imports: what they spare, and that whoever needs the real module gets it."""

from __future__ import annotations

import hashlib
import hmac
import os
import subprocess
import sys
from pathlib import Path

import pytest

from skygcs.cli.lean_imports import StandIn, needs_tls
from support.table import each

PREPARED = "from skygcs.cli.lean_imports import prepare_daemon\nprepare_daemon()\nimport sys\n"


def printed(code: str) -> str:
    """What the code prints in a process of its own, prepared as a daemon's."""
    environment = {**os.environ, "PYDANTIC_DISABLE_PLUGINS": "__all__"}
    done = subprocess.run(
        [sys.executable, "-c", PREPARED + code], capture_output=True, text=True, timeout=100, env=environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_prepared_process_has_loop_and_models_without_openssl_and_metadata() -> None:
    spared = ("_hashlib", "_ssl", "email", "importlib.metadata", "pickle", "ssl", "zipfile")
    code = f"import asyncio, pydantic, structlog, uvloop\nprint([m for m in {spared} if m in sys.modules])"
    assert printed(code) == "[]"


def test_the_real_modules_can_be_imported_afterwards() -> None:
    code = (
        "import hashlib, hmac, importlib.metadata, pickle, pydantic.plugin._loader as loader, ssl, structlog\n"
        "print(ssl.create_default_context().verify_mode.name, importlib.metadata.version('uvloop').count('.'),\n"
        "      hmac.new(b'k', b'm', 'sha256').hexdigest()[:8], len(list(loader.entry_points(group='pytest11'))) > 0,\n"
        "      pickle.loads(pickle.dumps(structlog.PrintLogger()))._file is sys.stdout)"
    )
    digest = hmac.new(b"k", b"m", "sha256").hexdigest()[:8]
    assert printed(code) == f"CERT_REQUIRED 2 {digest} True True"


def test_hashes_are_the_same_without_openssl() -> None:
    names = sorted(hashlib.algorithms_guaranteed - {"shake_128", "shake_256"})
    code = f"import hashlib\nprint([hashlib.new(n, b'frame').hexdigest() for n in {names}])"
    assert printed(code) == str([hashlib.new(name, b"frame").hexdigest() for name in names])


@each("loop", ["asyncio", "uvloop"])
def test_both_loops_serve_sockets_and_refuse_tls(loop: str) -> None:
    code = (
        "import asyncio, uvloop\n"
        "async def work():\n"
        "    async def echo(reader, writer):\n"
        "        writer.write(await reader.read(2)); writer.close()\n"
        "    server = await asyncio.start_server(echo, '127.0.0.1', 0)\n"
        "    port = server.sockets[0].getsockname()[1]\n"
        "    reader, writer = await asyncio.open_connection('127.0.0.1', port)\n"
        "    writer.write(b'ok'); print((await reader.read()).decode()); writer.close()\n"
        "    try:\n"
        "        await asyncio.open_connection('127.0.0.1', port, ssl=True)\n"
        "    except (RuntimeError, OSError) as error:\n"
        "        print(type(error).__name__)\n"
        "    server.close()\n"
        f"factory = uvloop.new_event_loop if {loop == 'uvloop'} else None\n"
        "with asyncio.Runner(loop_factory=factory) as runner: runner.run(work())\n"
    )
    assert printed(code).split() == ["ok", "RuntimeError"]


def test_a_process_that_has_imported_them_whole_keeps_them() -> None:
    code = (
        "import asyncio, hashlib, ssl, sys\n"
        "from skygcs.cli.lean_imports import prepare_daemon\nprepare_daemon()\n"
        "print(sys.modules['ssl'] is ssl, asyncio.sslproto.ssl is ssl, '_hashlib' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=100)
    assert done.stdout.split() == ["True", "True", "True"], done.stderr


def test_a_name_that_a_stand_in_lacks_comes_from_the_module(monkeypatch: pytest.MonkeyPatch) -> None:
    stand_in = StandIn("colorsys", {"ONE_THIRD": 0})
    monkeypatch.setitem(sys.modules, "colorsys", stand_in)
    assert stand_in.ONE_THIRD == 0
    assert stand_in.rgb_to_hsv(0.0, 0.0, 1.0) == (2 / 3, 1.0, 1.0)
    assert sys.modules["colorsys"] is not stand_in
    with pytest.raises(AttributeError):
        _ = stand_in.__path__


@each(
    ("text", "needs"),
    [
        ("[companion]\nvehicle = 'a'\n", True),
        ("[companions.a]\nhost = 'h'\n", True),
        ("companions = { a = { host = 'h' } }\n", True),
        ("[corrections]\nntrip = 'ntrips://h/M'\n", True),
        ("[corrections]\nntrip = 'ntrip://h/M'\n# or ntrips://h/M\n", False),
        ("corrections = 'ntrips://h/M'\n", False),
        ("# [companion]\n[links.companion]\ntype = 'memory'\n", False),
        ("[companion\n", False),
        ("", False),
    ],
)
def test_a_daemon_that_speaks_tls_is_known_by_its_tables(text: str, needs: bool, tmp_path: Path) -> None:
    (tmp_path / "fleet.toml").write_text(text)
    assert needs_tls(["-q", str(tmp_path / "fleet.toml")]) is needs
    assert not needs_tls([str(tmp_path / "absent.toml"), str(tmp_path)])
