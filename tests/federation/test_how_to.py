"""The try-out of docs/howto/federation.md, command by command: two sites, their hub and a page on one computer."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import re
import shlex
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import aiohttp

from skygcs.errors import SkygcsError
from skygcs.web.control_socket import ask_for_link, find_control
from support.hanging import HANG_S
from support.process import ROOT, free_port, wait_until

PAGE = ROOT / "docs" / "howto" / "federation.md"
CLI = str(Path(sys.executable).with_name("skygcs-cli"))


def commands() -> list[list[str]]:
    """The lines of the page's first steps that begin with `skygcs-cli`."""
    begin = PAGE.read_text().partition("## Try it on one computer")[2].partition("## ")[0]
    lines = [line for block in re.findall(r"```sh\n(.*?)```", begin, re.S) for line in block.splitlines()]
    return [shlex.split(line, comments=True) for line in lines if line.startswith("skygcs-cli")]


@contextlib.contextmanager
def two_sites(folder: Path) -> Iterator[None]:
    """Made by `skygcs init federation`, on another port than the usual one."""
    port = str(free_port(socket.SOCK_STREAM))
    skygcs = [sys.executable, "-m", "skygcs"]
    subprocess.run([*skygcs, "init", "federation", str(folder)], check=True)
    for file in folder.glob("*.toml"):
        file.write_text(file.read_text().replace("4222", port))
    processes = [subprocess.Popen([*skygcs, "federation", "up"], cwd=folder)]
    try:
        for name in ("north", "south"):
            wait_until((folder / f"{name}.nk").exists, "the hub makes the keys")
            processes.append(subprocess.Popen([*skygcs, "run", "-q", f"{name}.toml"], cwd=folder))
        yield
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            process.communicate(timeout=HANG_S)
    assert [process.returncode for process in processes] == [0, 0, 0]


def printed_by_the_program(folder: Path, wanted: str) -> bool:
    """Whether the page's Python prints this word."""
    (program,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.S)
    (folder / "program.py").write_text(program)
    with subprocess.Popen([sys.executable, "-u", "program.py"], cwd=folder, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        try:
            return any(wanted in line.split() for line in itertools.islice(run.stdout, 1000))
        finally:
            run.kill()


def until_done(line: list[str], folder: Path) -> str:
    """What the command prints once it succeeds: a vehicle that was just started takes off when it has a position."""

    def done() -> str | None:
        run = subprocess.run([CLI, *line[1:]], cwd=folder, capture_output=True, text=True, timeout=HANG_S)
        return run.stdout + run.stderr if run.returncode == 0 else None

    return str(wait_until(done, " ".join(line)))


def test_every_command_of_the_try_out_does_what_the_page_says(tmp_path: Path) -> None:
    with two_sites(tmp_path):
        status = [CLI, "--socket", "north.sock", "status"]
        for vehicle in ("alpha", "south/carol", "south/delta"):
            wait_until(lambda wanted=vehicle: wanted in until_done(status, tmp_path), f"north shows {vehicle}")
        said = {" ".join(line[3:]): until_done(line, tmp_path) for line in commands()}
        assert len(said) == 6
        assert "south " in said["federation sites"]
        assert "south/carol" in said["takeoff south/carol 10"]
        assert all(name in said["stop */all"] for name in ("alpha", "bravo", "south/carol", "south/delta"))
        for site in ("north", "south"):
            (log, *_) = (tmp_path / "collected" / site).glob("*.tlog")
            there = tmp_path / f"{site}-logs" / log.name
            assert there.read_bytes().startswith(log.read_bytes()) and log.stat().st_size > 0
        assert printed_by_the_program(tmp_path, "south/carol")
        assert asyncio.run(seen_on_the_page(tmp_path)) >= {"alpha", "bravo", "south/carol", "south/delta"}


async def seen_on_the_page(folder: Path) -> set[str]:
    """The vehicles that a browser is sent."""
    port = free_port(socket.SOCK_STREAM)
    path = str(folder / "north.sock")
    line = [sys.executable, "-m", "skygcs", "web", "--no-open", "--socket", path, "--port", str(port)]
    process = await asyncio.create_subprocess_exec(*line, cwd=folder, stdout=subprocess.DEVNULL)
    base, names = f"http://127.0.0.1:{port}", set[str]()
    try:
        async with asyncio.timeout(HANG_S), aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True)) as http:
            address = await asyncio.to_thread(wait_until, lambda: link(path, port), "the page's address")
            await http.get(address, allow_redirects=False)
            page = await http.ws_connect(f"{base}/ws", origin=base, max_msg_size=0)
            await page.send_str(json.dumps({"jsonrpc": "2.0", "id": 1, "method": "web.subscribe", "params": {}}))
            while len(names) < 4:
                told = json.loads((await page.receive()).data)
                if told.get("method") == "web.state":
                    names.update(vehicle["name"] for vehicle in told["params"]["vehicles"])
            await page.close()
    finally:
        process.terminate()
        await process.wait()
    return names


def link(path: str, port: int) -> str | None:
    """An address of the page at this port; None while it starts."""
    try:
        return ask_for_link(find_control(path, port), "view")
    except SkygcsError:
        return None
