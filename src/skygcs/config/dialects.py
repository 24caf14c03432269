"""From a dialect's name or XML file to its tables, through mavgen's own parser, cached by content.

mavgen (pymavlink.generator.mavparse) computes field order, extension rules, target offsets and CRC_EXTRA, so they
are pymavlink's by construction; what skygcs keeps is the table, not generated Python: loading the cached table takes
some 20 ms where importing pymavlink's generated `all` module takes over 300 ms.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import re
from collections.abc import Sequence
from importlib import util
from pathlib import Path, PurePosixPath
from typing import Any

from skygcs.config.files import write_whole
from skygcs.core.mavlink.dialect import ABSENT, MAX_PAYLOAD_BYTES, Dialect, FieldInfo, MessageInfo
from skygcs.errors import DialectError
from skygcs.spelling import near_names

TABLE_FORMAT = 3
"""Raised whenever the same XML gives another table: old cache files are then never read."""

MAX_INCLUDE_DEPTH = 5
"""mavgen's own limit (MAXIMUM_INCLUDE_FILE_NESTING)."""

PX4_EXTRAS = "px4-extras"
"""Shipped file with the messages PX4 sends that pymavlink's XML lacks."""

SHIPPED_FOLDER = "dialects"
"""Name of the folder of shipped XML, in a checkout and in the installed package."""

_INCLUDE = re.compile(rb"<include>([^<]++)</include>")
_ENCODINGS = frozenset({"UTF-8", "UTF8", "ASCII", "US-ASCII", "ISO-8859-1"})
"""In these a tag is its ASCII bytes, which the search for includes relies on."""

_COMMENT = re.compile(rb"<!--(?:.*?-->|.*)", re.DOTALL)


def shipped_dialects_dir() -> Path:
    """Folder of the XML shipped with skygcs: inside the package when installed, at the project's top in a checkout."""
    packaged = Path(__file__).parent.parent / SHIPPED_FOLDER
    if packaged.is_dir():
        return packaged
    return Path(__file__).parents[3] / SHIPPED_FOLDER


def _pymavlink_dir() -> Path:
    """pymavlink's folder, found without importing it (its import pulls in more than we need)."""
    spec = util.find_spec("pymavlink")
    if spec is None or spec.origin is None:
        raise DialectError("pymavlink", None, "is not installed; reinstall skygcs")
    return Path(spec.origin).parent


def _parser_source() -> bytes:
    """The source of mavgen's parser, which decides with the XML what the table is; b"" if it is not readable."""
    try:
        return (_pymavlink_dir() / "generator" / "mavparse.py").read_bytes()
    except OSError:
        return b""


def packaged_dialects_dir() -> Path:
    """Folder of pymavlink's packaged XML."""
    return _pymavlink_dir() / "dialects" / "v20"


def default_cache_dir() -> Path:
    """$XDG_CACHE_HOME/skygcs/dialects, by default below ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = Path(base) if base else Path.home() / ".cache"
    except RuntimeError:  # a user without a home: a path that cannot be made means no cache
        folder = Path(os.devnull)
    return folder / "skygcs" / "dialects"


def load_dialect(
    name_or_path: str | Sequence[str], *, base_dir: Path | None = None, cache_dir: Path | None = None
) -> Dialect:
    """The dialect of that name (pymavlink's or shipped) or XML path; a list merges several, first ones win; of two
    definitions of a message that differ in extension fields only, the longer one.

    A path is anything with a slash or ending in .xml, relative to ``base_dir`` (the fleet file's folder). Where no file
    is at ``NAME.xml`` or ``dialects/NAME.xml`` there, the shipped one of that name is meant.
    Raises DialectError naming file and line. Reads and writes the cache; one that cannot be written is no error.
    """
    wanted = [name_or_path] if isinstance(name_or_path, str) else list(name_or_path)
    roots = [_resolve(w, base_dir) for w in wanted]
    sources = _collect(roots)
    digest = hashlib.sha256(f"{TABLE_FORMAT} ".encode() + _parser_source())
    for path, content in sources:
        digest.update(path.name.encode() + b"\0" + content + b"\0")
    label = "+".join(root.stem for root in roots)
    cache = (cache_dir or default_cache_dir()) / f"{label}-{digest.hexdigest()[:24]}.table"
    with contextlib.suppress(OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return Dialect.from_table(json.loads(_checked(cache.read_bytes())))
    dialect = _generate(label, sources)
    _store(cache, dialect)
    return dialect


def offline_dialect() -> Dialect:
    """Return what offline tools use: everything pymavlink knows plus the PX4 extras, so that most logs decode whole."""
    return load_dialect(["all", PX4_EXTRAS])


def located(name_or_path: str, folder: Path) -> str:
    """A name as it is; of a path the absolute one, from ``folder``, or the shipped file that is meant instead.

    A file that is nowhere keeps the path where it is missed: `load_dialect` says so.
    """
    if not _is_path(name_or_path):
        return name_or_path
    path = Path(os.path.normpath(folder / os.path.expanduser(name_or_path)))  # which leaves ~nobody: no such file
    shipped = shipped_dialects_dir() / path.name
    if not os.path.exists(path) and _place_of_shipped(name_or_path) and os.path.isfile(shipped):
        return str(shipped)
    return str(path)


def _is_path(text: str) -> bool:
    return "/" in text or text.endswith(".xml")


def _resolve(name_or_path: str, base_dir: Path | None) -> Path:
    if _is_path(name_or_path):
        path = Path(located(name_or_path, base_dir or Path()))
        if os.path.isfile(path):
            return path
        text = "is a folder" if os.path.isdir(path) else f"no such dialect file{_names_instead(path.stem)}"
        raise DialectError(str(path), None, text)
    for folder in (shipped_dialects_dir(), packaged_dialects_dir()):
        path = folder / f"{name_or_path}.xml"
        if os.path.isfile(path):
            return path
    known = sorted({p.stem for d in (shipped_dialects_dir(), packaged_dialects_dir()) for p in d.glob("*.xml")})
    near = near_names(name_or_path, known, n=1)
    hint = f"; did you mean {near[0]}?" if near else f"; known: {', '.join(known)}"
    raise DialectError(name_or_path, None, "no dialect of this name" + hint)


def _place_of_shipped(text: str) -> bool:
    """True for ``NAME.xml`` and ``dialects/NAME.xml``: where a checkout and an installation have the shipped ones."""
    path = PurePosixPath(text)
    return path.suffix == ".xml" and path.parent.as_posix() in (".", SHIPPED_FOLDER)


def _names_instead(stem: str) -> str:
    """How the dialect that a missing file was probably meant to be is called; "" if none is near."""
    shipped = sorted(path.stem for path in shipped_dialects_dir().glob("*.xml"))
    if stem in shipped:
        return f"; the shipped one is called {stem}"
    if os.path.isfile(packaged_dialects_dir() / f"{stem}.xml"):
        return f"; pymavlink's is called {stem}"
    near = near_names(stem, shipped, n=1)
    return f"; did you mean {SHIPPED_FOLDER}/{near[0]}.xml, which is shipped?" if near else ""


def _collect(roots: list[Path]) -> list[tuple[Path, bytes]]:
    """Every file that takes part, each once, an including one before what it includes. Raises DialectError."""
    found: dict[Path, tuple[Path, bytes]] = {}

    def visit(path: Path, chain: tuple[Path, ...]) -> None:
        real = path.resolve()
        if real in found:
            return
        try:
            content = path.read_bytes()
        except OSError as error:
            raise DialectError(str(path), None, f"cannot be read: {error.strerror}") from None
        found[real] = (path, content)
        chain = (*chain, real)
        visible = _COMMENT.sub(lambda m: b"\n" * m.group().count(b"\n"), content)  # keeps the lines
        for match in _INCLUDE.finditer(visible):
            line = visible.count(b"\n", 0, match.start()) + 1
            name = match.group(1).decode("utf-8", "replace").strip()
            if len(chain) > MAX_INCLUDE_DEPTH:
                raise DialectError(str(path), line, f"includes nest deeper than {MAX_INCLUDE_DEPTH}")
            included = _resolve_include(path, line, name)
            if included.resolve() in chain:
                raise DialectError(str(path), line, f"includes {name}, which includes this file again")
            visit(included, chain)

    for root in roots:
        visit(root, ())
    return list(found.values())


def _resolve_include(including: Path, line: int, name: str) -> Path:
    for candidate in (
        including.parent / name,
        packaged_dialects_dir() / Path(name).name,
        shipped_dialects_dir() / name,
    ):
        if os.path.isfile(candidate):
            return candidate
    raise DialectError(str(including), line, f"includes {name}, which is neither beside it nor packaged with pymavlink")


def _generate(label: str, sources: list[tuple[Path, bytes]]) -> Dialect:
    messages: dict[int, MessageInfo] = {}
    origin: dict[int | str, tuple[Path, Any]] = {}
    enums: dict[str, dict[int, str]] = {}
    for path, content in sources:
        _validate(path, content)
        xml = _parse(path)
        bitmasks = {e.name for e in xml.enum if e.bitmask}
        for message in xml.message:
            if _is_known(path, message, origin):
                _lengthen(messages, _message_info(message, bitmasks))
                continue
            origin[message.id] = origin[message.name] = (path, message)
            messages[message.id] = _message_info(message, bitmasks)
        for enum in xml.enum:
            entries = enums.setdefault(enum.name, {})
            for entry in enum.entry:
                if "_RESERVED" in entries.setdefault(entry.value, entry.name):  # a later file knows what took its place
                    entries[entry.value] = entry.name
    return Dialect(label, messages.values(), enums)


def _is_known(path: Path, message: Any, origin: dict[int | str, tuple[Path, Any]]) -> bool:
    """The same message again (a copied file) is fine; two meanings of one id or of one name are not."""
    for key in (message.id, message.name):
        if key not in origin:
            continue
        first_path, first = origin[key]
        if (first.id, first.name, first.crc_extra) == (message.id, message.name, message.crc_extra):
            return True
        raise DialectError(
            str(first_path),
            first.linenumber,
            f"{first.name} (id {first.id}) is in conflict with {message.name} (id {message.id}) in "
            f"{path.name}:{message.linenumber}",
        )
    return False


def _lengthen(messages: dict[int, MessageInfo], other: MessageInfo) -> None:
    """Take the further extension fields of a second definition of the same message: they are not part of its CRC, and
    an older XML lacks them."""
    first = messages[other.msgid]
    layout, longer = ([(f.name, f.type, f.array_length, f.offset) for f in info.fields] for info in (first, other))
    if len(longer) > len(layout) and all(field in longer for field in layout):
        known = {field.name: field for field in first.fields}
        other.fields = tuple(known.get(field.name, field) for field in other.fields)
        messages[other.msgid] = other


def _message_info(message: Any, bitmasks: set[str]) -> MessageInfo:
    base = {f.name for f in message.ordered_fields[: message.base_fields()]}
    fields = [
        FieldInfo(
            f.name,
            f.type,
            f.array_length,
            f.wire_offset,
            f.name not in base,
            f.enum,
            f.units.strip("[]"),
            f.enum in bitmasks or f.display == "bitmask",
        )
        for f in message.fields
    ]
    return MessageInfo(
        message.id,
        message.name,
        message.crc_extra,
        message.wire_min_length,
        message.wire_length,
        message.target_system_ofs if message.message_flags & 1 else ABSENT,
        message.target_component_ofs if message.message_flags & 2 else ABSENT,
        fields,
    )


def _validate(path: Path, content: bytes) -> None:
    """Against the schema pymavlink ships (mavschema.xsd): syntax, tags, attributes, types, each with its line."""
    from lxml import etree

    parser = etree.XMLParser(resolve_entities=False, no_network=True)
    try:
        document = etree.parse(io.BytesIO(content), parser)
    except etree.XMLSyntaxError as error:
        raise DialectError(str(path), error.lineno or 1, str(error.msg).split(", line ")[0]) from None
    encoding = document.docinfo.encoding or "UTF-8"
    if b"\0" in content or encoding.upper() not in _ENCODINGS:
        raise DialectError(str(path), 1, "is not written in UTF-8; save it as UTF-8")
    if document.docinfo.doctype:
        raise DialectError(str(path), 1, "has a DOCTYPE; a dialect needs none, and entities are not resolved")
    schema_path = _pymavlink_dir() / "generator" / "mavschema.xsd"
    tree = etree.parse(str(schema_path))
    for element in tree.iterfind('{*}attribute[@name="units"]'):
        element.set("type", "xs:string")  # as mavgen does by default, without strict units
    schema = etree.XMLSchema(tree)
    if not schema.validate(document):
        first = schema.error_log[0]
        raise DialectError(str(path), first.line, _schema_text(str(first.message)))
    for field in document.iter("field"):
        size = re.search(r"\[([0-9]+)\]", field.get("type"))
        if size is not None and (len(size[1]) > 3 or not 1 <= int(size[1]) <= MAX_PAYLOAD_BYTES):
            text = f"{field.get('name')} is an array of {size[1]}; it may have 1 to {MAX_PAYLOAD_BYTES} items"
            raise DialectError(str(path), field.sourceline, text)


def _schema_text(message: str) -> str:
    """The validator names the last pattern it tried, which is no help: say what a type or name may be instead."""
    found = re.match(r"Element '(\w+)', attribute '(\w+)': .*The value '([^']*)'", message)
    wanted = {
        "type": "a type is float, double, char or [u]int8_t to [u]int64_t, as an array with [n]",
        "name": "a name has letters, digits and _ only",
        "id": "an id is a whole number from 0 to 16777215",
        "value": "a value is a whole number (also 0x.., 0b.., 2**n)",
    }
    if found is None or found[2] not in wanted:
        return message
    return f"{found[1]} has {found[2]} '{found[3]}': {wanted[found[2]]}"


def _parse(path: Path) -> Any:
    from pymavlink.generator import mavparse

    try:
        with contextlib.redirect_stdout(io.StringIO()):  # mavparse prints its notes
            xml = mavparse.MAVXML(str(path), mavparse.PROTOCOL_2_0)
    except Exception as error:  # mavparse evals, asserts and raises what it likes; the schema has seen the file already
        raise DialectError(str(path), _line_of(error), f"{type(error).__name__}: {error}") from None
    _check_messages(path, xml)
    return xml


def _line_of(error: BaseException) -> int | None:
    """The XML line at which mavparse stopped: its handlers run as closures over the expat parser ``p``.

    Also closes the file ``f`` that it leaves open.
    """
    trace = error.__traceback__
    line = None
    while trace is not None:
        names = trace.tb_frame.f_locals
        if isinstance(file := names.get("f"), io.IOBase):
            file.close()
        found = getattr(names.get("p"), "CurrentLineNumber", None)
        line = found if isinstance(found, int) else line
        trace = trace.tb_next
    return line


def _check_messages(path: Path, xml: Any) -> None:
    ids: dict[int, Any] = {}
    names: dict[str, Any] = {}
    for message in xml.message:
        for key, seen in ((message.id, ids), (message.name, names)):
            if key in seen:
                first = seen[key].linenumber
                raise DialectError(str(path), message.linenumber, f"message {key} is already defined in line {first}")
            seen[key] = message
        if not 0 <= message.id < 1 << 24:
            raise DialectError(str(path), message.linenumber, f"message id {message.id} is not in 0..16777215")
        if message.wire_length > MAX_PAYLOAD_BYTES:
            text = f"{message.name} has {message.wire_length} bytes; a payload has at most {MAX_PAYLOAD_BYTES}"
            raise DialectError(str(path), message.linenumber, text)
        fields = [f.name for f in message.fields]
        for field in fields:
            if fields.count(field) > 1:
                raise DialectError(str(path), message.linenumber, f"{message.name} has the field {field} twice")


def _store(cache: Path, dialect: Dialect) -> None:
    """Whole or not at all: two daemons that start together never read half a file."""
    try:
        cache.parent.mkdir(parents=True, exist_ok=True)
        content = json.dumps(dialect.to_table(), separators=(",", ":")).encode()
        write_whole(cache, _digest_line(content) + content, 0o600, durable=False)
    except OSError:
        return  # a read-only home costs a second at every start, not a flight


def _digest_line(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode() + b"\n"


def _checked(stored: bytes) -> bytes:
    """The content of a cache file without its digest, as much of it is read in flight only. Raises ValueError."""
    line, found, content = stored.partition(b"\n")
    if line + found != _digest_line(content):
        raise ValueError("a file of the cache was changed")
    return content
