"""From XML to tables: what is found where, what is cached, and one clear error for every broken file."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from skygcs.config import dialects
from skygcs.config.dialects import default_cache_dir, load_dialect, offline_dialect
from skygcs.core.mavlink.dialect import Dialect
from skygcs.errors import DialectError
from support.table import each

HEAD = '<?xml version="1.0"?>\n<mavlink>\n'


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache of this test's own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    return tmp_path / "xdg" / "skygcs" / "dialects"


def message(fields: str = '<field type="uint8_t" name="a">x</field>', *, id: str = "60000", name: str = "LAB") -> str:
    return f'<message id="{id}" name="{name}">\n<description>d</description>\n{fields}\n</message>\n'


def write(folder: Path, name: str, messages: str, *, before: str = "") -> Path:
    path = folder / name
    path.write_text(f"{HEAD}{before}<messages>\n{messages}</messages>\n</mavlink>\n")
    return path


def load(path: Path) -> Dialect:
    return load_dialect(str(path))


# -- what is found where


def test_a_lab_message_needs_one_file_and_no_code(tmp_path: Path, cache: Path) -> None:
    path = write(tmp_path, "lab.xml", message(), before="<include>common.xml</include>\n")
    table = load(path)
    assert table.find("LAB").length == 1
    assert table.find("ATTITUDE").crc_extra == 39
    assert load_dialect("lab.xml", base_dir=tmp_path).find("LAB").msgid == 60000
    assert load_dialect("./lab.xml", base_dir=tmp_path).find("LAB").msgid == 60000


def test_an_include_beside_the_file_goes_before_the_packaged_one(tmp_path: Path, cache: Path) -> None:
    path = write(tmp_path, "lab.xml", message(), before="<include>common.xml</include>\n")
    write(tmp_path, "common.xml", message(id="60001", name="OURS"))
    assert set(load(path).by_name) == {"LAB", "OURS"}


def test_a_list_of_dialects_is_merged(cache: Path) -> None:
    table = load_dialect(["common", "px4-extras"])
    assert {410, 0} <= table.messages.keys() and "MEMINFO" not in table.by_name
    assert offline_dialect().find("MEMINFO").msgid == 152


def test_extension_fields_that_only_a_later_definition_has_are_taken_over(tmp_path: Path, cache: Path) -> None:
    base = '<field type="uint8_t" name="a">x</field>'
    write(tmp_path, "short.xml", message(base))
    write(tmp_path, "long.xml", message(base + '<extensions/><field type="uint8_t" name="target_system">x</field>'))
    write(tmp_path, "other.xml", message(base + '<extensions/><field type="uint8_t" name="b">x</field>'))
    names = [str(tmp_path / f"{name}.xml") for name in ("short", "long", "other")]
    for first, second in ((0, 1), (1, 0)):
        lab = load_dialect([names[first], names[second]]).find("LAB")
        assert (lab.length, lab.min_length, lab.target_system_offset) == (2, 1, 1)
    # neither of two that differ is the longer one: the first stays
    assert [f.name for f in load_dialect([names[1], names[2]]).find("LAB").fields] == ["a", "target_system"]


def test_a_line_for_a_shell_names_its_vehicle(cache: Path) -> None:
    info = load_dialect(["ardupilotmega", "px4-extras"]).find("SERIAL_CONTROL")
    assert (info.crc_extra, info.min_length, info.length) == (220, 79, 81)  # PX4's common.xml
    assert (info.target_system_offset, info.target_component_offset) == (79, 80)
    assert next(field for field in info.fields if field.name == "flags").bitmask


def test_a_reserved_number_has_the_name_that_a_later_file_gives_it(cache: Path) -> None:
    kinds = load_dialect(["ardupilotmega", "px4-extras"]).enums["MAV_TYPE"]
    assert (kinds[21], kinds[22], kinds[25]) == tuple(
        f"MAV_TYPE_VTOL_{name}" for name in ("TILTROTOR", "FIXEDROTOR", "RESERVED5")
    )


def test_an_unknown_name_says_what_there_is(cache: Path) -> None:
    with pytest.raises(DialectError, match=r"comon: no dialect of this name; did you mean common\?"):
        load_dialect("comon")
    with pytest.raises(DialectError, match=r"known: .*ardupilotmega.*utias"):
        load_dialect("qqqqqqq")


@pytest.mark.deep  # parses some 30 files; make test those that are shipped
def test_every_packaged_dialect_loads(cache: Path) -> None:
    for path in sorted(dialects.packaged_dialects_dir().glob("*.xml")):
        if path.stem == "paparazzi":  # redefines ids of common with other names' layouts
            continue
        assert load_dialect(path.stem).messages


# -- the cache


def test_the_second_time_no_xml_is_parsed(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, "lab.xml", message())
    first = load(path)
    monkeypatch.setattr(dialects, "_generate", lambda *_: pytest.fail("was parsed again"))
    assert load(path).to_table() == first.to_table()
    assert len(list(cache.glob("lab-*.table"))) == 1 and not list(cache.glob(".*"))


def test_a_changed_file_or_include_gives_a_new_table(tmp_path: Path, cache: Path) -> None:
    path = write(tmp_path, "lab.xml", message(), before="<include>more.xml</include>\n")
    write(tmp_path, "more.xml", message(id="60001", name="MORE"))
    assert load(path).find("LAB").length == 1
    write(
        tmp_path, "lab.xml", message('<field type="float" name="a">x</field>'), before="<include>more.xml</include>\n"
    )
    assert load(path).find("LAB").length == 4
    write(tmp_path, "more.xml", message('<field type="double" name="a">x</field>', id="60001", name="MORE"))
    assert load(path).find("MORE").length == 8


def test_files_of_one_name_do_not_share_a_table(tmp_path: Path, cache: Path) -> None:
    for folder, kind in (("a", "uint8_t"), ("b", "double")):
        (tmp_path / folder).mkdir()
        write(tmp_path / folder, "lab.xml", message(f'<field type="{kind}" name="a">x</field>'))
    assert load(tmp_path / "a" / "lab.xml").find("LAB").length == 1
    assert load(tmp_path / "b" / "lab.xml").find("LAB").length == 8


@each(
    "rubbish",
    [
        b"",
        b"{",
        b"\xff\xfe",
        b"[]",
        b"null",
        b"{}",
        b'{"name": "x", "messages": [[1]], "enums": {}}',
        b'{"name": "x", "messages": [], "enums": []}',
        b'{"name": "x", "messages": 5, "enums": {}}',
        b"[" * 100_000,
    ],
)
@each("with_digest", [False, True])
def test_a_broken_cache_file_is_ignored_and_replaced(
    tmp_path: Path, cache: Path, rubbish: bytes, with_digest: bool
) -> None:
    path = write(tmp_path, "lab.xml", message())
    load(path)
    (file,) = cache.glob("*.table")
    whole = file.read_bytes()
    digest = hashlib.sha256(rubbish).hexdigest().encode() + b"\n"
    file.write_bytes(digest + rubbish if with_digest else rubbish)
    assert load(path).find("LAB").msgid == 60000
    assert file.read_bytes() == whole


def test_a_cache_file_of_which_one_byte_is_another_is_not_read(tmp_path: Path, cache: Path) -> None:
    """Its fields are read when the first such message comes: then it is too late."""
    path = write(tmp_path, "lab.xml", message('<field type="uint16_t" name="a">x</field>'))
    load(path)
    (file,) = cache.glob("*.table")
    whole = file.read_bytes()
    file.write_bytes(whole.replace(b"uint16_t", b"uint10_t"))
    assert load(path).find("LAB").unpack(b"\x02\x01") == {"a": 0x102}
    assert file.read_bytes() == whole


def test_a_cache_that_can_not_be_written_is_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert load(write(tmp_path, "lab.xml", message())).find("LAB")


def test_without_a_home_there_is_no_cache_and_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)

    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    assert load(write(tmp_path, "lab.xml", message())).find("LAB")


CHILD = """
import sys
from pathlib import Path
from skygcs.config.dialects import load_dialect
cache = Path(sys.argv[2])
for _ in range(5):
    print(len(load_dialect(sys.argv[1], cache_dir=cache).messages))
    for file in cache.glob("*.table"):
        file.unlink(missing_ok=True)
"""


def test_two_processes_at_once_both_get_whole_tables(tmp_path: Path) -> None:
    path = write(tmp_path, "lab.xml", message(), before="<include>common.xml</include>\n")
    command = [sys.executable, "-c", CHILD, str(path), str(tmp_path / "c")]
    children = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    counts = []
    for child in children:
        out, _ = child.communicate(timeout=50)
        assert child.returncode == 0
        counts += out.split()
    assert counts == [str(len(load_dialect("common").messages) + 1)] * 10


def test_default_cache_follows_xdg(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", "/x/y")
    assert default_cache_dir() == Path("/x/y/skygcs/dialects")
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    monkeypatch.setenv("HOME", "/home/somebody")
    assert default_cache_dir() == Path("/home/somebody/.cache/skygcs/dialects")


# -- broken files

TWO_FIELDS = '<field type="uint8_t" name="a">x</field>\n<field type="uint8_t" name="a">x</field>'
LONG = '<field type="double[20]" name="a">x</field>\n<field type="double[20]" name="b">x</field>'

BROKEN = {
    "syntax": (f'{HEAD}<messages>\n<message id="1" name="A">\n</messages>\n</mavlink>', 5, "tag mismatch"),
    "no-xml": ("hello", 1, "Start tag expected"),
    "empty": ("", 1, "Document is empty"),
    "binary": (bytes(range(256)), 1, ""),
    "zeros": (bytes(100), 1, ""),
    "bad-utf8": (f"{HEAD}<messages>\n{message()}".encode() + b"<!-- \xff -->", 8, "Invalid bytes"),
    "utf16": (f"{HEAD}<messages>\n{message()}</messages></mavlink>".encode("utf-16"), 1, "save it as UTF-8"),
    "entities": ('<!DOCTYPE m [<!ENTITY a "aa">]>\n' + HEAD[22:] + "</mavlink>", 1, "DOCTYPE"),
    "other-root": ("<html></html>", 1, "html"),
    "no-messages": (f"{HEAD}</mavlink>", 2, "Missing child"),
    "unknown-tag": (f'{HEAD}<messages>\n<massage id="3" name="X"/>\n</messages></mavlink>', 4, "massage"),
    "unknown-type": (message('<field type="uint9_t" name="a">x</field>'), 6, "type 'uint9_t': a type is float"),
    "no-type": (message('<field name="a">x</field>'), 6, "attribute 'type' is required"),
    "no-name": (message('<field type="uint8_t">x</field>'), 6, "attribute 'name' is required"),
    "no-id": (message().replace(' id="60000"', ""), 4, "attribute 'id' is required"),
    "id-too-large": (message(id="16777216"), 4, "id is a whole number from 0 to 16777215"),
    "id-negative": (message(id="-1"), 4, "'-1'"),
    "id-text": (message(id="abc"), 4, "'abc'"),
    "name-blank": (message(name="A B"), 4, "name 'A B': a name has letters"),
    "no-fields": (message(""), 4, "field"),
    "array-of-none": (message('<field type="uint8_t[0]" name="a">x</field>'), 6, "array of 0"),
    "array-of-256": (message('<field type="uint8_t[256]" name="a">x</field>'), 6, "array of 256"),
    "array-of-too-many": (message('<field type="uint8_t[99999999999999]" name="a">x</field>'), 6, "1 to 255 items"),
    "payload-too-long": (message(LONG), 4, "LAB has 320 bytes; a payload has at most 255"),
    "field-twice": (message(TWO_FIELDS), 4, "LAB has the field a twice"),
    "id-twice": (message() + message(name="OTHER"), 8, "message 60000 is already defined in line 4"),
    "name-twice": (message() + message(id="60001"), 8, "message LAB is already defined in line 4"),
    "enum-value": (
        f'{HEAD}<enums>\n<enum name="E">\n<entry value="exit(1)" name="Q"/>\n</enum>\n</enums>\n<messages/></mavlink>',
        5,
        "value 'exit(1)': a value is a whole number",
    ),
    "enum-octal": (
        f'{HEAD}<enums>\n<enum name="E">\n<entry value="077" name="Q"/>\n</enum>\n</enums>\n'
        f"<messages>\n{message()}</messages></mavlink>",
        5,
        "leading zeros",
    ),
    "missing-include": (
        f"{HEAD}<!-- \n<include>gone.xml</include> -->\n<include>gone.xml</include>\n</mavlink>",
        5,
        "gone",
    ),
    # to look for the end of each of them took minutes, or days
    "long-include": (f"{HEAD}<include>{' ' * 30_000}<\n</mavlink>", 3, ""),
    "open-comments": (f"{HEAD}{'<!--' * 200_000}", 3, ""),
    "own-include": (f"{HEAD}<include>own-include.xml</include>\n</mavlink>", 3, "includes this file again"),
    "id-of-common": (
        f"{HEAD}<include>common.xml</include>\n<messages>\n{message(id='30')}</messages></mavlink>",
        5,
        "ATTITUDE",
    ),
    "name-of-common": (
        f"{HEAD}<include>common.xml</include>\n<messages>\n{message(name='ATTITUDE')}</messages></mavlink>",
        5,
        r"ATTITUDE (id 60000) is in conflict with ATTITUDE (id 30) in common.xml:",
    ),
}


@each("name", BROKEN)
def test_a_broken_file_is_one_error_with_file_and_line(tmp_path: Path, cache: Path, name: str) -> None:
    content, line, text = BROKEN[name]
    path = tmp_path / f"{name}.xml"
    if isinstance(content, str) and content.startswith("<message "):
        write(tmp_path, path.name, content)
    else:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(DialectError) as caught:
        load(path)
    assert (caught.value.path, caught.value.line) == (str(path), line), caught.value
    assert text in caught.value.reason
    assert "\n" not in str(caught.value)
    assert not list(cache.glob("*.table"))


def test_includes_in_a_circle_name_the_file_that_closes_it(tmp_path: Path, cache: Path) -> None:
    for name, other in (("a", "b"), ("b", "c"), ("c", "a")):
        write(tmp_path, f"{name}.xml", "", before=f"<include>{other}.xml</include>\n")
    with pytest.raises(DialectError, match=re.escape(f"{tmp_path / 'c.xml'}:3: includes a.xml, which includes this")):
        load(tmp_path / "a.xml")


def test_includes_that_meet_again_are_no_circle(tmp_path: Path, cache: Path) -> None:
    write(tmp_path, "a.xml", message(), before="<include>b.xml</include>\n<include>c.xml</include>\n")
    write(tmp_path, "b.xml", message(id="60001", name="B"), before="<include>d.xml</include>\n")
    write(tmp_path, "c.xml", message(id="60002", name="C"), before="<include>d.xml</include>\n")
    write(tmp_path, "d.xml", message(id="60003", name="D"))
    assert set(load(tmp_path / "a.xml").by_name) == {"LAB", "B", "C", "D"}


def test_includes_nest_no_deeper_than_mavgen_allows(tmp_path: Path, cache: Path) -> None:
    for n in range(8):
        write(
            tmp_path, f"n{n}.xml", message(id=str(60000 + n), name=f"N{n}"), before=f"<include>n{n + 1}.xml</include>\n"
        )
    write(tmp_path, "n8.xml", message())
    with pytest.raises(DialectError, match=r"n5\.xml:3: includes nest deeper than 5"):
        load(tmp_path / "n0.xml")


def test_a_broken_include_is_named_itself(tmp_path: Path, cache: Path) -> None:
    path = write(tmp_path, "lab.xml", message(), before="<include>part.xml</include>\n")
    (tmp_path / "part.xml").write_text("<mavlink>\n<oops></mavlink>")
    with pytest.raises(DialectError) as caught:
        load(path)
    assert (caught.value.path, caught.value.line) == (str(tmp_path / "part.xml"), 2)


def test_a_file_that_is_not_there_or_is_a_folder(tmp_path: Path, cache: Path) -> None:
    with pytest.raises(DialectError, match=r"gone\.xml: no such dialect file") as caught:
        load(tmp_path / "gone.xml")
    assert caught.value.line is None
    with pytest.raises(DialectError, match="is a folder"):
        load_dialect(f"{tmp_path}/")
