"""docs/reference/rpc.md says what the methods of the station socket say."""

from __future__ import annotations

import asyncio
import sys
import tempfile
from pathlib import Path

from skygcs.config.models import FleetConfig
from skygcs.ext.federation.bridge import station_socket
from skygcs.ext.federation.bridge.nkeys_files import write_new_seed
from skygcs.ext.federation.bridge.process import FederationOptions, FederationProcess
from skygcs.ext.federation.bridge.station_methods import DESCRIBED, station_methods
from skygcs.ext.federation.config import FederationConfig
from support.rpc_reference import reference

PAGE = Path(__file__).parents[5] / "docs" / "reference" / "rpc.md"


async def described(folder: Path) -> str:
    """Of a site that has everything."""
    write_new_seed(folder / "north.nk")
    table = {"site": "north", "servers": ["nats://127.0.0.1:4222"], "nkey": str(folder / "north.nk")}
    found = FederationConfig.model_validate({**table, "vehicles": {"alpha": {"home": "north"}}})
    fleet = FleetConfig(extensions={"federation": found})
    process = FederationProcess(fleet, FederationOptions(str(folder / "d.sock")))
    assert DESCRIBED.keys() <= process.station.methods.keys()
    return reference(station_methods(process.station.methods).values())


async def test_every_method_of_the_station_is_described_as_it_is(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert await described(tmp_path) in text
    assert f"| clients of the station socket | {station_socket.MAX_CLIENTS} |" in text


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as made:
        sys.stdout.write(asyncio.run(described(Path(made))))
