"""The extension of docs/howto/extension.md, installed from another folder by its entry point, in a whole daemon."""

from __future__ import annotations

import asyncio
import contextlib
import math
import re
import sys
from collections.abc import AsyncIterator, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from skygcs.config.control import ControlSettings
from skygcs.config.loader import load_fleet_and_dialect
from skygcs.config.models import VehicleSettings
from skygcs.config.tables import Model
from skygcs.core.routing.send_gates import SendGate
from skygcs.core.vehicle.flight_lock import Holder
from skygcs.daemon import Daemon
from skygcs.errors import ConfigError, RpcError
from skygcs.extension import Extension, Extensions, NoTable
from skygcs.rpc.client import connect
from support.daemons import started
from support.flown import aloft
from support.send_gate import TimedGate

PAGE = (Path(__file__).parents[2] / "docs/howto/extension.md").read_text()
FLEET = """
[daemon]
socket = "s"
record = false

[links.air]
type = "simulated"
px4 = 1
"""


def listing(title: str) -> str:
    """The code block of the page with this title."""
    found = re.search(rf'```\w+ title="{re.escape(title)}"\n(.*?)```', PAGE, re.DOTALL)
    assert found is not None, title
    return found.group(1)


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The example as pip would install it; the folder for a fleet file."""
    site = tmp_path / "site"
    metadata = site / "skygcs_beacon-0.1.dist-info"
    metadata.mkdir(parents=True)
    (site / "skygcs_beacon.py").write_text(listing("skygcs_beacon.py"))
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: skygcs-beacon\nVersion: 0.1\n")
    entry = re.search(r"^beacon = \"(.*)\"$", listing("pyproject.toml"), re.MULTILINE)
    assert entry is not None
    (metadata / "entry_points.txt").write_text(f"[skygcs.extensions]\nbeacon = {entry.group(1)}\n")
    monkeypatch.syspath_prepend(site)
    yield tmp_path
    sys.modules.pop("skygcs_beacon", None)


@contextlib.asynccontextmanager
async def running(folder: Path, table: str) -> AsyncIterator[Daemon]:
    path = folder / "fleet.toml"
    path.write_text(FLEET + table)
    config, dialect = load_fleet_and_dialect(path)
    daemon = Daemon(config, dialect, source=str(path))
    async with started(daemon):
        yield daemon


async def test_its_table_method_state_clock_and_order_check_work(installed: Path) -> None:
    async with running(installed, listing("fleet.toml")), connect(installed / "s") as client:
        await asyncio.sleep(5.0)  # its position has come
        # without a clearance an order is refused, and what ends a flight is not
        refused = (await client.call("vehicles.takeoff", targets="all", height_m=5))["outcomes"]
        assert {o["result"] for o in refused.values()} == {"refused"}
        assert all("range officer" in o["message"] for o in refused.values())
        stopped = (await client.call("vehicles.stop", targets="all"))["outcomes"]
        assert all("range officer" not in o["message"] for o in stopped.values())
        # with one it passes
        assert await client.call("beacon.clear", by="Ada") == {"clear": True, "by": "Ada"}
        await asyncio.sleep(0.5)
        (state,) = await client.call("vehicles.list")
        assert state["beacon"] == {"clear": True, "by": "Ada"}
        armed = (await client.call("vehicles.arm", targets="all", wait_s=4))["outcomes"]
        assert all("range officer" not in o["message"] for o in armed.values())
        # its keys are the fleet file's, its clock reports the end
        await client.call("beacon.clear", by="Ada")
        await asyncio.sleep(4.5)
        assert (await client.call("vehicles.list"))[0]["beacon"]["clear"] is True
        await asyncio.sleep(1.0)
        events = [e["text"] for e in await client.call("events.recent") if e["kind"] == "beacon"]
        assert events == ["clearance by Ada", "the clearance has ended"]
        # it is described
        names = [method["name"] for method in (await client.call("rpc.discover"))["methods"]]
        assert "beacon.clear" in names
        with pytest.raises(RpcError, match="by"):
            await client.call("beacon.clear")


@pytest.mark.parametrize(
    ("table", "problem"),
    [
        ("[beacon]\nvalid_s = 100\n", r"beacon.valid_s \(line 10\): must be at most 60, not 100"),
        ("[beacon]\nvalids = 1\n", r"beacon.valids \(line 10\): unknown key; did you mean valid_s\?"),
        ("[becon]\n", r"becon \(line 9\): unknown key; did you mean beacon\?"),
        ("[extensions.beacon]\n", r"extensions \(line 9\): unknown key"),
    ],
)
def test_a_wrong_table_is_named_with_key_and_line(installed: Path, table: str, problem: str) -> None:
    path = installed / "fleet.toml"
    path.write_text(FLEET + table)
    with pytest.raises(ConfigError, match=problem):
        load_fleet_and_dialect(path)


def test_one_that_cannot_be_imported_is_a_problem_of_its_table(installed: Path) -> None:
    (installed / "site" / "skygcs_beacon.py").write_text("import no_such_package\n")
    path = installed / "fleet.toml"
    path.write_text(FLEET + "[beacon]\n")
    with pytest.raises(ConfigError, match=r"beacon \(line 9\): its extension .* cannot be imported: .*no_such_package"):
        load_fleet_and_dialect(path)


class Failing(Extension[Any]):
    """One whose hooks raise."""

    def state_groups(self) -> Any:
        return {"failing": self._raise}

    def order_refusal(self, vehicle: Any, plan: Any, now: float) -> str | None:
        return self._raise()

    def close(self) -> None:
        self._raise()

    def _raise(self, *_: Any) -> Any:
        raise ValueError("broken")


class _Plan:
    """An order of a plan; the rest is not read."""

    def __init__(self, order: str, *, emergency: bool = False) -> None:
        self.order, self.emergency = order, emergency


def test_a_fault_of_one_refuses_orders_but_none_that_ends_a_flight() -> None:
    faults: list[Exception] = []
    extensions = Extensions({"failing": Failing(None, None)}, faults.append)  # type: ignore[arg-type]
    assert "could not check it" in str(extensions.order_refusal(None, _Plan("takeoff"), 0.0))  # type: ignore[arg-type]
    for order in ("land", "rtl", "hold", "stop", "disarm", "release"):
        assert extensions.order_refusal(None, _Plan(order), 0.0) is None  # type: ignore[arg-type]
    assert extensions.order_refusal(None, _Plan("goto", emergency=True), 0.0) is None  # type: ignore[arg-type]
    assert extensions.groups_of(None, 0.0, None) == {"failing": None}  # type: ignore[arg-type]
    extensions.close()
    assert len(faults) == 3


def test_one_is_made_on_demand_while_others_are_started(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client called a method of it at the begin of the daemon: RuntimeError, and the daemon ended."""
    monkeypatch.setattr("skygcs.extension.find_on_demand", lambda word: Extension)
    extensions = Extensions(
        {"a": Extension(None, NoTable()), "b": Extension(None, NoTable())}, [].append, SimpleNamespace()
    )  # type: ignore[arg-type]
    for begun, _ in enumerate(extensions):
        extensions.demand(f"other{begun}")
    assert len([*extensions]) == 4


async def test_one_that_fails_to_accept_clients_tries_again_and_others_go_on() -> None:
    begun: list[float] = []
    faults: list[Exception] = []

    class Door(Extension[Any]):
        async def serve(self, new_session: Any) -> None:
            begun.append(asyncio.get_running_loop().time())
            raise ValueError("broken")

    extensions = Extensions({"door": Door(None, None), "failing": Failing(None, None)}, faults.append)  # type: ignore[arg-type]
    with contextlib.suppress(TimeoutError):
        async with asyncio.timeout(2.5):
            await extensions.serve(lambda admits: asyncio.Protocol())
    assert begun == [0.0, 1.0, 2.0] and len(faults) == 3


async def test_a_daemon_without_what_flies_its_vehicles_does_not_start(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    config, dialect = load_fleet_and_dialect(path)
    elsewhere = VehicleSettings(control=ControlSettings(at="companion"))
    with pytest.raises(ConfigError, match=r"defaults.control.at: must be one of ground, not 'companion'"):
        Daemon(config.model_copy(update={"defaults": elsewhere}), dialect)


class Range(Extension[Any]):
    """One that gates v1; its gate is open until a test closes it."""

    Config = Model

    def __init__(self, core: Any, config: Any) -> None:
        super().__init__(core, config)
        self.gate = TimedGate(1)
        self.gate.until[1] = math.inf

    def send_gate(self) -> SendGate | None:
        return self.gate


RANGE = {"vehicles": {"v1": {"sysid": 1}}, "extensions": {"range": Model()}}


@pytest.mark.parametrize("how", ["closed", "failing"])
async def test_one_of_any_name_gates_what_is_sent_to_a_vehicle(
    how: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("skygcs.daemon.find_owners", lambda names: (dict.fromkeys(names, Range), []))
    async with aloft(tmp_path, tables=RANGE) as gcs:
        gate: TimedGate = gcs.daemon.extensions["range"].gate
        await gcs.fly("position")
        began = gcs.now
        if how == "closed":
            gate.until[1], words = began, "1 is not ours now"
        else:
            gate.fault, words = ValueError("broken"), "[range] could not be asked"
        await asyncio.sleep(1.0)
        # nothing leaves, control ends, an order is refused in words
        assert [s for s in gcs.sent if s.at > began] == []
        assert gcs.control()["state"] == "off"
        (told,) = gcs.texts(began, "authority")
        assert words in told
        assert words in str(await gcs("vehicles.land", targets="v1"))
        assert "[range] decides" in str(await gcs("vehicles.renumber", target="v1", sysid=9))
        # when it opens again, orders pass; the stop passes always
        gate.fault, gate.until[1] = None, math.inf
        await asyncio.sleep(0.5)
        assert gcs.texts(began, "authority")[1:] == ["v1 may be commanded from here"]
        await gcs.done("vehicles.hold")
        gate.fault = ValueError("broken")
        await gcs.done("vehicles.stop", action="land")
        gcs.told.clear()  # the faults


async def test_a_flight_of_one_that_fails_refuses_what_would_change_it_and_is_a_fault_of_the_daemon(
    tmp_path: Path,
) -> None:
    def broken() -> bool:
        raise ValueError("broken")

    async with aloft(tmp_path) as gcs:
        locks, actor = gcs.daemon.fleet.locks, gcs.actor()
        flown_ = [(actor.vehicle, actor.config.control)]
        locks.take(locks.make(Holder.PLAN, "show", gcs.daemon.fleet.world.origin, flown_), broken)
        refused = await gcs.outcome("vehicles.set_home", lat_deg=43.8, lon_deg=-79.5, force=True)
        assert not refused["ok"] and "could not say whether it has ended" in refused["message"], refused
        await gcs.done("vehicles.goto", enu_m=[5.0, 5.0, 12.0])
        await gcs.done("vehicles.land")
        assert (await gcs("daemon.info"))["faults"] > 0
        assert [told.text for told in gcs.told if told.kind == "fault"] == [
            "internal fault, please report it: ValueError: broken"
        ]
        gcs.told.clear()


async def test_a_daemon_does_not_start_without_a_gate_that_was_promised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(self: Range) -> None:
        raise ValueError("broken")

    monkeypatch.setattr(Range, "send_gate", broken)
    monkeypatch.setattr("skygcs.daemon.find_owners", lambda names: (dict.fromkeys(names, Range), []))
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    config, dialect = load_fleet_and_dialect(path)
    with pytest.raises(ValueError, match="broken"):
        Daemon(config.model_copy(update={"extensions": {"range": Model()}}), dialect)


async def test_a_wait_for_the_end_of_one_that_is_cancelled_leaves_no_socket(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def ended(self: Range) -> None:
        raise asyncio.CancelledError

    monkeypatch.setattr(Range, "ended", ended)
    monkeypatch.setattr("skygcs.daemon.find_owners", lambda names: (dict.fromkeys(names, Range), []))
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    config, dialect = load_fleet_and_dialect(path)
    daemon = Daemon(config.model_copy(update={"extensions": {"range": Model()}}), dialect)
    task = asyncio.create_task(daemon.run())
    await daemon.ready.wait()
    assert (tmp_path / "s").exists()
    daemon.stop()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert not (tmp_path / "s").exists()


def test_names_that_are_not_its_own_are_refused() -> None:
    class Thief(Extension[Any]):
        def state_groups(self) -> Any:
            return {"position": lambda vehicle, now: {}}

    with pytest.raises(ConfigError, match="the state group position: the name must begin with thief"):
        Extensions({"thief": Thief(None, None)}, lambda error: None)  # type: ignore[arg-type]
