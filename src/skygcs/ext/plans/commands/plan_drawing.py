"""Pictures of plans: an SVG of the paths from above and from the side, and a page that plays them."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from typing import NamedTuple

from skygcs.core.trajectory import Trajectory

SAMPLES = 240
"""Points of each drawn path; a picture, no certificate."""

SIZE = 720.0
"""Pixels of the view from above, across; the view from the side is as wide."""

MARGIN = 30.0
HUES = 12


class _View(NamedTuple):
    """Metres to pixels."""

    west: float
    north: float
    top: float
    scale: float
    height: float
    side_height: float

    def above(self, x: float, y: float) -> tuple[float, float]:
        return MARGIN + (x - self.west) * self.scale, MARGIN + (self.north - y) * self.scale

    def beside(self, x: float, z: float) -> tuple[float, float]:
        return MARGIN + (x - self.west) * self.scale, self.height + MARGIN + (self.top - z) * self.scale


def draw_svg(trajectories: Mapping[str, Trajectory]) -> str:
    """The paths from above, and below it from the south; a dot where a vehicle starts."""
    paths = _sampled(trajectories)
    view = _view(paths)
    total = view.height + view.side_height
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIZE + 2 * MARGIN:.0f} {total:.0f}" '
        'font-family="sans-serif" font-size="11">',
        f'<rect width="{SIZE + 2 * MARGIN:.0f}" height="{total:.0f}" fill="white"/>',
        f'<text x="{MARGIN:g}" y="16">from above: x to the right, y up, {SIZE / view.scale:.0f} m across</text>',
        f'<text x="{MARGIN:g}" y="{view.height + 16:.0f}">from the side: x to the right, height up</text>',
    ]
    for index, (name, points) in enumerate(paths.items()):
        colour = _colour(index)
        for flat in ([view.above(x, y) for x, y, _ in points], [view.beside(x, z) for x, _, z in points]):
            drawn = " ".join(f"{x:.1f},{y:.1f}" for x, y in flat)
            lines.append(f'<polyline points="{drawn}" fill="none" stroke="{colour}" stroke-width="1.2"/>')
            lines.append(f'<circle cx="{flat[0][0]:.1f}" cy="{flat[0][1]:.1f}" r="3" fill="{colour}"/>')
        x, y = view.above(*points[0][:2])
        lines.append(f'<text x="{x + 5:.1f}" y="{y - 4:.1f}" fill="{colour}">{html.escape(name)}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


def draw_page(trajectories: Mapping[str, Trajectory]) -> str:
    """A page without outside parts: the picture, and dots that follow a slider or the clock."""
    paths = _sampled(trajectories)
    view = _view(paths)
    dots = [
        [[round(v, 1) for v in (*view.above(x, y), *view.beside(x, z))] for x, y, z in points]
        for points in paths.values()
    ]
    duration = max(t.duration_s for t in trajectories.values())
    data = json.dumps({"dots": dots, "colours": [_colour(i) for i in range(len(dots))], "duration": duration})
    return PAGE.replace("@SVG@", draw_svg(trajectories)).replace("@DATA@", data.replace("<", "\\u003c"))


PAGE = """<!doctype html><meta charset="utf-8"><title>plan</title>
<style>body{font-family:sans-serif;max-width:800px;margin:1em auto}input{width:70%}</style>
<button id="play">play</button> <input id="t" type="range" min="0" max="1" step="0.001" value="0"> <span id="s"></span>
<div id="picture">@SVG@</div>
<script>
const plan = @DATA@, svg = document.querySelector("svg"), slider = document.getElementById("t");
const marks = plan.dots.map((_, i) => [0, 2].map(() => {
  const c = document.createElementNS("http://www.w3.org/2000/svg", "circle");
  c.setAttribute("r", 5); c.setAttribute("fill", plan.colours[i]); c.setAttribute("stroke", "black");
  return svg.appendChild(c);
}));
function draw() {
  const u = Number(slider.value);
  plan.dots.forEach((path, i) => {
    const at = u * (path.length - 1), k = Math.min(Math.floor(at), path.length - 2), f = at - k;
    [0, 1].forEach(v => ["cx", "cy"].forEach((name, a) => {
      const n = 2 * v + a;
      marks[i][v].setAttribute(name, path[k][n] + f * (path[k + 1][n] - path[k][n]));
    }));
  });
  document.getElementById("s").textContent = (u * plan.duration).toFixed(1) + " s of " + plan.duration.toFixed(1);
}
let last = null;
function step(now) {
  if (last !== null) slider.value = Math.min(1, Number(slider.value) + (now - last) / 1000 / plan.duration);
  last = now; draw();
  if (Number(slider.value) < 1) requestAnimationFrame(step); else last = null;
}
slider.oninput = draw;
document.getElementById("play").onclick = () => {
  if (Number(slider.value) >= 1) slider.value = 0;
  last = null; requestAnimationFrame(step);
};
draw();
</script>
"""


def _sampled(trajectories: Mapping[str, Trajectory]) -> dict[str, list[tuple[float, float, float]]]:
    duration = max(t.duration_s for t in trajectories.values())
    times = [duration * i / SAMPLES for i in range(SAMPLES + 1)]
    return {name: [t.at(time).pos_enu_m for time in times] for name, t in trajectories.items()}


def _view(paths: Mapping[str, list[tuple[float, float, float]]]) -> _View:
    points = [point for path in paths.values() for point in path]
    low, high = ([pick(p[k] for p in points) for k in range(3)] for pick in (min, max))
    across = max(high[0] - low[0], high[1] - low[1], 1.0)
    scale = SIZE / across
    height = (high[1] - low[1]) * scale + 2 * MARGIN
    return _View(low[0], high[1], high[2], scale, height, (high[2] - low[2]) * scale + 2 * MARGIN)


def _colour(index: int) -> str:
    return f"hsl({360 * (index * 5 % HUES) // HUES}, 70%, {40 + 10 * (index // HUES % 3)}%)"
