"""The fleet file: every problem at once, each with its key, its line and what to do."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skygcs.config.loader import MAX_LINK_CHARS, MAX_LINK_PROBLEMS, MAX_PROBLEMS, load_fleet, parse_link
from skygcs.config.models import FleetConfig, ReplayLinkConfig, SerialLinkConfig
from skygcs.errors import ConfigError
from support.examples import examples
from support.frames import dialect
from support.table import each

SERIAL = '[links.radio]\ntype = "serial"\ndevice = "/dev/ttyUSB0"\n'
UDP = '[links.net]\ntype = "udp_server"\nport = 5000\n'


def load(tmp_path: Path, text: str) -> FleetConfig:
    path = tmp_path / "fleet.toml"
    path.write_text(text)
    return load_fleet(path)


def problems(tmp_path: Path, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, text)
    return caught.value.problems


def test_an_empty_file_is_a_fleet_with_defaults(tmp_path: Path) -> None:
    config = load(tmp_path, "")
    assert (config.daemon.sysid, config.daemon.compid) == (255, 25)
    assert config.daemon.log_dir == tmp_path / "logs"
    assert config.vehicle_configs() == ()


def test_ten_mistakes_are_ten_problems_in_the_order_of_the_file(tmp_path: Path) -> None:
    text = """
dialect = "ardupilotmegaa"
[daemon]
sysid = 300
sokcet = "x"
record = "yes"
tcp_port = 5790
[links.radio]
type = "serial"
device = "/dev/ttyUSB0"
baud = "57600"
[links.gcs]
type = "udp-server"
port = 14550
[links.companions]
type = "udp_server"
[vehicles.alpha]
sysid = 1
type = "quad"
[vehicles.7]
sysid = 1
"""
    found = problems(tmp_path, text)
    expected = [
        r"dialect \(line 2\): ardupilotmegaa: no dialect of this name; did you mean ardupilotmega\?",
        r"daemon.sysid \(line 4\): must be at most 255, not 300",
        r"daemon.sokcet \(line 5\): unknown key; did you mean socket\?",
        r'daemon.record \(line 6\): must be true or false, not "yes"',
        r"daemon.tcp_port \(line 7\): needs daemon.token_file: .*",
        r'links.radio.baud \(line 11\): must be a whole number or a list, not "57600"',
        r"links.gcs \(line 12\): type must be one of serial, .*; did you mean udp_server\?",
        r"links.companions.port \(line 15\): is missing",
        r"vehicles.alpha.type \(line 19\): there is no \[types.quad\]",
        r"vehicles.7 \(line 20\): the name '7' looks like a system id",
        r"vehicles.7.sysid \(line 21\): 1 is already the system id of alpha.*",
    ]
    assert len(found) == len(expected), found
    for text, pattern in zip(found, expected, strict=True):
        assert re.fullmatch(pattern, text), text


@each(
    ("text", "complaint"),
    [
        # values
        ("[daemon]\nsysid = 0", "daemon.sysid (line 2): must be at least 1, not 0"),
        ("[daemon]\nsysid = true", "daemon.sysid (line 2): must be a whole number, not true"),
        ("[daemon]\nsysid = 1.5", "daemon.sysid (line 2): must be a whole number, not 1.5"),
        ("[daemon]\nvehicle_timeout_s = 0", "daemon.vehicle_timeout_s (line 2): must be at least 1, not 0"),
        ("[daemon]\nbad_crc = 'keep'", 'daemon.bad_crc (line 2): must be one of drop, pass, not "keep"'),
        ("[daemon]\nlog_dir = 5", "daemon.log_dir (line 2): must be text in quotes, not 5"),
        ("[origin]\nlat_deg = 1\nlon_deg = 2\nalt_amsl_m = inf", "origin.alt_amsl_m (line 4): must be a finite number"),
        ("[origin]\nlat_deg = 0.0\nlon_deg = 0.0\nalt_amsl_m = 0", "never filled in"),
        ("[origin]\nlat_deg = 1\nlon_deg = 2\nalt_amsl_m = 0\nx_heading_deg = 361", "at most 360, not 361"),
        ("[origin]\nlat_deg = 91\nlon_deg = 2\nalt_amsl_m = 0", "origin.lat_deg (line 2): must be at most 90, not 91"),
        ("links = 5", "links (line 1): must be a table, not 5"),
        ("[[links]]\ntype = 'serial'", "links (line 1): must be a table"),
        ("[links]\nradio = 'serial'", 'links.radio (line 2): must be a table, not "serial"'),
        (
            "[links.radio]\ndevice = 'x'",
            "links.radio (line 1): has no type; it must be one of serial, xbee, udp_server",
        ),
        (SERIAL + "baud = []", "links.radio.baud (line 4): must be a whole number or a list of at least one, not []"),
        (SERIAL + "baud = [9600, 'x']", 'links.radio.baud[1] (line 4): must be a whole number, not "x"'),
        (SERIAL + "baud = 9", "links.radio.baud (line 4): must be at least 50 or a list, not 9"),
        (SERIAL + "role = 'gsc'", 'must be one of peer, gcs, vehicle, radio, not "gsc"; did you mean gcs?'),
        (SERIAL + "allow_src_sys_in = [256]", "links.radio.allow_src_sys_in[0] (line 4): must be at most 255, not 256"),
        (
            SERIAL + "allow_msg_id_in = [1.5]",
            "links.radio.allow_msg_id_in[0] (line 4): must be text in quotes or a whole",
        ),
        (
            UDP + "allow_from = ['10.0.0.0/24', 'LAN']",
            'links.net.allow_from[1] (line 4): "LAN" is not a network: write',
        ),
        (
            UDP + "allow_from = ['10.0.0.5/24']",
            "(line 4): 10.0.0.5/24 is an address within a network; did you mean 10.0.0.0/24, or 10.0.0.5 alone?",
        ),
        (UDP + "allow_from = ['10.0.0.0/33']", 'links.net.allow_from[0] (line 4): "10.0.0.0/33" is not a network'),
        (UDP + "allow_from = []", "links.net.allow_from (line 4): must be a list of at least one, not []"),
        (UDP + "allow_from = '10.0.0.0/24'", 'links.net.allow_from (line 4): must be a list, not "10.0.0.0/24"'),
        (UDP + "allow_from = [5]", "links.net.allow_from[0] (line 4): must be text in quotes, not 5"),
        ("[daemon]\nlog_dir = '~no-such-user/logs'", 'daemon.log_dir (line 2): "~no-such-user/logs": there is no user'),
        (
            "[links.r]\ntype = 'replay'\nfile = '~no-such-user/a.tlog'",
            'links.r.file (line 3): "~no-such-user/a.tlog": there is no user of this name',
        ),
        ("dialect = '~no-such-user/d.xml'", "~no-such-user/d.xml: no such dialect file"),
        (f"[daemon]\nsysid = 1{'0' * 5000}", "not a fleet file: exceeds the limit"),
        (
            '[links.r]\ntype = "serial"\ndevice = "/dev/tty\\u0000USB0"',
            "links.r.device (line 3): holds a NUL character",
        ),
        ('[daemon]\nlog_dir = "a\\u0000b"', "daemon.log_dir (line 2): holds a NUL character"),
        (SERIAL + "allow_from = ['10.0.0.0/24']", "links.radio.allow_from (line 4): unknown key"),
        (SERIAL + "name = 'x'", "links.radio.name (line 4): a link's name is the name of its table"),
        # keys
        ("[link.radio]\ntype = 'serial'", "link (line 1): unknown key; did you mean links?"),
        (
            SERIAL + "AllowMsgIdIn = [1]",
            "links.radio.AllowMsgIdIn (line 4): unknown key; did you mean allow_msg_id_in?",
        ),
        (
            SERIAL + "rate_out = {messages = {ATTITUDE = 1}, bytes = 5}",
            "links.radio.rate_out.bytes (line 4): unknown key",
        ),
        ("[vehicles.a]\nsysid = 1\ncolour = 'red'", "vehicles.a.colour (line 3): unknown key; known here: autopilot,"),
        # vehicles
        ("[vehicles.a]\n", "vehicles.a.sysid (line 1): is missing"),
        ("[vehicles.all]\nsysid = 1", "vehicles.all (line 1): the name 'all' means every vehicle"),
        ("[vehicles.a-1]\nsysid = 1", "vehicles.a-1 (line 1): the name 'a-1' contains '-': 2-5 is a range"),
        ("[vehicles.'a,b']\nsysid = 1", "vehicles.\"a,b\" (line 1): the name 'a,b' contains ',': a comma separates"),
        ('[vehicles."a\\u001b"]\nsysid = 1', "contains the control character '\\x1b'"),
        ("[vehicles.'a b']\nsysid = 1", "contains ' ': a target has no blanks; use _ instead"),
        ("[vehicles.'']\nsysid = 1", "the name '' is empty"),
        (
            "[vehicles.a_b]\nsysid = 1\n[vehicles.'a.b']\nsysid = 2",
            "vehicles.\"a.b\" (line 3): 'a.b' and 'a_b' would share their files",
        ),
        ("[vehicles.v3]\nsysid = 4", "the name 'v3' is the default name of vehicle 3"),
        (
            "[vehicles.a]\nsysid = 1\ngroup = 'all'",
            "vehicles.a.group (line 3): the group name 'all' means every vehicle",
        ),
        (f"[defaults]\ngroup = '{'g' * 65}'", "has 65 characters; a name has at most 64"),
        ("[defaults]\ngroup = '5'", "defaults.group (line 2): the group name '5' looks like a system id"),
        ("[types.t]\ngroup = ['x', 'y,z']", "types.t.group (line 2): the group name 'y,z' contains ','"),
        (
            "[vehicles.a]\nsysid = 1\ngroup = 'b'\n[vehicles.b]\nsysid = 2",
            "vehicles.b (line 4): 'b' is the name of a vehicle and of a group",
        ),
        (
            "[types.quad]\n[vehicles.a]\nsysid = 1\ntype = 'qaud'",
            "vehicles.a.type (line 4): there is no [types.qaud]; did you mean quad?",
        ),
        ("[daemon]\nsysid = 9\n[vehicles.a]\nsysid = 9", "vehicles.a.sysid (line 4): 9 is skygcs's own system id"),
        # links together
        (
            SERIAL + SERIAL.replace("radio", "b"),
            "links.b (line 4): the device /dev/ttyUSB0 is already used by links.radio",
        ),
        (
            "[links.a]\ntype='udp_server'\nport=5000\n[links.b]\ntype='udp_server'\nhost='127.0.0.1'\nport=5000",
            "links.b (line 4): UDP port 5000 is already used by links.a",
        ),
        (
            "[links.a]\ntype='udp_server'\nport=5000\n[links.b]\ntype='udp_client'\nhost='h'\nport=1\nlocal_port=5000",
            "links.b (line 4): UDP port 5000 is already used by links.a",
        ),
        (
            "[daemon]\ntcp_port=5000\ntoken_file='t'\n[links.b]\ntype='tcp_server'\nport=5000",
            "links.b (line 4): TCP port 5000 is already used by daemon.tcp_port",
        ),
        (
            "[links.a]\ntype='udp_client'\nhost='h'\nport=5000\n[links.b]\ntype='udp_client'\nhost='h'\nport=5000",
            "links.b (line 5): h:5000 is already used by links.a",
        ),
        (
            "[links.a]\ntype='udp_server'\nport=5000\n[links.b]\ntype='udp_client'\nhost='localhost'\nport=5000",
            "links.b.port (line 7): 5000 is our own link a: frames would loop",
        ),
        (
            "[links.a]\ntype='udp_server'\nport=5000\n[links.b]\ntype='udp_broadcast'\nport=5000",
            "links.b.port (line 6): 5000 is our own link a: frames would loop",
        ),
        ("[links.b]\ntype='tcp_client'\nhost='h'\nport=0", "links.b.port (line 4): 0 is not a port to send to"),
        (
            "[links.s]\ntype='simulated'\npx4=3\nfirst_sysid=253",
            "links.s.first_sysid (line 4): 255 is skygcs's own system id and cannot be a simulated vehicle",
        ),
        (
            "[links.s]\ntype='simulated'\npx4=3\nardupilot=3\nfirst_sysid=251",
            "links.s.first_sysid (line 5): 6 vehicles from 251 on need system ids above 255",
        ),
        (
            "[links.s]\ntype='simulated'\npx4=3\n[links.t]\ntype='simulated'\npx4=3\nfirst_sysid=3",
            "links.t.first_sysid (line 7): 3 is also a vehicle of the simulated link s",
        ),
        (
            "[links.s]\ntype='simulated'",
            "links.s (line 1): has no vehicles: give their number with px4, ardupilot, px4_plane, "
            "ardupilot_plane or rover",
        ),
        (
            "[links.s]\ntype='simulated'\npx4=1\nlat_deg=0.005\nlon_deg=-0.005",
            "links.s (line 1): lat_deg and lon_deg: so near to 0, 0 a vehicle's position counts as not known",
        ),
        (
            "[links.s]\ntype='simulated'\nrover=3\nardupilot_plane=3\nfirst_sysid=251",
            "links.s.first_sysid (line 5): 6 vehicles from 251 on need system ids above 255",
        ),
        # messages
        (
            SERIAL + 'allow_msg_id_in = ["HEARTBEAT", "ATITUDE"]',
            "links.radio.allow_msg_id_in[1] (line 4): the dialect has no message ATITUDE; did you mean ATTITUDE?",
        ),
        (SERIAL + "block_msg_id_out = [16777216]", "block_msg_id_out[0] (line 4): 16777216 is not a message id"),
        (
            SERIAL + "[links.radio.rate_out.messages]\nATITUDE = 1",
            "links.radio.rate_out.messages.ATITUDE (line 5): the dialect has no message ATITUDE",
        ),
        (SERIAL + "[links.radio.rate_in.messages]\nATTITUDE = -1", "must be at least 0, not -1"),
        (
            SERIAL + "allow_src_sys_in = [1, 2]\nblock_src_sys_in = [5, 2]",
            "links.radio.block_src_sys_in[1] (line 5): 2 is also in allow_src_sys_in; remove it from one of them",
        ),
        (
            SERIAL + "allow_msg_id_out = ['ATTITUDE']\nblock_msg_id_out = ['attitude']",
            "links.radio.block_msg_id_out[0] (line 5): attitude is also in allow_msg_id_out",
        ),
        # files
        ("dialect = 'no/such.xml'", "no/such.xml: no such dialect file"),
        ("dialect = '.'\n", "dialect (line 1): .: no dialect of this name"),
        ("[daemon]\nsocket = '" + "x" * 120 + "'", "daemon.socket (line 2): is longer than the 107 bytes"),
    ],
)
def test_a_mistake_is_named_with_its_key_and_line(tmp_path: Path, text: str, complaint: str) -> None:
    found = problems(tmp_path, text)
    assert len(found) == 1, found
    assert complaint in found[0]


@each(
    "text",
    [
        SERIAL + 'allow_msg_id_in = ["heartbeat", 0, 54321, "30"]',
        SERIAL + '[links.radio.rate_out.messages]\n"*" = 1\nATTITUDE = 2.5\n"54321" = 0',
        SERIAL + "allow_src_sys_in = [1]\nblock_src_comp_in = [1]\nblock_src_sys_out = [1]\nblock_src_sys_in = [7]",
        SERIAL + SERIAL.replace("radio", "b") + "enabled = false",
        "[links.a]\ntype='udp_server'\nport=0\n[links.b]\ntype='udp_server'\nport=0",
        "[links.a]\ntype='udp_server'\nport=5000\n[links.b]\ntype='tcp_server'\nport=5000",
        "[links.a]\ntype='udp_client'\nhost='10.0.0.1'\nport=5000\n[links.b]\ntype='udp_server'\nport=5000\n",
        "[links.a]\ntype='udp_client'\nhost='h'\nport=5000\nrole='radio'",
        "[links.a]\ntype='udp_server'\nhost='10.0.0.1'\nport=5\n[links.b]\ntype='udp_server'\nhost='10.0.0.2'\nport=5",
        "[links.s]\ntype='simulated'\npx4=250",
        "[vehicles.v3]\nsysid = 3\ngroup = 'x'\n[vehicles.uav_2]\nsysid = 4\ngroup = ['x', 'y']",
    ],
)
def test_what_is_right_is_accepted(tmp_path: Path, text: str) -> None:
    assert isinstance(load(tmp_path, text), FleetConfig)


def test_of_many_mistakes_the_first_are_named(tmp_path: Path) -> None:
    more, first, *others = problems(tmp_path, "\n".join(f"k{n} = 1" for n in range(3 * MAX_PROBLEMS)))
    assert more == "file: has more problems than these: 300 were found"
    assert first.startswith("k0 (line 1): unknown key") and len(others) == MAX_PROBLEMS - 1


def test_a_wrong_value_hides_no_conflict_and_invents_none(tmp_path: Path) -> None:
    text = "[daemon]\nsysid = 'x'\n[vehicles.a]\nsysid = 255\n[vehicles.b]\nsysid = 3\nx = 1\n[vehicles.c]\nsysid = 3\n"
    found = problems(tmp_path, text)
    wanted = ["daemon.sysid (line 2)", "vehicles.b.x (line 7)", "vehicles.c.sysid (line 9)"]
    assert [p.split(":")[0] for p in found] == wanted


@each(
    ("text", "complaint"),
    [
        ("[daemon\nsysid = 1", "line 1, column 8: not TOML"),
        ("[daemon]\nsysid = ", "line 2"),
        ("a = 1\na = 2", "line 2"),
        ("a = [1,\n", "the end of the file: not TOML"),
        ('a = "\x00"', "line 1"),
    ],
)
def test_a_syntax_error_names_its_line(tmp_path: Path, text: str, complaint: str) -> None:
    found = problems(tmp_path, text)
    assert len(found) == 1 and complaint in found[0], found


def test_files_that_can_not_be_read_say_why(tmp_path: Path) -> None:
    (tmp_path / "latin.toml").write_bytes(b"# h\xf6he\n")
    (tmp_path / "deep.toml").write_text("a = " + "[" * 5000 + "]" * 5000)
    for name, complaint in (
        ("absent.toml", "no such file"),
        (".", "is a folder"),
        ("latin.toml", "not UTF-8"),
        ("deep.toml", "nested too deeply"),
    ):
        with pytest.raises(ConfigError, match=complaint) as caught:
            load_fleet(tmp_path / name)
        assert str(tmp_path) in str(caught.value)


def test_a_byte_order_mark_and_windows_lines_are_no_mistake(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    path.write_bytes(b"\xef\xbb\xbf[daemon]\r\nsysid = 250\r\n[vehicles.a]\r\nsysid = 1\r\n")
    assert load_fleet(path).daemon.sysid == 250
    path.write_bytes(b"\xef\xbb\xbf[daemon]\r\nsysid = 0\r\n")
    with pytest.raises(ConfigError, match="line 2"):
        load_fleet(path)


def test_relative_paths_begin_at_the_files_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", "/home/somebody")
    (tmp_path / "lab.xml").write_text(
        '<mavlink><include>common.xml</include><messages><message id="60000" name="LAB"><description>x</description>'
        '<field type="uint8_t" name="a">x</field></message></messages></mavlink>'
    )
    folder = tmp_path / "conf"
    folder.mkdir()
    config = load(
        folder,
        'dialect = ["../lab.xml", "px4-extras"]\n'
        '[daemon]\nlog_dir = "../logs"\nsocket = "s.sock"\ntoken_file = "~/token"\n'
        '[links.r]\ntype = "replay"\nfile = "flight.tlog"\nallow_msg_id_in = ["LAB"]\n',
    )
    assert config.daemon.log_dir == tmp_path / "logs"
    assert config.daemon.socket == folder / "s.sock"
    assert config.daemon.token_file == Path("/home/somebody/token")
    link = config.links["r"]
    assert isinstance(link, ReplayLinkConfig) and link.file == folder / "flight.tlog"
    assert config.dialect == (str(tmp_path / "lab.xml"), "px4-extras")


def test_a_broken_dialect_is_one_problem_with_its_file_and_line(tmp_path: Path) -> None:
    (tmp_path / "lab.xml").write_text("<mavlink>\n<messages>\n<massage/>\n</messages></mavlink>")
    found = problems(tmp_path, 'dialect = "./lab.xml"\n[daemon]\nsysid = 0\n')
    assert len(found) == 2
    assert f"{tmp_path / 'lab.xml'}:3: " in found[0]


def test_settings_of_a_vehicle_are_defaults_under_type_under_its_own(tmp_path: Path) -> None:
    config = load(
        tmp_path,
        "[daemon]\ngoto_limit_m = 70\n[defaults]\ntakeoff_height_m = 3\ngroup = 'd'\n"
        "[types.t]\ntakeoff_height_m = 5\nautopilot = 'px4'\ngroup = ['t', 'u']\n"
        "[vehicles.a]\nsysid = 1\n[vehicles.b]\nsysid = 2\ntype = 't'\n"
        "[vehicles.c]\nsysid = 3\ntype = 't'\ntakeoff_height_m = 9\ngroup = 'z'\n",
    )
    a, b, c = config.vehicle_configs()
    assert (a.takeoff_height_m, a.autopilot, a.groups, a.goto_limit_m) == (3, None, ("d",), 70)
    assert (b.takeoff_height_m, b.autopilot, b.groups) == (5, "px4", ("t", "u"))
    assert (c.takeoff_height_m, c.groups) == (9, ("z",))
    assert config.default_vehicle(77).name == "v77"


def test_a_link_added_at_run_time_is_checked_as_one_in_the_file() -> None:
    link = parse_link("radio", {"type": "serial", "device": "/dev/ttyS0", "baud": [9600, 57600]}, dialect())
    assert isinstance(link, SerialLinkConfig) and (link.name, link.baud) == ("radio", (9600, 57600))
    with pytest.raises(ConfigError) as caught:
        parse_link("radio", {"type": "serial", "divice": "x", "baud": "9600"})
    assert caught.value.problems == [
        "links.radio.device: is missing",
        "links.radio.divice: unknown key; did you mean device?",
        'links.radio.baud: must be a whole number or a list, not "9600"',
    ]
    with pytest.raises(ConfigError, match="has no message HEARTBEET; did you mean HEARTBEAT"):
        parse_link("x", {"type": "udp_server", "port": 1, "block_msg_id_in": ["HEARTBEET"]}, dialect())
    with pytest.raises(ConfigError, match="has no type"):
        parse_link("x", {})


SCRAPS = st.sampled_from(
    [
        *"[]{}=.,#\n\"' ",
        "[links.radio]\n",
        "[[vehicles]]\n",
        'type = "serial"\n',
        '"""',
        "'''",
        "sysid = 1\n",
        "a.b = {c = 1}\n",
        "\\",
        "\u2028",
        "\r",
        "x",
        "1979-05-27",
        "nan",
    ]
)


@settings(max_examples=examples(400), deadline=None)
@given(st.lists(SCRAPS, max_size=25).map("".join))
def test_no_text_makes_it_raise_anything_but_a_config_error(
    tmp_path_factory: pytest.TempPathFactory, text: str
) -> None:
    path = tmp_path_factory.getbasetemp() / "scraps.toml"
    path.write_bytes(text.encode())
    try:
        load_fleet(path)
    except ConfigError as error:
        assert error.problems and all("\n" not in p for p in error.problems)


def test_a_dialect_in_which_no_vehicle_could_be_found_is_a_problem(tmp_path: Path) -> None:
    [problem] = problems(tmp_path, 'dialect = "px4-extras"\n')
    assert problem.startswith("dialect (line 1): px4-extras has no HEARTBEAT and no COMMAND_LONG")
    assert "ardupilotmega" in problem


def test_a_link_added_at_run_time_has_a_bounded_description_and_bounded_problems(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The loop reads it: 60,000 unknown keys took it 15 s, and as many unknown messages longer."""
    looked_for: list[str] = []

    def near(word: str, *_: object, **__: object) -> list[str]:
        looked_for.append(word)
        return []

    monkeypatch.setattr("skygcs.config.loader.near_names", near)
    monkeypatch.setattr("skygcs.config.checks.near_names", near)
    for much in ({f"k{n}": n for n in range(2000)}, {"block_msg_id_in": [f"M{n}" for n in range(2000)]}):
        looked_for.clear()
        with pytest.raises(ConfigError) as caught:
            parse_link("x", {"type": "udp_server", "port": 1, **much}, dialect())
        assert len(caught.value.problems) == len(looked_for) == MAX_LINK_PROBLEMS
    with pytest.raises(ConfigError, match=f"a description of a link has at most {MAX_LINK_CHARS}"):
        parse_link("x", {"type": "udp_server", "port": 1, "allow_from": ["10.0.0.0/24"] * 3000})
