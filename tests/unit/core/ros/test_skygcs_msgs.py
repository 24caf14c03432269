"""The package skygcs_msgs: its build files name every definition, and definitions are those that rosidl takes."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path
from xml.etree import ElementTree

from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from skygcs.core.ros.interfaces import definitions, ros2_interfaces
from support.table import each

PACKAGE = Path(str(files("skygcs.core.ros"))) / "skygcs_msgs"
DEFINITIONS = sorted(path.relative_to(PACKAGE) for path in PACKAGE.rglob("*.*") if path.suffix in (".msg", ".action"))

FIELD = re.compile(r"((?:[a-z_]+/)?[A-Za-z0-9_]+)(\[\d*\])? ([a-z](?:_?[a-z0-9])*)")
CONSTANT = re.compile(r"[a-z0-9]+ [A-Z](_?[A-Z0-9])*=\S+")
"""Names of fields and constants by rosidl_parser."""


def lines(path: Path) -> list[str]:
    text = (PACKAGE / path).read_text()
    return [line for row in text.splitlines() if (line := row.partition("#")[0].strip())]


def test_the_build_files_name_every_definition_and_every_package() -> None:
    cmake = (PACKAGE / "CMakeLists.txt").read_text()
    assert re.findall(r'"((?:msg|action)/.*)"', cmake) == sorted(
        map(str, DEFINITIONS), key=lambda name: (name.startswith("action"), name)
    )
    used = {"action_msgs"}  # by every action
    for path in DEFINITIONS:
        used |= {line.partition("/")[0] for line in lines(path) if "/" in line.partition(" ")[0]}
    package = ElementTree.parse(PACKAGE / "package.xml").getroot()
    assert {found.text for found in package.findall("depend")} == used
    assert set(re.search(r"DEPENDENCIES (.*)", cmake).group(1).split()) == used  # type: ignore[union-attr]
    assert set(re.findall(r"find_package\((\w+)", cmake)) == used | {"ament_cmake", "rosidl_default_generators"}
    assert package.findtext("member_of_group") == "rosidl_interface_packages"
    assert {path.name for path in PACKAGE.iterdir()} == {"package.xml", "CMakeLists.txt", "msg", "action"}


@each("path", DEFINITIONS)
def test_definitions_are_those_that_rosidl_takes(path: Path) -> None:
    assert re.fullmatch(r"[A-Z][A-Za-z0-9]*", path.stem)
    own = {other.stem for other in DEFINITIONS}
    for line in lines(path):
        if line == "---" or CONSTANT.fullmatch(line):
            continue
        found = FIELD.fullmatch(line)
        assert found, line
        kind = found.group(1)
        known = kind in own or "/" in kind or kind in ("bool", "string") or re.fullmatch(r"u?int\d+|float\d+", kind)
        assert known, line


def test_the_python_types_are_read_from_the_package() -> None:
    names = {name for name, _ in definitions(None) if name.startswith("skygcs_msgs/")}
    parts = ("Goal", "Result", "Feedback", "SendGoal_Request", "SendGoal_Response", "GetResult_Request")
    actions = {
        f"skygcs_msgs/action/{action}_{part}"
        for action in ("Goto", "Land", "Takeoff")
        for part in (*parts, "GetResult_Response", "FeedbackMessage")
    }
    messages = {f"skygcs_msgs/msg/{path.stem}" for path in DEFINITIONS if path.suffix == ".msg"}
    assert names == actions | messages
    known = ros2_interfaces()
    for name in names:
        assert known.decode(name, known.encode(name, {})) is not None
        assert known.type_hash(name).startswith("RIHS01_")
    for action in ("Goto", "Land", "Takeoff"):
        for part in ("SendGoal", "GetResult"):
            assert known.type_hash(f"skygcs_msgs/action/{action}_{part}").startswith("RIHS01_")


def test_messages_are_those_that_rosbags_reads_from_the_files() -> None:
    """Bytes of ours are read by rosbags from the files alone, without our table."""
    store = get_typestore(Stores.ROS2_JAZZY)
    for path in DEFINITIONS:
        if path.suffix == ".msg":
            store.register(get_types_from_msg((PACKAGE / path).read_text(), f"skygcs_msgs/msg/{path.stem}"))
    fleet = {"vehicles": [{"name": "alpha", "lat_deg": 43.5, "position": {"z": 7.0}, "control": "off"}]}
    read = store.deserialize_cdr(ros2_interfaces().encode("skygcs_msgs/msg/Fleet", fleet), "skygcs_msgs/msg/Fleet")
    (row,) = read.vehicles
    assert (row.name, row.lat_deg, row.position.z, row.control) == ("alpha", 43.5, 7.0, "off")
