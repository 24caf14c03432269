"""What a start must not wait for: modules that neither the first frame nor `skygcs-cli status` need. No times."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from support.hanging import HANG_S

pytestmark = pytest.mark.system

HEAVY = ("matplotlib", "numpy", "pyarrow", "pygments", "pymap3d", "pymavlink", "lxml", "rich", "typer")
"""From 30 ms (rich) to 600 ms (pymavlink's generated dialects), and together three times a daemon's memory."""

SPARED = (
    "_bz2",
    "_hashlib",
    "_lzma",
    "_ssl",
    "colorama",
    "difflib",
    "email",
    "fastcrc",
    "greenlet",
    "importlib.metadata",
    "pickle",
    "platform",
    "skygcs.core.plan",
    "skygcs.links.simulated",
    "skygcs.core.preflight.table",
    "skygcs.ext.companions.companion_control",
    "skygcs.ext.companions.ground_orders",
    "skygcs.ext.plans",
    "skygcs.sim",
    "sysconfig",
    "zipfile",
)
"""Of libraries that the daemon loads, what it never uses of them: OpenSSL alone is 5 MB (`skygcs.cli.lean_imports`). Of
skygcs what a daemon imports when it is first asked for, or where the fleet file asks for it."""

NEEDED = (
    "skygcs.core.control.deadman",
    "skygcs.core.control.guard",
    "skygcs.core.vehicle.offboard_controller",
    "skygcs.core.vehicle.orders",
    "skygcs.rpc.control",
    "skygcs.rpc.vehicles",
    "skygcs.runtime.command_client",
    "skygcs.runtime.operator_watchdog",
    "skygcs.runtime.order_runner",
    "skygcs.runtime.undo_journal",
    "skygcs.runtime.vehicle_actor",
)
"""What an order and a failsafe need: the first one in an emergency waits for no import."""

SOCKET_SIDE = ("skygcs.rpc.methods", "skygcs.rpc.models", "skygcs.rpc.sessions")
"""What clients of the socket need; imported beside the loop when frames are forwarded already."""

RUN = """
import asyncio, sys
from skygcs.cli import process, serve
watched = sys.argv[2:]
loaded = lambda: [m for m in watched if m in sys.modules]
async def served(daemon, **_):
    print("before", *loaded())
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    print("after", *loaded())
    daemon.stop()
    await running
serve.serve_until_signal = served
serve.main(["run", "-q", sys.argv[1]])
"""

AS_INSTALLED = """
import sys
from skygcs import __main__ as entry
fleet, watched = sys.argv[1], sys.argv[2:]
async def served(daemon, **_):
    import asyncio
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    print("loaded", *[m for m in watched if m in sys.modules])
    daemon.stop()
    await running
class Watch:
    def find_spec(self, name, path, target=None):
        if name == "skygcs.daemon":
            sys.modules["skygcs.cli.serve"].serve_until_signal = served
sys.meta_path.insert(0, Watch())
sys.argv = ["skygcs", "run", "-q", fleet]
entry.main()
"""

WITH_A_VEHICLE = """
import asyncio, sys
from skygcs.cli import process, serve
from skygcs.rpc.client import Client
watched = sys.argv[3:]
async def served(daemon, **_):
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    async with Client(sys.argv[2]) as gcs:
        while not any((state.get("position") or {}).get("enu_m") for state in await gcs.call("vehicles.list")):
            await asyncio.sleep(0.1)
    print("loaded", *[m for m in watched if m in sys.modules])
    daemon.stop()
    await running
serve.serve_until_signal = served
serve.main(["run", "-q", sys.argv[1]])
"""

WITH_PLANS = """
import asyncio, sys
from skygcs.cli import process, serve
from skygcs.rpc.client import Client
watched = sys.argv[3:]
loaded = lambda: [m for m in watched if m in sys.modules]
async def served(daemon, **_):
    running = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    async with Client(sys.argv[2]) as gcs:
        async for plan in gcs.plan(rate_hz=1.0):
            break
        print("shown", *loaded())
        await gcs.call("plan.status")
        print("asked", *loaded())
    daemon.stop()
    await running
serve.serve_until_signal = served
serve.main(["run", "-q", sys.argv[1]])
"""


def loaded(code: str, *arguments: str) -> list[set[str]]:
    """The words of each line that the code printed, without the first."""
    done = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=HANG_S)
    assert done.returncode == 0, done.stderr
    return [set(line.split()[1:]) for line in done.stdout.splitlines()]


@pytest.fixture
def fleet(tmp_path: Path) -> Path:
    """Its dialect's table is made: that may take mavgen and a validator."""
    path = tmp_path / "fleet.toml"
    path.write_text(f'[daemon]\nsocket = "{tmp_path}/s"\nlog_dir = "{tmp_path}/logs"\n')
    loaded(RUN, str(path))
    return path


def test_a_daemon_loads_nothing_heavy_and_what_its_socket_needs_last(fleet: Path) -> None:
    before, after = loaded(RUN, str(fleet), *HEAVY, *SOCKET_SIDE)
    assert before == set()
    assert after == set(SOCKET_SIDE)


def test_a_daemon_has_what_an_emergency_needs_and_nothing_that_it_never_uses(fleet: Path) -> None:
    assert loaded(AS_INSTALLED, str(fleet), *HEAVY, *SPARED, *NEEDED) == [set(NEEDED)]


def test_a_fleet_file_makes_the_validators_of_its_own_links_only(tmp_path: Path) -> None:
    """Those of all ten types take 1 MB and 15 ms."""
    fleet = tmp_path / "fleet.toml"
    fleet.write_text('[links.a]\ntype = "udp_server"\nport = 14550\n')
    code = (
        "import sys\nfrom skygcs.config.loader import load_fleet\nfrom skygcs.config.models import LINK_TYPES\n"
        "load_fleet(sys.argv[1])\nprint('made', *[k for k, m in LINK_TYPES.items() if m.__pydantic_complete__])\n"
    )
    assert loaded(code, str(fleet)) == [{"udp_server"}]


def test_a_vehicle_with_a_place_in_the_world_loads_nothing_heavy(tmp_path: Path, fleet: Path) -> None:
    fleet.write_text(
        fleet.read_text() + "[origin]\nlat_deg = 43.7806\nlon_deg = -79.4653\nalt_amsl_m = 180.0\n"
        '[links.field]\ntype = "simulated"\npx4 = 1\n'
    )
    assert loaded(WITH_A_VEHICLE, str(fleet), f"{tmp_path}/s", *HEAVY) == [set()]


def test_plans_are_imported_when_one_of_their_methods_is_called(tmp_path: Path, fleet: Path) -> None:
    """Not for a page that shows the status of the plan, of which there is none; and numpy never."""
    rooms = ("skygcs.core.plan", "skygcs.ext.plans", "skygcs.ext.plans.plan_runner")
    assert loaded(WITH_PLANS, str(fleet), f"{tmp_path}/s", *rooms, "numpy") == [set(), set(rooms)]


def test_rich_can_be_imported_after_the_log_was_set_up() -> None:
    code = (
        "import sys\nfrom skygcs.cli.process import configure_logging\nconfigure_logging()\n"
        "print('hidden', *[m for m in ('rich',) if m in sys.modules])\nimport rich.console, structlog\n"
        "structlog.get_logger('x').error('still told')\n"
    )
    assert loaded(code) == [set()]


def test_a_command_is_looked_for_without_what_others_need() -> None:
    code = "import sys\nimport skygcs.cli.main\nprint('loaded', *[m for m in sys.argv[1:] if m in sys.modules])"
    heavy = set(HEAVY) - {"typer"} | {"structlog", "uvloop", "pydantic", "skygcs.config.models"}
    assert loaded(code, *heavy) == [set()]


@pytest.mark.parametrize(("entry", "library"), [("main", "pydantic"), ("cli", "typer")])
@pytest.mark.parametrize("ignored", [False, True])
def test_ctrl_c_during_the_imports_ends_a_program_without_a_traceback(
    tmp_path: Path, entry: str, library: str, ignored: bool
) -> None:
    """A library that interrupts its importer. What a shell started with Ctrl-C ignored goes on, and ends with 7."""
    (tmp_path / f"{library}.py").write_text("import os, signal; os.kill(os.getpid(), signal.SIGINT); os._exit(7)")
    begin = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN); " if ignored else ""
    words = ["run", str(tmp_path / "fleet.toml")] if entry == "main" else ["status"]
    done = subprocess.run(
        [sys.executable, "-c", f"{begin}from skygcs.__main__ import {entry}; {entry}()", *words],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert (done.returncode, done.stderr) == (7 if ignored else -signal.SIGINT, "")
