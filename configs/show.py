"""Ten vehicles turn once on a circle, in a wave: prints a plan of skygcs. `python configs/show.py > show.json`

Position, velocity and acceleration of the motion are exact every two seconds; polynomials of degree 5 join them.
"""

import json
from math import cos, pi, sin

COUNT, RADIUS_M, HEIGHT_M, WAVE_M, TURN_S, PIECE_S = 10, 12.0, 14.0, 1.5, 80.0, 2.0
MIDDLE_M = (10.0, 20.0)


def angle(t: float) -> tuple[float, float, float]:
    """Turned so far, its rate and its acceleration: from rest to rest."""
    u = t / TURN_S
    return (
        2 * pi * (10 * u**3 - 15 * u**4 + 6 * u**5),
        2 * pi * (30 * u**2 - 60 * u**3 + 30 * u**4) / TURN_S,
        2 * pi * (60 * u - 180 * u**2 + 120 * u**3) / TURN_S**2,
    )


def motion(number: int, t: float) -> list[tuple[float, float, float]]:
    """Position, velocity and acceleration along x, y and up."""
    a, rate, change = angle(t)
    a += 2 * pi * number / COUNT
    x, y, z = RADIUS_M * cos(a), RADIUS_M * sin(a), WAVE_M * sin(2 * a)
    dx, dy, dz = -y, x, 2 * WAVE_M * cos(2 * a)  # by the angle
    return [
        (MIDDLE_M[0] + x, dx * rate, dx * change - x * rate**2),
        (MIDDLE_M[1] + y, dy * rate, dy * change - y * rate**2),
        (HEIGHT_M + z, dz * rate, dz * change - 4 * z * rate**2),
    ]


def joined(begin: tuple[float, float, float], end: tuple[float, float, float]) -> list[float]:
    """Ascending coefficients of the polynomial of degree 5 between two such states."""
    (p, v, a), (q, w, b), t = begin, end, PIECE_S
    d, e, f = q - p - v * t - a * t * t / 2, w - v - a * t, b - a
    return [
        p,
        v,
        a / 2,
        (20 * d - 8 * e * t + f * t * t) / (2 * t**3),
        (-30 * d + 14 * e * t - 2 * f * t * t) / (2 * t**4),
        (12 * d - 6 * e * t + f * t * t) / (2 * t**5),
    ]


def pieces(number: int) -> list[list[object]]:
    times = [PIECE_S * i for i in range(int(TURN_S / PIECE_S))]
    ends = ((motion(number, t), motion(number, t + PIECE_S)) for t in times)
    return [[PIECE_S, *(joined(b, e) for b, e in zip(begin, end, strict=True)), None] for begin, end in ends]


vehicles = {f"v{number + 1}": pieces(number) for number in range(COUNT)}
print(json.dumps({"format": "skygcs-plan", "version": 1, "kind": "timed", "vehicles": vehicles}))
