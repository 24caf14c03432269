"""The radio at the ground's port: passes data on, answers on its command line, and reaches whom its settings let it."""

from __future__ import annotations

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.ground_radio import GroundRadio
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import TdmConfig, TdmNetwork
from skygcs.sim.vehicle_group import make_vehicles

DIALECT = load_dialect("ardupilotmega")
FIELD = LocalFrame(43.78, -79.46, 180.0)


class Bench:
    """A ground station at the port, in steps of 20 ms."""

    def __init__(self, vehicles: int = 2, baud: int = 57600) -> None:
        sims = make_vehicles(DIALECT, px4=vehicles, ardupilot=0, first_sysid=1, home=FIELD)
        network = TdmNetwork(TdmConfig(vehicles + 1, baud=baud), DIALECT, Rng(1))
        self.air = RadioFleet(sims, network, DIALECT)
        self.ground = GroundRadio(self.air)
        self.baud = baud
        self.now = 0.0
        self._up = FrameParser(DIALECT)

    def write(self, data: bytes) -> None:
        for frame in self._up.feed(self.ground.hear(data, self.now, self.baud)):
            self.air.uplink(frame.raw, self.now)

    def read(self, seconds: float) -> bytes:
        out = b""
        end = self.now + seconds
        while self.now < end:
            self.now = round(self.now + 0.02, 6)
            out += self.ground.step(self.air.step(self.now), self.now, self.baud)
        return out

    def heard(self, seconds: float) -> set[int]:
        """System ids whose frames come out of the port."""
        return {frame.sysid for frame in FrameParser(DIALECT).feed(self.read(seconds))}

    def command_line(self) -> bytes:
        self.read(1.2)
        self.write(b"+++")
        return self.read(1.2)

    def ask(self, command: str, seconds: float = 0.2) -> str:
        self.write(command.encode() + b"\r")
        return self.read(seconds).decode("latin-1")


def test_vehicles_are_heard_and_hear() -> None:
    bench = Bench()
    assert bench.heard(5.0) == {1, 2}
    values = {"target_system": 2, "param_id": "MAV_SYS_ID", "param_index": -1}
    bench.write(encode(DIALECT.by_name["PARAM_REQUEST_READ"], values, sysid=255, compid=25, seq=0))
    names = {frame.name for frame in FrameParser(DIALECT).feed(bench.read(5.0)) if frame.sysid == 2}
    assert "PARAM_VALUE" in names


def test_on_its_command_line_it_tells_the_network_it_is_in_and_passes_nothing_on() -> None:
    bench = Bench()
    bench.read(3.0)
    assert bench.command_line().endswith(b"[1] OK\r\n")
    reported = bench.ask("ATI5")
    assert all(
        f"{name}={value}" in reported for name, value in (("AIR_SPEED", 64), ("NODEID", 1), ("SERIAL_SPEED", 57))
    )
    assert bench.read(3.0) == b""
    assert "NODEID=3" in bench.ask("RTI5,3", 1.0)
    assert bench.ask("RTI5,4", 1.0) == "RTI5,4\r\n", "nobody is there"
    bench.write(b"ATO\r")
    assert bench.heard(5.0) == {1, 2}


def test_on_another_network_it_hears_nobody_until_it_is_back() -> None:
    bench = Bench()
    for net_id, heard in ((7, set()), (0, {1, 2})):
        bench.command_line()
        bench.ask(f"ATS3={net_id}")
        bench.ask("AT&W")
        bench.ask("ATZ", 2.0)
        bench.read(1.0)  # what was under way
        assert bench.heard(4.0) == heard


def test_a_vehicles_radio_that_was_changed_over_the_air_is_lost_and_the_others_stay() -> None:
    bench = Bench()
    bench.command_line()
    for command in ("RTS3=7,3", "RT&W,3", "RTZ,3"):
        bench.ask(command, 1.0)
    bench.write(b"ATO\r")
    bench.read(2.0)
    assert bench.heard(4.0) == {1}


def test_at_another_rate_nothing_is_understood() -> None:
    bench = Bench()
    bench.baud = 115200
    assert bench.heard(4.0) == set()


def test_a_rate_that_no_radio_has_is_refused() -> None:
    with pytest.raises(ValueError, match="no rate of 60000 baud"):
        Bench(baud=60000)
