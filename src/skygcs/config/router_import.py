"""Converts a mavlink-router configuration to a fleet file, with a comment for each key that skygcs does not have.

A key that the configuration leaves out is written with mavlink-router's default where that of skygcs differs. Links
keep the role `peer`, which forwards as mavlink-router does.
Format: mavlink-router's examples/config.sample; sections, keys and values in any case.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from skygcs.errors import ConfigError

DEFAULT_TCP_PORT = 5760
"""Port of mavlink-router's TCP server, which it opens unless TcpServerPort = 0."""

FIRST_UDP_PORT = 14550
"""First port tried for a UDP endpoint in normal mode that names none."""

DEFAULT_BAUD = 115200
DEFAULT_RETRY_S = 5

KINDS = {"uartendpoint": "UartEndpoint", "udpendpoint": "UdpEndpoint", "tcpendpoint": "TcpEndpoint"}

FILTERS = {
    f"{rule}{what}{way}": f"{rule}_{key}_{way}"
    for rule in ("allow", "block")
    for what, key in (("msgid", "msg_id"), ("srccomp", "src_comp"), ("srcsys", "src_sys"))
    for way in ("in", "out")
}
FILTERS["filter"] = "allow_msg_id_out"  # its name before version 3

ENDPOINT_KEYS = {
    "uartendpoint": {"device", "baud", "flowcontrol"},
    "udpendpoint": {"mode", "address", "port"},
    "tcpendpoint": {"address", "port", "retrytimeout"},
}

GENERAL_NOTES = {
    "reportstats": "skygcs-cli links shows the counters of every link",
    "debugloglevel": "skygcs run --verbose or --quiet",
    "mavlinkdialect": "skygcs reads both autopilots' messages at once (dialect)",
    "deduplicationperiod": "copies over parallel links are found without it; links of one group are such links",
    "logmode": "skygcs records from start to end",
    "logsystemid": "skygcs records every vehicle",
    "minfreespace": "delete old tlogs yourself, or with logrotate",
    "maxlogfiles": "delete old tlogs yourself, or with logrotate",
    "sniffersysid": "the socket's message.subscribe shows all traffic; so does a tlog",
}
"""Keys of [General] without a counterpart, and what skygcs offers instead."""

TRUE, FALSE = frozenset({"true", "1", "yes", "on"}), frozenset({"false", "0", "no", "off"})


@dataclass(frozen=True, slots=True)
class RouterImport:
    """The fleet file's text, and a note for each line of the configuration that was not converted."""

    text: str
    notes: tuple[str, ...]


@dataclass(slots=True)
class _Section:
    """One section. ``keys``: name in lower case to the value as written and its line number."""

    kind: str
    name: str
    line: int
    keys: dict[str, tuple[str, int]] = field(default_factory=dict)


def import_router(text: str, source: str) -> RouterImport:
    """Raises ConfigError that lists every line which mavlink-router would reject, too."""
    reader = _Reader(source)
    sections = reader.sections(text)
    general = [s for s in sections if s.kind == "general"]
    endpoints = [s for s in sections if s.kind in KINDS]
    out = [f"# Made from {_one_line(source)}, a mavlink-router configuration.", ""]
    out += reader.daemon(general)
    taken: set[str] = set()
    ports = _free_ports(endpoints)
    for section in endpoints:
        out += ["", *reader.endpoint(section, taken, ports)]
    out += reader.tcp_server(general, taken)
    if reader.problems:
        raise ConfigError(source, reader.problems)
    return RouterImport("\n".join(out) + "\n", tuple(reader.notes))


class _Reader:
    """Converts sections to TOML lines. Collects problems, for which the file is rejected, and notes."""

    def __init__(self, source: str) -> None:
        self.source = source
        self.problems: list[str] = []
        self.notes: list[str] = []
        self._lines: list[str] = []

    def sections(self, text: str) -> list[_Section]:
        found: list[_Section] = []
        self._lines = text.splitlines()
        for number, raw in enumerate(self._lines, 1):
            line = raw.strip()
            if not line or line.startswith(("#", ";")):
                continue
            if line.startswith("["):
                found.append(self._header(line, number, found))
                continue
            key, equals, value = line.partition("=")
            if not equals or not key.strip():
                self.problems.append(f"line {number}: neither a section nor key = value: {_short(line)}")
            elif not found:
                self.problems.append(f"line {number}: {_short(key.strip())} is before the first section")
            else:
                found[-1].keys[key.strip().lower()] = (value.strip(), number)
        return found

    def _header(self, line: str, number: int, found: list[_Section]) -> _Section:
        parts = line.strip("[] \t").split(maxsplit=1) if line.endswith("]") else []
        kind = parts[0].lower() if parts else ""
        section = _Section(kind, parts[1] if len(parts) > 1 else "", number)
        if not parts:
            self.problems.append(f"line {number}: not a section: {_short(line)}")
        elif kind in KINDS and not section.name:
            self.problems.append(f"line {number}: [{parts[0]}] needs a name: [{parts[0]} alpha]")
        elif kind not in KINDS and kind != "general":
            self.notes.append(f"line {number}: section [{_one_line(' '.join(parts))}] is unknown and was left out")
        elif kind in KINDS and any((s.kind, s.name) == (kind, section.name) for s in found):
            self.problems.append(f"line {number}: [{parts[0]} {section.name}] is defined twice")
        return section

    def daemon(self, sections: list[_Section]) -> list[str]:
        keys = {key: entry for section in sections for key, entry in section.keys.items()}
        out = [
            "# skygcs sends a ground station's heartbeat of its own; mavlink-router does not. If an autopilot's",
            "# failsafe is to watch another station only, set heartbeat = false; a SiK radio needs it true.",
            "[daemon]",
            "heartbeat = true",
        ]
        log, log_line = keys.pop("log", ("", 0))
        telemetry = self.boolean(keys.pop("logtelemetry", ("false", 0)), "LogTelemetry")
        if log and telemetry:
            out.append(f"log_dir = {_quoted(log)}")
        elif log:
            out.append(self.noted(log_line, "the autopilot's own log is not streamed by skygcs"))
        if not (log and telemetry):
            out.append("record = false  # mavlink-router writes no tlog here; true writes them to log_dir")
        keys.pop("tcpserverport", None)
        for key, (_, line) in keys.items():
            reason = GENERAL_NOTES.get(key, "unknown to mavlink-router's sample too")
            out.append(self.noted(line, reason))
        return out

    def tcp_server(self, sections: list[_Section], taken: set[str]) -> list[str]:
        entry = next((s.keys["tcpserverport"] for s in reversed(sections) if "tcpserverport" in s.keys), None)
        port = DEFAULT_TCP_PORT if entry is None else self.whole(entry, "TcpServerPort", 0, 65535)
        if not port:
            return []
        why = "its default: TcpServerPort = 0 turns it off" if entry is None else "TcpServerPort"
        name = _unused("tcp", taken)
        return ["", f"# {why}", _table(name), 'type = "tcp_server"', 'host = "0.0.0.0"', f"port = {port}"]

    def endpoint(self, section: _Section, taken: set[str], ports: Iterator[int]) -> list[str]:
        keys = dict(section.keys)
        name = _unused(section.name, taken)
        out = [_table(name)]
        match section.kind:
            case "uartendpoint":
                out += self._uart(section, keys)
            case "udpendpoint":
                out += self._udp(section, keys, ports)
            case "tcpendpoint":
                out += self._tcp(section, keys)
        if group := keys.pop("group", None):
            out += [f"group = {_quoted(group[0])}"] if group[0] else []
        for key in [k for k in keys if k in FILTERS]:
            entry = keys.pop(key)
            numbers = self.numbers(entry, key)
            out += [f"{FILTERS[key]} = {numbers}"] if numbers else []
        for key, (_, line) in keys.items():
            if key not in ENDPOINT_KEYS[section.kind]:
                out.append(self.noted(line, "no such key in mavlink-router's sample"))
        return out

    def _uart(self, section: _Section, keys: dict[str, tuple[str, int]]) -> list[str]:
        out = ['type = "serial"', f"device = {_quoted(self.needed(section, keys, 'Device'))}"]
        rates = self.numbers(keys.get("baud", (str(DEFAULT_BAUD), 0)), "Baud") or [DEFAULT_BAUD]
        out.append(f"baud = {rates[0] if len(rates) == 1 else rates}")
        if self.boolean(keys.get("flowcontrol", ("false", 0)), "FlowControl"):
            out.append("rtscts = true")
        return out

    def _udp(self, section: _Section, keys: dict[str, tuple[str, int]], ports: Iterator[int]) -> list[str]:
        mode = self.needed(section, keys, "Mode").lower()
        host = self.needed(section, keys, "Address").strip("[]")
        listens = mode in ("server", "eavesdropping")
        if not listens and mode != "normal":
            line = keys["mode"][1] if "mode" in keys else section.line
            self.problems.append(f"line {line}: Mode must be Normal or Server, not {_short(mode)}")
        if "port" in keys:
            port = self.whole(keys["port"], "Port", 1, 65535)
        elif listens:
            port = 0
            self.problems.append(f"line {section.line}: [{KINDS[section.kind]} {section.name}] has no Port")
        else:
            port = next(ports)
        if listens:
            return ['type = "udp_server"', f"host = {_quoted(host)}", f"port = {port}"]
        if host.endswith(".255"):
            seen = (
                "# a broadcast address: frames go there until a peer answers, then to that peer, as in mavlink-router"
            )
            return [seen, 'type = "udp_broadcast"', f"host = {_quoted(host)}", f"port = {port}"]
        return ['type = "udp_client"', f"host = {_quoted(host)}", f"port = {port}"]

    def _tcp(self, section: _Section, keys: dict[str, tuple[str, int]]) -> list[str]:
        host = self.needed(section, keys, "Address").strip("[]")
        port = self.whole((self.needed(section, keys, "Port") or "0", section.line), "Port", 1, 65535)
        out = ['type = "tcp_client"', f"host = {_quoted(host)}", f"port = {port}"]
        if "retrytimeout" in keys:
            _, line = keys["retrytimeout"]
            reason = "skygcs reconnects by itself, at growing intervals, without a limit"
            if self.whole(keys["retrytimeout"], "RetryTimeout", 0, 2**31) != DEFAULT_RETRY_S:
                out.append(self.noted(line, reason))
        return out

    def noted(self, line: int, reason: str) -> str:
        """A comment for the file; the user is shown it, too."""
        text = f"{_one_line(self._lines[line - 1].strip())}: {reason}"
        self.notes.append(f"line {line}: {text}")
        return f"# not converted (line {line}): {text}"

    def needed(self, section: _Section, keys: dict[str, tuple[str, int]], key: str) -> str:
        value, _ = keys.get(key.lower(), ("", 0))
        if not value:
            self.problems.append(f"line {section.line}: [{KINDS[section.kind]} {section.name}] has no {key}")
        return value

    def whole(self, entry: tuple[str, int], key: str, least: int, most: int) -> int:
        value, line = entry
        if re.fullmatch(r"[0-9]{1,10}", value) and least <= int(value) <= most:
            return int(value)
        self.problems.append(f"line {line}: {key} must be a number from {least} to {most}, not {_short(value)}")
        return least

    def numbers(self, entry: tuple[str, int], key: str) -> list[int]:
        value, line = entry
        parts = [part.strip() for part in value.split(",") if part.strip()]
        wrong = [part for part in parts if not re.fullmatch(r"[0-9]{1,10}", part)]
        if wrong:
            self.problems.append(f"line {line}: {key} must be numbers with commas, not {_short(value)}")
            return []
        return [int(part) for part in parts]

    def boolean(self, entry: tuple[str, int], key: str) -> bool:
        value, line = entry
        if value.lower() not in TRUE | FALSE:
            self.problems.append(f"line {line}: {key} must be true or false, not {_short(value)}")
        return value.lower() in TRUE


def _free_ports(endpoints: list[_Section]) -> Iterator[int]:
    """Free ports for UDP endpoints that name none, from FIRST_UDP_PORT on."""
    named = {s.keys["port"][0] for s in endpoints if s.kind == "udpendpoint" and "port" in s.keys}
    return (port for port in range(FIRST_UDP_PORT, 65536) if str(port) not in named)


def _unused(name: str, taken: set[str]) -> str:
    """The name, made unique: endpoints of different kinds may share a name, links may not."""
    free, number = name, 2
    while free in taken:
        free, number = f"{name}{number}", number + 1
    taken.add(free)
    return free


def _table(name: str) -> str:
    return f"[links.{name if re.fullmatch(r'[A-Za-z0-9_-]+', name) else _quoted(name)}]"


def _quoted(text: str) -> str:
    """A TOML basic string. TOML has all escapes of JSON; it also requires one for DEL."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _short(text: str) -> str:
    text = _one_line(text)
    return f'"{text}"' if len(text) <= 40 else f'"{text[:37]}..."'


def _one_line(text: str) -> str:
    """One line without control characters, as a TOML comment must be."""
    return "".join(c if c.isprintable() else "?" for c in text)
