"""Whole visits to emulated radios: found, read, changed; and what is said when something goes wrong on the way."""

from __future__ import annotations

import re
from collections.abc import Generator

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.errors import ConfigError, LinkError, RefusedError
from skygcs.ext.radio_tools.change import Fact, Ledger, Visit, change, look
from skygcs.ext.radio_tools.dialogue import MAX_HEARD_BYTES, Dialogue, Quiet, Reply, Say, Speak, Status, Step, Until
from skygcs.ext.radio_tools.network import NetworkSettings, check_network, plan_network
from skygcs.ext.radio_tools.reading import LIKELY_BAUD
from skygcs.ext.radio_tools.settings import (
    ANTENNA_MEANINGS,
    ANTENNA_MODES,
    SERIAL_BAUD,
    Difference,
    Firmware,
    RadioState,
    Register,
    differences,
    firmware_of,
    from_toml,
    inconsistencies,
    missing_registers,
    parse_registers,
    resolve_name,
    restorable,
    to_toml,
    why_not,
)
from skygcs.sim.at_modem import AtRadio, Faults, Kind
from support.at_bench import Cable
from support.table import each

USUAL = (57600,)
TELEMETRY = b"\xfe\x09\x00\x01\x01\x00telemetry+A"


def changed(radio: AtRadio, remote: int | None = None, bauds: tuple[int, ...] = USUAL, **values: int) -> Ledger:
    return Cable(radio, TELEMETRY).run(change(Visit(), bauds, remote, lambda _: values))


def network(*nodes: int) -> AtRadio:
    """The first at the port, the others in its range."""
    radios = [AtRadio() for _ in nodes]
    for radio, node in zip(radios, nodes, strict=True):
        radio.renumber(node)
    radios[0].remotes = radios[1:]
    return radios[0]


def value(radio: AtRadio, name: str) -> int:
    found = radio._value(name, radio.saved)
    assert found is not None
    return found


# -- found and read


@each(
    ("kind", "firmware"),
    [
        (Kind.SIK, Firmware.SIK),
        (Kind.RFD_SIK, Firmware.SIK),
        (Kind.RFD_MULTIPOINT, Firmware.RFD_MULTIPOINT),
        (Kind.SIK_MULTIPOINT, Firmware.SIK_MULTIPOINT),
    ],
)
@each("chunk", [1, 4096])
def test_every_kind_is_read_amid_telemetry_and_passes_data_on_again(kind: Kind, firmware: Firmware, chunk: int) -> None:
    radio = AtRadio(kind)
    state = Cable(radio, TELEMETRY).run(look(Visit(), USUAL, None), chunk)
    assert (state.firmware, len(state.registers)) == (firmware, len(radio.live))
    assert state.values["SERIAL_SPEED"] == 57
    assert not radio.command_mode
    assert radio.restarts == 0


def test_the_rate_is_found() -> None:
    radio = AtRadio(saved={1: 115})
    visit = Visit()
    Cable(radio, TELEMETRY).run(look(visit, (57600, 38400, 115200), None))
    assert visit.baud == 115200


def test_a_wrong_rate_is_told_from_silence() -> None:
    with pytest.raises(LinkError, match=r"57600 baud: \d+ bytes that are not an answer.*another rate"):
        Cable(AtRadio(saved={1: 115}), TELEMETRY).run(look(Visit(), USUAL, None))
    with pytest.raises(LinkError, match=r"57600 baud: silence.*is it powered"):
        Cable(AtRadio(faults=Faults(silent=True))).run(look(Visit(), USUAL, None))


def test_only_rates_that_were_not_tried_are_proposed() -> None:
    with pytest.raises(LinkError, match=r"another rate\? Not tried: 115200, 38400, 230400, 9600 \(--baud\)"):
        Cable(AtRadio(saved={1: 115})).run(look(Visit(), (57600, 19200), None))
    with pytest.raises(LinkError, match=r"swapped\?$"):
        Cable(AtRadio(faults=Faults(silent=True))).run(look(Visit(), LIKELY_BAUD, None))


def test_a_radio_that_somebody_left_at_its_command_line_is_taken_up_there() -> None:
    radio = AtRadio(command_mode=True)
    assert Cable(radio).run(look(Visit(), USUAL, None)).node == 2
    assert not radio.command_mode


def test_lines_lost_from_the_list_are_asked_for_again() -> None:
    radio = AtRadio(faults=Faults(loses_lines=9))
    assert len(Cable(radio).run(look(Visit(), USUAL, None)).registers) == 27
    assert radio.commands.count("ATI5") == 2


def test_a_remote_node_is_read_through_the_one_at_the_port_although_the_air_loses_a_question() -> None:
    radio = network(1, 2, 3)
    radio.faults.loses_remote = 2
    cable = Cable(radio)
    assert cable.run(look(Visit(), USUAL, 3)).node == 3
    with pytest.raises(LinkError, match="remote node 9 does not answer over the air"):
        cable.run(look(Visit(), USUAL, 9))
    with pytest.raises(LinkError, match="node 1 is the radio at this port"):
        cable.run(look(Visit(), USUAL, 1))
    assert not radio.command_mode


# -- changed


@each("kind", list(Kind))
def test_a_change_is_written_saved_and_verified_at_the_new_rate(kind: Kind) -> None:
    radio = AtRadio(kind)
    cable = Cable(radio, TELEMETRY)
    ledger = cable.run(change(Visit(), USUAL, None, lambda _: {"netid": 7, "AIR_SPEED": 125, "SERIAL_SPEED": 115}))
    assert ledger.ok, ledger.sentences()
    assert ledger.sentences() == ["written, saved, restarted and read back: all as wanted"]
    assert (value(radio, "NETID"), value(radio, "AIR_SPEED"), radio.baud, cable.baud) == (7, 125, 115200, 115200)
    assert not radio.command_mode


def test_what_is_so_already_is_not_written() -> None:
    radio = AtRadio()
    ledger = changed(radio, AIR_SPEED=64)
    assert (ledger.ok, ledger.sentences(), radio.restarts) == (True, ["nothing was to be changed"], 0)
    assert not any("=" in command for command in radio.commands)


def test_node_count_is_the_masters_table_on_an_rfd900x_and_a_register_on_open_sik() -> None:
    radio = AtRadio()
    assert changed(radio, NETID=4, NODECOUNT=9).ok
    assert radio.node_table == {0: (4, 9)}
    radio = AtRadio(Kind.SIK_MULTIPOINT)
    assert changed(radio, NODEDESTINATION=1, NODEID=8, NODECOUNT=9).ok
    assert (value(radio, "NODECOUNT"), value(radio, "NODEID"), value(radio, "NODEDESTINATION")) == (9, 8, 1)


def test_changes_that_cannot_be_right_are_all_told_and_nothing_is_written() -> None:
    radio = AtRadio()
    with pytest.raises(RefusedError) as refused:
        changed(radio, NODEID=17, TXPOWER=31, NODECOUNT=1, NETTID=3)
    for said in ("NODEID takes 1", "TXPOWER takes 0 to 30", "NODECOUNT takes 2 to 16", "did you mean NETID"):
        assert said in str(refused.value)
    assert not radio.command_mode
    assert not any("=" in command for command in radio.commands)


# -- and what goes wrong


def test_a_refused_value_undoes_what_was_written_before_it() -> None:
    radio = AtRadio(faults=Faults(refuses=frozenset({"AIR_SPEED"})))
    ledger = changed(radio, NETID=7, AIR_SPEED=125)
    assert not ledger.ok
    wanted = ["the radio refused AIR_SPEED=125 (S2)", "nothing was saved; the radio was restarted and is as it was"]
    assert ledger.sentences() == wanted
    assert value(radio, "NETID") == radio._value("NETID") == 0


def test_a_value_that_the_radio_makes_another_of_is_no_success() -> None:
    radio = AtRadio(Kind.SIK)
    ledger = changed(radio, TXPOWER=15)
    assert ledger.problem == "the radio made 17 of TXPOWER=15; set a value that it has"
    assert (ledger.undone, value(radio, "TXPOWER")) == (Fact.YES, 20)


def test_a_radio_that_restarts_in_the_middle_is_found_as_it_was_and_that_is_said() -> None:
    radio = AtRadio(faults=Faults(restarts_at="ATS2="))
    ledger = changed(radio, NETID=7, AIR_SPEED=125)
    assert ledger.sentences() == [
        "the radio stopped answering at AIR_SPEED=125: did it restart, or lose its power or cable?",
        "nothing was saved; the radio was restarted and is as it was",
    ]
    assert value(radio, "NETID") == 0


def test_a_radio_that_dies_in_the_middle_leaves_no_doubt_about_what_is_not_known() -> None:
    ledger = changed(AtRadio(faults=Faults(dies_at="ATS2=")), NETID=7, AIR_SPEED=125, DUTY_CYCLE=50)
    assert ledger.sentences()[1:] == [
        "written: NETID; perhaps written: AIR_SPEED; not written: DUTY_CYCLE",
        "saved: no; restarted: unknown; verified: no",
        "what is not saved is gone once the radio is powered off and on",
    ]


def test_a_save_without_an_answer_is_looked_into() -> None:
    ledger = changed(AtRadio(faults=Faults(dies_at="AT&W")), NETID=7)
    assert (ledger.saved, ledger.ok) == (Fact.UNKNOWN, False)
    assert "saved: unknown; restarted: unknown; verified: no" in ledger.sentences()
    radio = AtRadio(faults=Faults(restarts_at="AT&W"))
    ledger = changed(radio, NETID=7)
    assert (ledger.saved, ledger.undone, value(radio, "NETID")) == (Fact.NO, Fact.YES, 0)


def test_a_radio_that_forgets_what_it_saved_is_caught_after_the_restart() -> None:
    ledger = changed(AtRadio(faults=Faults(forgets=frozenset({"NETID"}))), NETID=7, AIR_SPEED=125)
    assert ledger.sentences() == [
        "the radio does not hold what it was to save",
        "written: NETID, AIR_SPEED",
        "saved: yes; restarted: yes; verified: no",
        "it now holds NETID=0 (wanted 7)",
        "power it off and on, then look with: skygcs-cli radio show",
    ]


def test_a_remote_node_is_changed_and_verified_over_the_air() -> None:
    radio = network(1, 2, 3)
    radio.faults.loses_remote = 1
    assert changed(radio, remote=3, DUTY_CYCLE=50).ok
    assert [value(r, "DUTY_CYCLE") for r in (radio, *radio.remotes)] == [100, 100, 50]
    assert not radio.command_mode


def test_a_remote_node_set_to_another_network_is_out_of_reach_and_that_is_said() -> None:
    radio = network(1, 2)
    ledger = changed(radio, remote=2, NETID=7)
    assert ledger.problem is not None
    assert "not reachable any more, as it must be" in ledger.problem
    assert "saved: yes; restarted: unknown; verified: unknown" in ledger.sentences()
    assert value(radio.remotes[0], "NETID") == 7


def test_a_remote_nodes_id_is_not_changed_over_the_air() -> None:
    radio = network(1, 2)
    with pytest.raises(RefusedError, match="use its own port"):
        changed(radio, remote=2, NODEID=5)
    assert not radio.command_mode


def test_a_visit_broken_off_undoes_what_is_not_saved() -> None:
    radio = AtRadio()
    visit = Visit()
    dialogue = Dialogue(change(visit, USUAL, None, lambda _: {"NETID": 7, "AIR_SPEED": 125}), 0.0)
    now = 0.0
    while "ATS3?" not in radio.commands:
        now += 0.01
        radio.hear(dialogue.take_output(), now, 57600)
        radio.advance(now)
        dialogue.feed(radio.take_output(57600), now)
        dialogue.advance(now)
    radio.hear(visit.farewell(), now, 57600)
    assert (radio.restarts, radio._value("NETID"), radio.command_mode) == (1, 0, False)
    assert Visit().farewell() == b""


# -- The dialogue: what counts as an answer, when one is whole, and that noise neither hangs nor fills it.


def once(step: Step) -> Generator[Step, Reply, Reply]:
    return (yield step)


def asked(step: Say, *heard: bytes) -> Dialogue[Reply]:
    dialogue = Dialogue(once(step), 0.0)
    for i, data in enumerate(heard):
        dialogue.feed(data, 0.1 * i)
    return dialogue


def test_echo_status_and_node_are_no_part_of_the_lines() -> None:
    dialogue = asked(Say(b"ATS3?\r"), b"ATS3?\r\n[12] 25\r\n\r\n[12] O", b"K\r\n")
    assert dialogue.result == Reply(Status.OK, ("25",), 12, 27)


def test_only_the_first_line_like_the_command_is_its_echo() -> None:
    assert asked(Say(b"AT\r"), b"AT\r\nAT\r\nOK\r\n").result.lines == ("AT",)


def test_a_single_line_ends_an_answer_of_one_line_and_an_error_every_answer() -> None:
    assert asked(Say(b"ATI\r", Until.LINE), b"SiK 2.2\r\n").result.status is Status.LINES
    for until in (Until.STATUS, Until.LINE, Until.IDLE):
        assert asked(Say(b"ATX\r", until), b"ATX\r\nERROR\r\n").result.status is Status.ERROR


def test_a_list_is_over_when_nothing_more_comes() -> None:
    dialogue = asked(Say(b"ATI5\r", Until.IDLE, timeout_s=1.0, idle_s=0.3), b"S0:A=1\r\n", b"S1:B=2\r\nS2:C=")
    assert dialogue.next_deadline() == 0.1 + 0.3
    dialogue.advance(0.39)
    assert not dialogue.done
    dialogue.feed(b"3\r\n", 0.39)
    dialogue.advance(0.7)
    assert dialogue.result.lines == ("S0:A=1", "S1:B=2", "S2:C=3")


def test_no_answer_is_silence_at_the_deadline_and_says_how_much_noise_there_was() -> None:
    dialogue = asked(Say(b"AT\r", timeout_s=1.0), b"\xfe\x09\x00noise")
    assert dialogue.next_deadline() == 1.0
    dialogue.advance(1.0)
    assert (dialogue.result.status, dialogue.result.heard_bytes) == (Status.SILENCE, 8)


def test_ok_behind_data_without_a_line_end_counts_only_where_data_is_expected() -> None:
    heard = b"\xfd\x1c\x00\x00telemetryOK\r\n"
    assert asked(Say(b"+++", amid_noise=True), heard).result.status is Status.OK
    assert not asked(Say(b"AT\r"), heard).done


def test_steps_that_take_no_time_are_done_at_once_and_in_order() -> None:
    def procedure() -> Generator[Step, Reply, str]:
        yield Speak(9600)
        yield Say(b"ATO\r", Until.SENT)
        yield Quiet(0.5)
        return "left"

    dialogue = Dialogue(procedure(), 10.0)
    assert (dialogue.baud, dialogue.take_output(), dialogue.take_output()) == (9600, b"ATO\r", b"")
    dialogue.feed(b"late", 10.2)
    assert dialogue.next_deadline() == 10.5
    dialogue.advance(10.5)
    assert (dialogue.done, dialogue.result, dialogue.next_deadline()) == (True, "left", None)


@given(st.lists(st.binary(max_size=300), max_size=20))
def test_any_bytes_whatever_leave_it_at_its_deadline_or_done(chunks: list[bytes]) -> None:
    dialogue = asked(Say(b"AT\r", timeout_s=5.0), *chunks)
    if not dialogue.done:
        assert dialogue.next_deadline() == 5.0
        dialogue.advance(5.0)
    assert dialogue.done


def test_endless_noise_is_not_kept() -> None:
    dialogue = asked(Say(b"AT\r"), *[b"\xff" * 4096] * 100)
    assert len(dialogue._text) < MAX_HEARD_BYTES
    dialogue.feed(b"\r\nOK\r\n", 0.9)
    assert dialogue.result.status is Status.OK


# -- Settings by name, as different firmwares list them; values that cannot be right; what one radio's do together.


def test_every_way_in_which_firmwares_list_a_setting_is_read() -> None:
    lines = ["S3:NETID=25", "S0: FORMAT=26", "S20:ANT_MODE(N)[0..3]=0{Ant1&2,Ant1,}", "R0:TARGET_RSSI_dBm=0",
             "S23:RATE/FREQBAND=2", "", "OK", "S4:TXPOWER=", "S5=1", "noise S6:MAVLINK=1"]  # fmt: skip
    assert parse_registers(lines) == {
        "NETID": Register("S3", "NETID", 25),
        "FORMAT": Register("S0", "FORMAT", 26),
        "ANT_MODE": Register("S20", "ANT_MODE", 0),
        "TARGET_RSSI_DBM": Register("R0", "TARGET_RSSI_DBM", 0),
        "RATE/FREQBAND": Register("S23", "RATE/FREQBAND", 2),
    }


def test_lost_lines_show_as_gaps() -> None:
    assert missing_registers(parse_registers(["S0:A=1", "S3:B=2", "R7:C=1"])) == ["S1", "S2"]
    assert missing_registers({}) == []


@each(
    ("banner", "names", "firmware"),
    [
        ("SiK 2.2 on HM-TRP", ["NETID"], Firmware.SIK),
        ("RFD SiK 3.57 on RFD900x2", ["NETID"], Firmware.SIK),
        ("RFD SiK 3.00MP on RFD900x2", [], Firmware.RFD_MULTIPOINT),
        ("RFD SiK 2.75MP on RFD900xR1.1", ["NODEID"], Firmware.RFD_MULTIPOINT),
        ("MP SiK 2.6 on RFD900P", ["NODEID", "NODECOUNT"], Firmware.SIK_MULTIPOINT),
        ("RFD ASYNC 2.47 on RFD900xR1.1", ["NODEID"], Firmware.ASYNC),
    ],
)
def test_the_firmware_shows_in_banner_and_settings(banner: str, names: list[str], firmware: Firmware) -> None:
    assert firmware_of(banner, names) is firmware


def test_a_setting_is_found_under_either_of_its_names() -> None:
    radio = {"RXFRAME": Register("S6", "RXFRAME", 1), "DUTY_CYCLE": Register("S11", "DUTY_CYCLE", 100)}
    assert resolve_name("mavlink", radio) == "RXFRAME"
    assert resolve_name("duty-cycle", radio) == "DUTY_CYCLE"
    with pytest.raises(KeyError, match="no setting DUTY_CICLE; did you mean DUTY_CYCLE"):
        resolve_name("DUTY_CICLE", radio)


@each(
    ("name", "good", "bad"),
    [
        ("NETID", (0, 25, 65535), (65536,)),
        ("TXPOWER", (0, 30), (31,)),
        ("MAVLINK", (0, 1, 2), (3,)),
        ("DUTY_CYCLE", (1, 100), (0, 101)),
        ("LBT_RSSI", (0, 25, 220), (24, 221)),
        ("MIN_FREQ", (0, 902_000), (902,)),
        ("NODEID", (1, 16), (0, 17, 255)),
        ("NODEDESTINATION", (1, 16, 255, 65535), (0, 17, 300)),
        ("FORMAT", (), (26,)),
        ("SERIAL_SPEED", tuple(SERIAL_BAUD), (57600, 58)),
        ("ANT_MODE", (0, 1, 2, 3), (4, 99)),
        ("GPO1_3STATLED", (0, 99), ()),
    ],
)
def test_values_that_cannot_be_right_are_known(name: str, good: tuple[int, ...], bad: tuple[int, ...]) -> None:
    assert [v for v in good if why_not(name, v, Firmware.RFD_MULTIPOINT)] == []
    for value in bad:
        assert name in (why_not(name, value, Firmware.RFD_MULTIPOINT) or "")


OWN_WORDS = "S20:ANT_MODE(N)[0..3]=0{Ant1&2,Ant1,Ant2,Ant1=TX;2=RX,}"
"""The oracle: the answer to ATI5? of an RFD900x's firmware, as published."""


def test_antenna_modes_mean_what_the_radio_itself_says_of_them() -> None:
    own = OWN_WORDS[OWN_WORDS.index("{") + 1 : -1].rstrip(",").split(",")
    assert len(own) == len(ANTENNA_MEANINGS) == len(ANTENNA_MODES) == 4
    for word, mode in ANTENNA_MODES.items():
        radio, ours = own[mode], ANTENNA_MEANINGS[mode]
        assert re.findall(r"[12]", radio) == (["1", "2"] if word == "both" else re.findall(r"[12]", word))
        assert ("TX" in radio) == ("sends" in ours) and ("&" in radio) == ("both" in ours)


def test_open_sik_counts_nodes_from_zero() -> None:
    assert why_not("NODEID", 0, Firmware.SIK_MULTIPOINT) is None
    assert why_not("NODEDESTINATION", 255, Firmware.SIK_MULTIPOINT) is None
    assert why_not("NODEID", 32768, Firmware.SIK_MULTIPOINT) is not None


@each(
    ("values", "said"),
    [
        ({"AIR_SPEED": 80}, "AIR_SPEED 80 is not one"),
        ({"MIN_FREQ": 928_000, "MAX_FREQ": 915_000}, "not below MAX_FREQ"),
        ({"NODEID": 3, "NODEDESTINATION": 3}, "the node itself"),
        ({"NODEID": 3, "NODECOUNT": 3}, "must be the highest node id and one"),
        ({"RXFRAME": 0}, "no RADIO_STATUS"),
        ({"NODEID": 3, "RTSCTS": 0}, "RTSCTS is off"),
        ({"DUTY_CYCLE": 40}, "silent for the rest"),
    ],
)
def test_settings_that_nobody_wants_together_are_told(values: dict[str, int], said: str) -> None:
    (text,) = inconsistencies(values, Firmware.RFD_MULTIPOINT)
    assert said in text


def test_a_sound_radio_has_nothing_to_tell() -> None:
    values = {"AIR_SPEED": 64, "MAVLINK": 1, "DUTY_CYCLE": 100, "RTSCTS": 0}
    assert inconsistencies(values, Firmware.SIK) == []


# -- A multipoint network planned, and radios checked as one.


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


# -- A radio's settings as a file, and back.


@each("kind", list(Kind))
def test_a_backup_holds_the_radio(kind: Kind) -> None:
    state = Cable(AtRadio(kind)).run(look(Visit(), (57600,), None))
    again = from_toml(to_toml(state, "Read from /dev/ttyUSB0.\nin the field"), "backup.toml")
    assert again.values == state.values
    wanted = (state.banner, state.firmware, state.board, state.unique_id)
    assert (again.banner, again.firmware, again.board, again.unique_id) == wanted
    assert "FORMAT" not in restorable(again)


@given(st.text(max_size=60), st.text(max_size=20))
def test_whatever_a_radio_tells_the_file_can_be_read(banner: str, board: str) -> None:
    state = RadioState(banner, Firmware.SIK, {"NETID": Register("S3", "NETID", 25)}, board)
    assert from_toml(to_toml(state), "x").values == {"NETID": 25}


@each(
    ("text", "said"),
    [
        ("a = ", "Invalid value"),
        ("version = 2\n[radio]\nbanner = 'x'\nfirmware = 'SiK'\n[registers]\nNETID = 1", "version: must be 1"),
        ("version = 1\n[registers]\nNETID = 1", "radio: must be a table"),
        ("version = 1\n[radio]\nbanner = 'x'\nfirmware = 'TCP'\n[registers]\nNETID = 1", "radio.firmware: must be"),
        ("version = 1\n[radio]\nbanner = 'x'\nfirmware = 'SiK'", "registers: must be a table"),
        ("version = 1\n[radio]\nbanner = 'x'\nfirmware = 'SiK'\n[registers]\nNETID = true", "registers.NETID"),
        ("#" * 70000, "this is no backup"),
    ],
)
def test_a_file_that_is_no_backup_says_what_is_wrong(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        from_toml(text, "backup.toml")


def test_differences_name_both_values_and_what_only_one_has() -> None:
    wanted = [Difference("A", 1, None), Difference("C", 3, 4), Difference("D", None, 5)]
    assert differences({"A": 1, "B": 2, "C": 3}, {"B": 2, "C": 4, "D": 5}) == wanted
