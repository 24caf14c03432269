"""Whole visits to emulated radios: found, read, changed; and what is said when something goes wrong on the way."""

from __future__ import annotations

import pytest

from skygcs.errors import LinkError, RefusedError
from skygcs.ext.radio_tools.change import Fact, Ledger, Visit, change, look
from skygcs.ext.radio_tools.dialogue import Dialogue
from skygcs.ext.radio_tools.reading import LIKELY_BAUD
from skygcs.ext.radio_tools.settings import Firmware
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
    assert ledger.sentences() == [
        "the radio refused AIR_SPEED=125 (S2)",
        "nothing was saved; the radio was restarted and is as it was",
    ]
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
