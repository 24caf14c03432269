"""Programs that play the autopilot binaries of `skygcs sitl`: they take the same options and say of themselves what a
ready vehicle says, with pymavlink. The fake PX4 runs a startup script in /bin/sh that looks for its parts as PX4's
does."""

from __future__ import annotations

import sys
from pathlib import Path

COPTER = """#!{python}
import os, sys, time
os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil
options = dict(zip(sys.argv[1::2], sys.argv[2::2]))
print("started", " ".join(sys.argv[1:]), flush=True)
if os.environ.get("FAKE_COPTER") == "dies":
    print("panic: no frame", flush=True)
    sys.exit(3)
links = []
for serial in ("--serial0", "--serial1"):
    link = mavutil.mavlink_connection("udpout:" + options[serial].split(":", 1)[1],
        source_system=int(options["--sysid"]), source_component=1, dialect="ardupilotmega")
    links.append(link.mav)
for turn in range(100000):
    for mav in links:
        mav.heartbeat_send(2, 3, 81, 0, 3)
        mav.sys_status_send(1 << 28, 1 << 28, 1 << 28, 0, 16000, 100, 90, 0, 0, 0, 0, 0, 0)
        mav.global_position_int_send(turn * 100, 437806000, -794653000, 180000, 0, 0, 0, 0, 0)
        if turn > 2 and os.environ.get("FAKE_COPTER") != "no estimator":
            mav.ekf_status_report_send(831, 0, 0, 0, 0, 0)
    time.sleep(0.1)
"""

PX4 = """#!{python}
import os, subprocess, sys, time
os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil
number, folder, etc = sys.argv[2], sys.argv[5], sys.argv[6]
assert sys.argv[1::2][:2] == ["-i", "-d"] and sys.argv[4] == "-w", sys.argv
os.chdir(folder)
if not os.path.islink("etc"):
    os.symlink(etc, "etc")
os.environ["PATH"] = os.path.dirname(os.path.abspath(sys.argv[0])) + ":" + os.environ["PATH"]
code = subprocess.run(["/bin/sh", "etc/init.d-posix/rcS", number]).returncode
if code:
    sys.exit(code)
calls = [line.split() for line in open("calls")]
sysid = [int(c[3]) for c in calls if c[:3] == ["param", "set", "MAV_SYS_ID"]][-1]
links = []
for call in calls:
    if call[:2] == ["mavlink", "start"]:
        source, target = call[call.index("-u") + 1], call[call.index("-o") + 1]
        link = mavutil.mavudp("127.0.0.1:" + target, input=False, source_system=sysid, source_component=1)
        link.port.bind(("127.0.0.1", int(source)))
        links.append(link.mav)
for turn in range(100000):
    for mav in links:
        mav.heartbeat_send(2, 12, 81, 0, 3)
        mav.sys_status_send(1 << 28, 1 << 28, 1 << 28, 0, 16000, 100, 90, 0, 0, 0, 0, 0, 0)
        mav.global_position_int_send(turn * 100, 437806000, -794653000, 180000, 0, 0, 0, 0, 0)
        mav.estimator_status_send(0, 1023, 0, 0, 0, 0, 0, 0, 0, 0)
    time.sleep(0.1)
"""

RCS = """#!/bin/sh
set +e
px4_instance=$1
param() { echo "param $*" >> calls; [ "$2" = NO_SUCH ] && echo "ERROR [param] Parameter NO_SUCH not found."; return 0; }
mavlink() { echo "mavlink $*" >> calls; }
PATH="$PATH:${R}etc/init.d-posix"
param set MAV_SYS_ID $((px4_instance+1))
. px4-rc.simulator
echo "commander start" >> calls
. px4-rc.mavlink
"""
"""The order and the ways of searching of PX4's own rcS; its parts `px4-rc.…` are `STOCK`."""

STOCK = {
    "px4-rc.simulator": '[ -n "$PX4_HOME_LAT" ] && echo "home $PX4_HOME_LAT $PX4_HOME_LON $PX4_HOME_ALT" >> calls\n',
    "px4-rc.mavlink": "mavlink start -x -u $((18570+px4_instance)) -r 4000000 -f\n",
}


def _write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(0o755)
    return path


def make_copter(folder: Path) -> Path:
    """A built ArduPilot tree below the folder; its binary."""
    _write(folder / "Tools/autotest/default_params/copter.parm", "FRAME_CLASS 1\n")
    return _write(folder / "build/sitl/bin/arducopter", COPTER.format(python=sys.executable))


def make_px4(folder: Path) -> Path:
    """A PX4 build or installation: the folder with bin and etc."""
    _write(folder / "bin/px4", PX4.format(python=sys.executable))
    _write(folder / "etc/init.d-posix/rcS", RCS)
    for name, text in STOCK.items():
        _write(folder / "etc/init.d-posix" / name, "#!/bin/sh\n" + text)
    return folder
