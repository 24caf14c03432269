"""The radio at the ground's port: passes data on, answers on its command line, and reaches whom its settings let it."""

from __future__ import annotations

import pytest

from skygcs.config.dialects import load_dialect
from skygcs.core.mavlink.frame import encode
from skygcs.core.mavlink.parser import FrameParser
from skygcs.sim.at_modem import BOOT_S, AtRadio, Kind
from skygcs.sim.ground_radio import GroundRadio
from skygcs.sim.kinematics import LocalFrame
from skygcs.sim.radio_fleet import RadioFleet
from skygcs.sim.rng import Rng
from skygcs.sim.tdm import TdmConfig, TdmNetwork
from skygcs.sim.vehicle_group import make_vehicles
from support.table import each

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


# -- The emulated radio's command line, where it must be as unforgiving as the firmware.


def at_command_line(kind: Kind = Kind.SIK) -> AtRadio:
    radio = AtRadio(kind, command_mode=True)
    radio.hear(b"", 0.0, 57600)
    return radio


def reported(radio: AtRadio, command: bytes, now: float = 0.0) -> bytes:
    radio.hear(command + b"\r", now, 57600)
    return radio.take_output(57600)


@each(
    ("before_s", "data", "after_s", "entered"),
    [
        (1.0, b"+++", 1.0, True),
        (0.9, b"+++", 1.0, False),
        (1.0, b"+++", 0.9, False),
        (1.0, b"++", 1.0, False),
        (1.0, b"++++", 1.0, False),
        (1.0, b"+++\r", 1.0, False),
        (1.0, b"a+++", 1.0, False),
    ],
)
def test_plus_signs_count_only_between_two_guard_times(
    before_s: float, data: bytes, after_s: float, entered: bool
) -> None:
    radio = AtRadio()
    radio.hear(b"data", 10.0, 57600)
    radio.hear(data, 10.0 + before_s, 57600)
    radio.advance(10.0 + before_s + after_s)
    assert radio.command_mode is entered
    assert radio.take_output(57600) == (b"[2] OK\r\n" if entered else b"")


def test_it_echoes_and_tells_its_node_only_where_it_has_one() -> None:
    assert reported(at_command_line(Kind.SIK), b"ats3?") == b"ATS3?\r\n25\r\n"
    assert reported(at_command_line(Kind.SIK_MULTIPOINT), b"AT") == b"AT\r\n[1] OK\r\n"
    assert reported(at_command_line(), b"ATS99=1").endswith(b"ERROR\r\n")
    assert reported(at_command_line(), b"hello") == b"HELLO\r\n"


def test_a_command_that_is_no_persons_ends_the_command_mode() -> None:
    radio = at_command_line()
    radio.hear(b"A" * 17, 0.0, 57600)
    assert not radio.command_mode


def test_at_a_wrong_rate_neither_understands_the_other() -> None:
    radio = at_command_line()
    radio.hear(b"AT\r", 0.0, 9600)
    assert radio.commands == []
    radio.hear(b"\rAT\r", 0.0, 57600)
    assert b"OK" not in radio.take_output(9600)


def test_what_is_not_saved_is_gone_after_a_restart_and_a_new_rate_is_from_then_on() -> None:
    radio = at_command_line()
    reported(radio, b"ATS3=7")
    reported(radio, b"ATS1=115")
    reported(radio, b"AT&W")
    reported(radio, b"ATS2=125")
    assert radio.baud == 57600
    reported(radio, b"ATZ", 5.0)
    assert (radio.live[3], radio.live[2], radio.baud, radio.command_mode) == (7, 64, 115200, False)
    radio.hear(b"lost", 5.0 + BOOT_S / 2, 115200)
    assert radio.traffic == b""


def test_values_are_corrected_without_a_word_as_the_firmware_does() -> None:
    radio = at_command_line()
    for command, register, held in ((b"ATS11=150", 11, 100), (b"ATS12=5", 12, 25), (b"ATS4=15", 4, 17)):
        assert reported(radio, command).endswith(b"OK\r\n")
        assert radio.live[register] == held
