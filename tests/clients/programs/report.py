"""What a program of this folder saw, as lines of JSON for the test that started it."""

import json
import math
import time


def saw(step, **facts):
    """One line: what happened, and what was seen then."""
    print(json.dumps({"step": step, **facts}), flush=True)


def until(condition, what, timeout_s=120.0, pause_s=0.1):
    """The condition's first true value. The patience is for a slow machine; nothing is measured by it."""
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(pause_s)
    raise SystemExit(f"never happened: {what}")


def moved(lat_deg, lon_deg, north_m, east_m):
    """The place so many metres north and east of this one."""
    return lat_deg + north_m / 111_195.0, lon_deg + east_m / (111_195.0 * math.cos(math.radians(lat_deg)))


def distance_m(a, b):
    """Between two places of a few hundred metres, (latitude, longitude) in degrees."""
    north = (b[0] - a[0]) * 111_195.0
    east = (b[1] - a[1]) * 111_195.0 * math.cos(math.radians(a[0]))
    return math.hypot(north, east)
