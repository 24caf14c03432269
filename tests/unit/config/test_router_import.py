from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skygcs.cli.serve import main
from skygcs.config.loader import load_fleet
from skygcs.config.router_import import import_router
from skygcs.errors import ConfigError
from support.public_data import public_file, public_folder
from support.table import each


def links(text: str) -> dict[str, Any]:
    return dict(tomllib.loads(import_router(text, "main.conf").text)["links"])


def notes(text: str) -> str:
    return "\n".join(import_router(text, "main.conf").notes)


def refusal(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        import_router(text, "main.conf")
    return str(caught.value)


def run(*args: str | Path, code: int = 0) -> None:
    with pytest.raises(SystemExit) as caught:
        main([str(arg) for arg in args])
    assert caught.value.code == code


NO_TCP = "[General]\nTcpServerPort=0\n"


def test_every_configuration_becomes_a_fleet_file_that_loads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in public_folder("router"):
        target = tmp_path / f"{path.name}.toml"
        run("import-router", path, "-o", target)
        assert load_fleet(target).links
        assert "Traceback" not in capsys.readouterr().err


@each(
    ("name", "device", "last", "port"),
    [
        ("made-companion.conf", "/dev/serial/by-id/usb-Made_FMU-if00", "local5", 14556),
        ("ark-jetson-main.conf", "/dev/serial/by-id/usb-ARK_ARK_FMU_v6X.x_0-if00", "ark_ui", 14571),
    ],
)
def test_a_companions_configuration_is_brought_over_link_by_link(name: str, device: str, last: str, port: int) -> None:
    found = links(public_file(f"router/{name}").read_text())
    assert len(found) == 8
    assert found["FCUSB"] == {"type": "serial", "device": device, "baud": 2000000}
    assert found["GCS"] == {"type": "udp_server", "host": "0.0.0.0", "port": 14550}
    assert found[last] == {"type": "udp_client", "host": "127.0.0.1", "port": port}


@each(("name", "line"), [("made-eavesdropping.conf", 12), ("apsync-kakute.conf", 112)])
def test_a_key_without_counterpart_is_noted_with_its_line_and_stands_in_the_file(name: str, line: int) -> None:
    text = public_file(f"router/{name}").read_text()
    assert f"line {line}: PortLock = 0: no such key" in notes(text)
    assert f"# not converted (line {line}): PortLock = 0" in import_router(text, "x").text


def test_the_tcp_server_is_there_unless_it_is_turned_off() -> None:
    assert links("[General]") == {"tcp": {"type": "tcp_server", "host": "0.0.0.0", "port": 5760}}
    assert links("[UartEndpoint a]\nDevice=/dev/x").keys() == {"a", "tcp"}
    assert links(NO_TCP + "[UartEndpoint a]\nDevice=/dev/x").keys() == {"a"}


def test_keys_sections_and_words_are_read_in_any_case() -> None:
    text = NO_TCP.upper() + "[UARTENDPOINT a]\nDEVICE=/dev/x\nbaud = 57600, 115200\nFlowControl = TRUE\n"
    assert links(text)["a"] == {"type": "serial", "device": "/dev/x", "baud": [57600, 115200], "rtscts": True}


def test_an_endpoint_without_rate_or_port_has_mavlink_routers_default() -> None:
    text = "[UartEndpoint a]\nDevice=/dev/x\n" + "".join(
        f"[UdpEndpoint {name}]\nMode=Normal\nAddress=10.0.0.{n}\n{port}\n"
        for n, (name, port) in enumerate([("b", ""), ("c", "Port=14550"), ("d", "")], 1)
    )
    found = links(text)
    assert found["a"]["baud"] == 115200
    assert [found[name]["port"] for name in "bcd"] == [14551, 14550, 14552]


def test_filters_and_groups_keep_their_meaning() -> None:
    text = NO_TCP + (
        "[TcpEndpoint a]\nAddress=[::1]\nPort=1\nAllowMsgIdOut=0,33\nBlockSrcSysIn= 7\nFilter=\n"
        "Group=pair\nRetryTimeout=0\n"
    )
    assert links(text)["a"] == {
        "type": "tcp_client",
        "host": "::1",
        "port": 1,
        "allow_msg_id_out": [0, 33],
        "block_src_sys_in": [7],
        "group": "pair",
    }
    assert "RetryTimeout=0: skygcs reconnects by itself" in notes(text)


def test_a_broadcast_address_becomes_a_broadcasting_link() -> None:
    text = "[UdpEndpoint a]\nMode=Normal\nAddress=192.168.1.255\nPort=14550"
    assert links(text)["a"]["type"] == "udp_broadcast"


def test_names_that_toml_must_quote_and_names_used_twice_become_links() -> None:
    text = '[UdpEndpoint a "b"]\nMode=Server\nAddress=0.0.0.0\nPort=1\n[TcpEndpoint a "b"]\nAddress=h\nPort=2\n'
    assert links(NO_TCP + text).keys() == {'a "b"', 'a "b"2'}


def test_recording_is_what_it_was() -> None:
    daemon = tomllib.loads(import_router("[General]\nLog=/var/log/m\nLogTelemetry=true", "x").text)["daemon"]
    assert daemon["log_dir"] == "/var/log/m" and "record" not in daemon
    assert tomllib.loads(import_router("", "x").text)["daemon"]["record"] is False
    assert "Log=/var/log/m: the autopilot's own log" in notes("[General]\nLog=/var/log/m")


@each(
    ("text", "said"),
    [
        ("a = 1", 'line 1: "a" is before the first section'),
        ("[General]\nnonsense", 'line 2: neither a section nor key = value: "nonsense"'),
        ("[General", 'line 1: not a section: "[General"'),
        ("[UartEndpoint]", "line 1: [UartEndpoint] needs a name"),
        ("[UartEndpoint a]", "line 1: [UartEndpoint a] has no Device"),
        ("[UartEndpoint a]\nDevice=x\nBaud=fast", 'line 3: Baud must be numbers with commas, not "fast"'),
        ("[UartEndpoint a]\nDevice=x\nFlowControl=maybe", "line 3: FlowControl must be true or false"),
        ("[UdpEndpoint a]\nMode=odd\nAddress=h", 'line 2: Mode must be Normal or Server, not "odd"'),
        ("[UdpEndpoint a]\nMode=Server\nAddress=h", "line 1: [UdpEndpoint a] has no Port"),
        ("[TcpEndpoint a]\nAddress=h\nPort=70000", 'Port must be a number from 1 to 65535, not "70000"'),
        ("[TcpEndpoint a]\nAddress=h\nPort=1\n[TcpEndpoint a]", "line 4: [TcpEndpoint a] is defined twice"),
    ],
)
def test_what_mavlink_router_would_not_take_is_refused_with_its_line(text: str, said: str) -> None:
    assert said in refusal(text)


def test_an_unknown_section_is_left_out_with_a_note() -> None:
    assert "line 1: section [Odd thing] is unknown" in notes("[Odd thing]\nkey=1")


@given(st.text(max_size=80) | st.text(max_size=60).map(lambda tail: "[UartEndpoint a]\nDevice=" + tail))
def test_any_text_becomes_toml_or_is_refused(text: str) -> None:
    try:
        imported = import_router(text, "main.conf")
    except ConfigError:
        return
    tomllib.loads(imported.text)


def test_endpoints_that_cannot_stand_in_one_fleet_are_told_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, target = tmp_path / "main.conf", tmp_path / "fleet.toml"
    source.write_text("".join(f"[UdpEndpoint {n}]\nMode=Server\nAddress=0.0.0.0\nPort=1\n" for n in "ab"))
    run("import-router", source, "-o", target, code=1)
    assert "UDP port 1 is already used by links.a" in capsys.readouterr().err
    assert not target.exists()


def test_an_output_that_exists_is_kept_unless_told_otherwise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, target = tmp_path / "main.conf", tmp_path / "fleet.toml"
    source.write_text(NO_TCP)
    target.write_text("precious")
    run("import-router", source, "-o", target, code=1)
    assert "exists; --force overwrites it" in capsys.readouterr().err
    assert target.read_text() == "precious"
    run("import-router", source, "-o", target, "--force")
    assert "precious" not in target.read_text()


def test_without_an_output_it_is_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "main.conf"
    source.write_text(NO_TCP + "[UartEndpoint a]\nDevice=/dev/x\n")
    run("import-router", source)
    assert tomllib.loads(capsys.readouterr().out)["links"]["a"]["device"] == "/dev/x"
    run("import-router", tmp_path / "gone.conf", code=1)
    assert "cannot be read" in capsys.readouterr().err
