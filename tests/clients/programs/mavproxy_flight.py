"""MAVProxy itself at its own console, as its documentation flies it: mavproxy_flight.py CONNECTION px4|ardupilot

Connect, param show and set, wp load, list and save, mode, arm throttle, takeoff, guided, velocity, RTL, LAND. Its
`mode` and `takeoff` are for ArduPilot (see `px4`).
"""

import os
import pty
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

from pymavlink import mavwp
from report import distance_m, moved, saw, until

PROGRAM = Path(sys.executable).with_name("mavproxy.py")
ANSWER_S = 5.0
"""How long an answer is waited for before a line is typed again."""


def soon(condition, within_s):
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.05)
    return None


class Console:
    """What a user types into MAVProxy and reads there, in a terminal of its own."""

    def __init__(self, address):
        terminal, program_side = pty.openpty()
        command = [sys.executable, str(PROGRAM), "--master", address, "--state-basedir", "."]
        environment = {**os.environ, "HOME": os.getcwd(), "TERM": "dumb"}  # no start-up file of this user
        self.program = subprocess.Popen(
            command, stdin=program_side, stdout=program_side, stderr=program_side, env=environment
        )
        os.close(program_side)
        self._terminal = terminal
        self._written = ""
        self._typed_at = 0
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self):
        while True:
            try:
                data = os.read(self._terminal, 65536)
            except OSError:  # the program has ended
                return
            text = data.decode(errors="replace").replace("\r", "")
            sys.stderr.write(text)  # the test shows it if something fails
            self._written += text

    def type(self, line):
        self._typed_at = len(self._written)
        os.write(self._terminal, f"{line}\n".encode())

    def find(self, pattern):
        """Its match in what was written since the last line was typed."""
        return re.search(pattern, self._written[self._typed_at :], re.DOTALL)

    def wait(self, pattern):
        return until(lambda: self.find(pattern), pattern)

    def do(self, line, pattern):
        """Type a line, again and again until the answer is there; frames may be lost and checks take their time."""

        def answered():
            self.type(line)
            return soon(lambda: self.find(pattern), ANSWER_S)

        return until(answered, f"{line}: {pattern}", pause_s=0)

    def fields(self, message, good=lambda values: True, line=None):
        """The numbers of a message as `status` shows it, once they are ``good``; ``line`` is typed each time before."""

        def look():
            if line is not None:
                self.type(line)
            self.type(f"status {message}")
            found = soon(lambda: self.find(rf"{message} \{{([^}}]*)\}}"), ANSWER_S)
            values = (
                {name: float(value) for name, value in re.findall(r"(\w+) : (-?[\d.]+)", found[1])} if found else {}
            )
            return values if values and good(values) else None

        return until(look, f"{message} as wanted", pause_s=0.5)

    def place(self):
        at = self.fields("GLOBAL_POSITION_INT", lambda p: p["lat"])  # 0 until the vehicle knows
        return at["lat"] / 1e7, at["lon"] / 1e7

    def until_at(self, place, height_m, line=None):
        def there(p):
            off = distance_m(place, (p["lat"] / 1e7, p["lon"] / 1e7))
            return off < 2 and abs(p["relative_alt"] / 1e3 - height_m) < 2

        self.fields("GLOBAL_POSITION_INT", there, line)

    def end(self):
        """As a user does: end of file at the prompt."""
        os.write(self._terminal, b"\x04")
        if soon(lambda: self.program.poll() is not None, 30) is None:
            self.program.kill()
            raise SystemExit("MAVProxy did not end at Ctrl-D")


def parameters(console, name, value):
    received = console.wait(r"Received (\d+) parameters")
    before = float(console.do(f"param show {name}", rf"{name}\s+(-?[\d.]+)\s")[1])
    console.type(f"param set {name} {value}")
    after = float(console.do(f"param show {name}", rf"{name}\s+({value:.1f})\s")[1])
    saw("parameters", received=int(received[1]), before=before, after=after)


def mission(console, home, px4):
    """wp load, list and save; what comes back is compared as MAVProxy itself wrote it."""
    legs = [moved(*home, north, east) for north, east in ((12, 0), (12, 12), (0, 12))]
    lines = [] if px4 else [(0, 16, *home, 0.0), (3, 22, 0.0, 0.0, 10.0)]  # (frame, command, ...): home and take-off
    lines += [(3, 16, *leg, 10.0) for leg in legs]
    text = "QGC WPL 110\n" + "".join(
        f"{seq}\t{int(seq == 0)}\t{frame}\t{command}\t0\t0\t0\t0\t{lat:.8f}\t{lon:.8f}\t{height:.3f}\t1\n"
        for seq, (frame, command, lat, lon, height) in enumerate(lines)
    )
    Path("square.txt").write_text(text)
    console.do("wp load square.txt", rf"Sent all {len(lines)} waypoints")
    back = Path("back.txt")

    def saved():
        console.type("wp list")
        listed = soon(lambda: console.find(rf"Saved {len(lines)} waypoints to"), ANSWER_S)
        console.type("wp save back.txt")
        return listed and soon(lambda: console.find(rf"Saved {len(lines)} waypoints to back.txt"), ANSWER_S)

    until(saved, "wp list and wp save", pause_s=0)
    loader = mavwp.MAVWPLoader()
    loader.load(str(back))
    items = [loader.wp(seq) for seq in range(loader.count())]
    skip = 0 if px4 else 1  # item 0 is home, whatever was sent
    off = [distance_m(a[2:4], (b.x, b.y)) for a, b in zip(lines[skip:], items[skip:], strict=True)]
    same = [line[1] for line in lines[skip:]] == [item.command for item in items[skip:]]
    saw("mission", sent=len(lines), back=len(items), same_commands=same, worst_m=max(off))
    return legs[-1]


def arm(console):
    console.do("arm throttle", r"COMPONENT_ARM_DISARM: ACCEPTED.*ARMED|ARMED.*COMPONENT_ARM_DISARM: ACCEPTED")
    saw("armed")


def disarmed(console):
    console.wait(r"DISARMED")
    saw("landed", height_m=console.fields("GLOBAL_POSITION_INT")["relative_alt"] / 1e3)


def copter(console):
    home = console.place()
    end = mission(console, home, px4=False)
    console.do("mode GUIDED", r"Mode GUIDED|GUIDED>")
    arm(console)
    saw("takeoff", answer=console.do("takeoff 10", r"NAV_TAKEOFF: (\w+)")[1])
    console.until_at(home, 10)
    saw("up")
    place = moved(*home, 10, -8)
    console.until_at(place, 12, f"guided {place[0]:.7f} {place[1]:.7f} 12")
    saw("there")
    moving = console.fields("GLOBAL_POSITION_INT", lambda p: abs(p["vx"]) + abs(p["vy"]) > 150, "velocity 2 0 0")
    saw("velocity", north_cmps=moving["vx"], east_cmps=moving["vy"])
    console.do("mode AUTO", r"Mode AUTO|AUTO>")
    console.until_at(end, 10)
    saw("flown", item=console.fields("MISSION_CURRENT")["seq"])
    console.do("mode RTL", r"Mode RTL|RTL>")
    saw("returning")
    console.do("mode LAND", r"Mode LAND|LAND>")
    disarmed(console)


def px4(console):
    """Modes and take-off by `long`: `mode` sends an ArduPilot's numbers ("required argument is not a float"), `takeoff`
    a position of 0/0. `guided` sends a height above home, which a PX4 takes for one above the sea.
    """
    home = console.place()
    end = mission(console, home, px4=True)
    at = console.fields("GLOBAL_POSITION_INT")
    ground_m = (at["alt"] - at["relative_alt"]) / 1e3
    take_off = f"long MAV_CMD_NAV_TAKEOFF nan nan nan nan nan nan {ground_m + 10:.1f}"
    saw("takeoff", answer=console.do(take_off, r"NAV_TAKEOFF: (\w+)")[1])
    arm(console)
    console.until_at(home, 10)
    saw("up")
    place = moved(*home, 10, -8)
    console.until_at(place, 12, f"guided {place[0]:.7f} {place[1]:.7f} {ground_m + 12:.1f}")
    saw("there")
    console.do("long MAV_CMD_DO_SET_MODE 29 4 4", r"Mode MISSION|MISSION>")
    console.until_at(end, 10)
    saw("flown", item=console.fields("MISSION_CURRENT")["seq"])
    console.do("long MAV_CMD_NAV_RETURN_TO_LAUNCH", r"Mode RTL|RTL>")
    saw("returning")
    console.do("long MAV_CMD_NAV_LAND 0 0 0 nan nan nan nan", r"Mode LAND|LAND>")
    disarmed(console)


def main(address, autopilot):
    console = Console(address)
    console.wait(r"Detected vehicle 1:1 on link 0")
    saw("connected")
    if autopilot == "px4":
        parameters(console, "RTL_RETURN_ALT", 24.0)
        px4(console)
    else:
        parameters(console, "RTL_ALT", 1200.0)
        copter(console)
    console.end()
    saw("done")


if __name__ == "__main__":
    main(*sys.argv[1:])
