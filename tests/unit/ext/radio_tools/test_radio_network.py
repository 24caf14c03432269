"""A multipoint network planned, and radios checked as one."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import RefusedError
from skygcs.ext.radio_tools.change import Visit, change, look
from skygcs.ext.radio_tools.network import NetworkSettings, check_network, plan_network
from skygcs.ext.radio_tools.settings import Firmware, RadioState, Register
from skygcs.sim.at_modem import AtRadio, Kind
from support.at_bench import Cable
from support.table import each


def radio(firmware: Firmware = Firmware.RFD_MULTIPOINT, **values: int) -> RadioState:
    held = {"NETID": 0, "AIR_SPEED": 64, "MAVLINK": 1, "RTSCTS": 1, **values}
    return RadioState("RFD SiK 3.00MP", firmware, {n: Register("S1", n, v) for n, v in held.items()})


def test_the_ground_is_master_and_alone_holds_the_node_count() -> None:
    plan = plan_network(["alpha", "bravo"], 4, NetworkSettings(net_id=3, air_speed_kbps=125, serial_baud=115200))
    settings = [plan.settings(i, Firmware.RFD_MULTIPOINT) for i in range(4)]
    assert [s["NODEID"] for s in settings] == [1, 2, 3, 4]
    assert [plan.name(i) for i in range(4)] == ["ground", "alpha", "bravo", "spare"]
    assert [s.get("NODECOUNT") for s in settings] == [4, None, None, None]
    assert {(s["NETID"], s["AIR_SPEED"], s["SERIAL_SPEED"], s["NODEDESTINATION"]) for s in settings} == {
        (3, 125, 115, 255)
    }


def test_open_sik_counts_from_zero_and_every_node_holds_the_count() -> None:
    plan = plan_network(["alpha"], None, NetworkSettings(to_ground_only=True))
    settings = [plan.settings(i, Firmware.SIK_MULTIPOINT) for i in range(2)]
    assert [(s["NODEID"], s["NODEDESTINATION"], s["NODECOUNT"]) for s in settings] == [(0, 65535, 2), (1, 0, 2)]


@each(
    ("vehicles", "nodes", "common", "said"),
    [
        (3, 3, NetworkSettings(), "give --nodes 4"),
        (16, None, NetworkSettings(), "16 node ids, 17 are wanted"),
        (0, None, NetworkSettings(), "at least two nodes"),
        (1, None, NetworkSettings(serial_baud=12345), "no rate of 12345"),
        (1, None, NetworkSettings(extra={"NODEID": 4}), "NODEID follows from the plan"),
    ],
)
def test_what_does_not_go_together_is_refused(
    vehicles: int, nodes: int | None, common: NetworkSettings, said: str
) -> None:
    with pytest.raises(RefusedError, match=said):
        plan_network([f"v{i}" for i in range(vehicles)], nodes, common)


def test_open_sik_has_no_antennas_to_choose() -> None:
    plan = plan_network(["alpha"], None, NetworkSettings(antennas=1))
    assert "ANT_MODE" not in plan.settings(0, Firmware.SIK_MULTIPOINT)
    with pytest.raises(RefusedError, match="which has no ANT_MODE"):
        plan.settings(1, Firmware.SIK_MULTIPOINT)


def test_radios_that_make_no_network_are_refused() -> None:
    for firmware in (Firmware.SIK, Firmware.ASYNC):
        with pytest.raises(RefusedError, match="load multipoint firmware first"):
            plan_network(["alpha"], None).settings(0, firmware)


@given(st.integers(2, 16), st.sampled_from([Firmware.RFD_MULTIPOINT, Firmware.SIK_MULTIPOINT]), st.booleans())
def test_every_plan_makes_a_sound_network(nodes: int, firmware: Firmware, to_ground: bool) -> None:
    plan = plan_network(["a"], nodes, NetworkSettings(to_ground_only=to_ground))
    radios = {str(i): radio(firmware, **plan.settings(i, firmware)) for i in range(nodes)}
    if firmware is Firmware.RFD_MULTIPOINT:  # the node count is the master's table there, and no register
        del radios["0"].registers["NODECOUNT"]  # type: ignore[attr-defined]
    assert check_network(radios) == []


@each("kind", [Kind.RFD_MULTIPOINT, Kind.SIK_MULTIPOINT])
def test_emulated_radios_take_the_plan_and_are_a_sound_network_then(kind: Kind) -> None:
    plan = plan_network(["alpha", "bravo"], None)
    states = {}
    for i in range(plan.nodes):
        cable = Cable(AtRadio(kind))
        settings = lambda state, i=i: plan.settings(i, state.firmware)  # noqa: E731
        ledger = cable.run(change(Visit(), (57600,), None, settings))
        assert ledger.ok, ledger.sentences()
        states[plan.name(i)] = cable.run(look(Visit(), (57600,), None))
    assert check_network(states) == []


@each(
    ("second", "said"),
    [
        ({"NODEID": 1}, "node id 1 is in 2 radios (a, b)"),
        ({"NODEID": 2, "NETID": 7}, "NETID differs: a 0, b 7"),
        ({"NODEID": 2, "AIR_SPEED": 125}, "AIR_SPEED differs: a 64, b 125"),
        ({"NODEID": 2, "MAVLINK": 0}, "b: MAVLink framing is off"),
    ],
)
def test_radios_that_disturb_or_miss_each_other_are_told(second: dict[str, int], said: str) -> None:
    (text,) = check_network({"a": radio(NODEID=1), "b": radio(**second)})
    assert said in text


def test_a_network_without_its_master_and_mixed_firmware_are_told() -> None:
    assert "none of them is the master (node 1)" in check_network({"a": radio(NODEID=2), "b": radio(NODEID=3)})[0]
    mixed = {"a": radio(NODEID=1), "b": radio(Firmware.SIK_MULTIPOINT, NODEID=2, NODECOUNT=3)}
    assert any("different firmware" in text for text in check_network(mixed))
