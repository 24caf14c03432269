import assert from "node:assert/strict";
import { test } from "node:test";
import { fitted, lengthText, niceLengthM, toScreenX, toScreenY, toWorld, zoomedAt, type Camera } from "../src/view/camera.ts";
import { frameAt, fromGeodetic, placeImage, toGeodetic, turned, yawOf } from "../src/view/frame.ts";
import { leaderOf, placeLabels } from "../src/view/labels.ts";
import { labelLine, meetingsOf, pictureOf, sceneOf } from "../src/view/scene.ts";
import { topOf } from "../src/view/side_view.ts";
import { EMPTY, reduce } from "../src/store.ts";
import { batch, position, vehicle } from "./fleet.ts";

const CAMERA: Camera = { x: 5, y: -3, pxPerM: 7, widthPx: 800, heightPx: 600 };
const ORIGIN = { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 90 };

const ORACLE = [
  [43.79, -79.45, 1231.4748, 1044.5294],
  [43.7706, -79.4753, -805.1458, -1111.0300],
  [43.85, -79.36, 8466.9562, 7716.3207],
] as const;

function near(a: number, b: number, by: number): void {
  assert.ok(Math.abs(a - b) <= by, `${a} is not ${b}`);
}

test("metres and pixels: there and back, y up", () => {
  const { x, y } = toWorld(CAMERA, 123, 456);
  near(toScreenX(CAMERA, x), 123, 1e-9);
  near(toScreenY(CAMERA, y), 456, 1e-9);
  assert.ok(toScreenY(CAMERA, 10) < toScreenY(CAMERA, 0));
});

test("zooming keeps the place under the pointer", () => {
  const before = toWorld(CAMERA, 700, 50);
  for (const factor of [3, 0.2, 1e9, 1e-9]) {
    const after = toWorld(zoomedAt(CAMERA, factor, 700, 50), 700, 50);
    near(after.x, before.x, 1e-6);
    near(after.y, before.y, 1e-6);
  }
});

test("fit shows all of the bounds, and a single vehicle with some metres around it", () => {
  const all = fitted(CAMERA, { left: -100, right: 300, bottom: 0, top: 50 });
  assert.ok(toScreenX(all, -100) > 0 && toScreenX(all, 300) < 800);
  const one = fitted(CAMERA, { left: 4, right: 4, bottom: 4, top: 4 });
  near(toScreenX(one, 4), 400, 1e-9);
  assert.ok(one.pxPerM < 30);
});

test("fit leaves out what buttons cover at the top", () => {
  const [top, bottom] = [50, 0].map((y) => toScreenY(fitted(CAMERA, { left: 0, right: 10, bottom: 0, top: 50 }, 150), y));
  near(top ?? NaN, 150, 1e-9);
  near(bottom ?? NaN, 600 - 64, 1e-9);
});

test("lengths of the scale are 1, 2 or 5", () => {
  for (const pxPerM of [0.03, 0.7, 3, 11, 200]) {
    const length = niceLengthM(pxPerM, 140);
    assert.ok(length * pxPerM <= 140 && length * pxPerM > 50);
    assert.match(length.toExponential(), /^[125]e/);
  }
  assert.deepEqual([lengthText(2000), lengthText(5), lengthText(0.2)], ["2 km", "5 m", "20 cm"]);
});

test("geodetic places as pymap3d computes them", () => {
  const frame = frameAt({ ...ORIGIN, alt_amsl_m: 0 });
  // pymap3d.geodetic2enu(lat, lon, 0, 43.7806, -79.4653, 0)
  for (const [lat, lon, east, north] of ORACLE) {
    const [x, y] = fromGeodetic(frame, lat, lon);
    near(x, east, 1e-3);
    near(y, north, 1e-3);
    const back = toGeodetic(frame, x, y);
    near(back.lat_deg, lat, 1e-9);
    near(back.lon_deg, lon, 1e-9);
  }
});

test("a turned frame: x along its heading, there and back", () => {
  const [x, y] = turned(0, 10, 0); // x points north
  near(x, 10, 1e-9);
  near(y, 0, 1e-9);
  const frame = frameAt({ ...ORIGIN, x_heading_deg: 37 });
  const { lat_deg, lon_deg } = toGeodetic(frame, 120, -45);
  const [bx, by] = fromGeodetic(frame, lat_deg, lon_deg);
  near(bx, 120, 1e-6);
  near(by, -45, 1e-6);
});

test("the nose is the frame's yaw, else the compass heading", () => {
  const frame = frameAt(ORIGIN);
  near(yawOf(frame, vehicle("a", 1)) ?? NaN, Math.PI / 2, 1e-9); // 90 degrees from x: north
  const without = vehicle("a", 1, { position: position(0, 0, 0, { yaw_world_deg: null, heading_deg: 90 }) });
  near(yawOf(frame, without) ?? NaN, 0, 1e-9); // to the east is along x
  assert.equal(yawOf(frame, vehicle("a", 1, { position: null })), null);
});

test("a map lies where its two points pin it, turned and scaled", () => {
  const frame = frameAt(ORIGIN);
  const pin = (x_px: number, y_px: number, x: number, y: number) => ({ x_px, y_px, ...toGeodetic(frame, x, y) });
  const at = placeImage(frame, [pin(10, 20, 0, 0), pin(110, 20, 0, 50)]); // the image's right is north, half a metre a pixel
  assert.ok(at);
  const place = (u: number, v: number): [number, number] => [at.a * u + at.c * v + at.e, at.b * u + at.d * v + at.f];
  near(place(110, 20)[0], 0, 1e-3);
  near(place(110, 20)[1], 50, 1e-3);
  near(place(10, 120)[0], 50, 1e-2); // its down is then east
  near(place(10, 120)[1], 0, 1e-2);
  assert.equal(placeImage(frame, [pin(1, 1, 0, 0), pin(1, 1, 9, 9)]), null);
});

test("labels cover neither each other nor a vehicle nor the edge, and stay where they were", () => {
  const requests = Array.from({ length: 60 }, (_, i) => ({ id: `v${i}`, xPx: 100 + (i % 10) * 45, yPx: 100 + Math.floor(i / 10) * 45, widthPx: 90, nameWidthPx: 30, reachPx: 7, urgent: i === 0 }));
  const placed = placeLabels(requests, new Map(), 800, 600);
  assert.ok(placed.size > 40, `${placed.size}`);
  assert.ok(placed.has("v0"), "the first is the most important one");
  const boxes = [...placed].map(([id, at]) => {
    const request = requests.find((one) => one.id === id);
    assert.ok(request);
    const left = request.xPx + at.dx;
    const top = request.yPx + at.dy;
    return { left, top, right: left + (at.full ? 90 : 30), bottom: top + (at.full ? 32 : 17) };
  });
  for (const [i, a] of boxes.entries()) {
    assert.ok(a.left >= 0 && a.top >= 0 && a.right <= 800 && a.bottom <= 600);
    for (const b of boxes.slice(i + 1)) assert.ok(a.right <= b.left || b.right <= a.left || a.bottom <= b.top || b.bottom <= a.top);
    for (const { xPx, yPx } of requests) assert.ok(xPx < a.left || xPx > a.right || yPx < a.top || yPx > a.bottom);
  }
  assert.deepEqual(placeLabels(requests, placed, 800, 600), placed);
  const { dx, dy } = placed.get("v0") ?? { dx: 0, dy: 0 };
  const covered = { left: 100 + dx - 5, top: 100 + dy - 5, right: 100 + dx + 5, bottom: 100 + dy + 40 };
  assert.notDeepEqual(placeLabels(requests, placed, 800, 600, [covered]).get("v0"), { dx, dy, full: true, led: false });
});

test("in a crowd labels are names, and those without room beside their vehicle are led by a line", () => {
  const at = (i: number, xPx: number, yPx: number) => ({ id: `v${i}`, xPx, yPx, widthPx: 90, nameWidthPx: 26, reachPx: 7, urgent: i === 3 });
  const crowd = Array.from({ length: 16 }, (_, i) => at(i, 400 + (i % 4) * 18, 300 + Math.floor(i / 4) * 18));
  const alone = at(20, 100, 100);
  const placed = placeLabels([...crowd.filter(({ urgent }) => urgent), ...crowd.filter(({ urgent }) => !urgent), alone], new Map(), 800, 600);
  const [full, led] = [[...placed].filter(([, { full }]) => full), [...placed].filter(([, { led }]) => led)];
  assert.deepEqual(full.map(([id]) => id).sort(), ["v20", "v3"], "the one that needs a person, and the one that is alone");
  assert.ok(led.length >= 4, `${led.length}`);
  assert.equal(placed.size, 17, "each has one");
  for (const [id, place] of led) {
    const { from, to } = leaderOf(place, 26, 7);
    near(Math.hypot(...from), 7, 1e-9);
    assert.ok(Math.hypot(...to) > 8 && Math.hypot(...to) < 110, id);
    assert.ok(to[0] >= place.dx && to[0] <= place.dx + 26 && to[1] >= place.dy && to[1] <= place.dy + 17);
  }
  // the crowd flies apart: the lines go, and the second lines come
  const apart = crowd.map((one, i) => ({ ...one, xPx: 60 + (i % 4) * 190, yPx: 60 + Math.floor(i / 4) * 120 }));
  const after = placeLabels(apart, placed, 800, 600);
  assert.ok([...after.values()].every(({ full, led }) => full && !led));
});

test("a label in a crowd keeps its second line until there is one more", () => {
  const around = (n: number) => Array.from({ length: n }, (_, i) => ({ id: `n${i}`, xPx: 400 + 70 * Math.cos(i), yPx: 300 + 70 * Math.sin(i), widthPx: 20, nameWidthPx: 10, reachPx: 4, urgent: false }));
  const one = { id: "v", xPx: 400, yPx: 300, widthPx: 40, nameWidthPx: 20, reachPx: 7, urgent: false };
  const full = (n: number, before: ReturnType<typeof placeLabels>) => placeLabels([one, ...around(n)], before, 800, 600).get("v")?.full;
  const whole = placeLabels([one], new Map(), 800, 600);
  assert.deepEqual([full(3, new Map()), full(4, new Map()), full(4, whole), full(5, whole)], [true, false, true, false]);
});

function scene(vehicles: ReturnType<typeof vehicle>[], nowMs = 0, carry = true) {
  const state = reduce(EMPTY, { type: "batch", batch: batch(vehicles), atMs: 0 });
  return { state, scene: sceneOf(state, frameAt(ORIGIN), nowMs, carry) };
}

test("a moving vehicle is carried on between two reports, not through a silence", () => {
  const moving = vehicle("a", 1, { position: position(0, 0, 10, { vel_world_mps: [10, 0, 0], age_s: 0 }) });
  near(scene([moving], 200).scene.bodies[0]?.x ?? NaN, 2, 1e-9);
  near(scene([moving], 4_000).scene.bodies[0]?.x ?? NaN, 5, 1e-9);
  assert.equal(scene([moving], 200, false).scene.bodies[0]?.x, 0);
  const silent = scene([moving], 60_000).scene;
  assert.equal(silent.bodies[0]?.heard, false);
  assert.equal(silent.bodies[0].x, 0);
  assert.equal(silent.acrossMps, 0);
});

test("vehicles that move with their reports only are known as such", () => {
  const known = vehicle("a", 1, { position: position(0, 0, 10, { age_s: 0 }) });
  const unknown = vehicle("b", 2, { position: position(0, 0, 10, { vel_world_mps: null, vel_enu_mps: null }) });
  assert.equal(scene([known]).scene.jumps, false);
  assert.equal(scene([known], 0, false).scene.jumps, true);
  assert.equal(scene([known, unknown]).scene.jumps, true);
  assert.equal(scene([known, unknown], 60_000).scene.jumps, false);
});

test("the label of a vehicle that is not heard says so instead of its last height", () => {
  const { state, scene: seen } = scene([vehicle("a", 1)], 12_000);
  const [body] = seen.bodies;
  assert.ok(body);
  assert.equal(state.names.length, 1);
  assert.equal(labelLine(body), "lost at 10.0 m, 12 s");
  assert.ok(body.lostInAir && body.trouble?.severity === "danger", "and it is not shown as one that does not matter");
  const [standing] = scene([vehicle("a", 1, { landed: "on_ground" })], 12_000).scene.bodies;
  assert.ok(standing !== undefined && !standing.lostInAir);
  assert.equal(labelLine(standing), "not heard, 12 s");
});

test("the label of a vehicle in danger says it, and that of one in none its height and speed", () => {
  const line = (more: object) => {
    const [body] = scene([vehicle("a", 1, more)]).scene.bodies;
    return body === undefined ? null : labelLine(body);
  };
  assert.equal(line({ failsafe: true }), "failsafe");
  assert.equal(line({}), "10.0 m  0.0 m/s");
});

test("a conflict is one for its two vehicles, and may have lost its numbers", () => {
  const conflict = { level: "warning" as const, closest_m: 1, closest_in_s: 2, margin_m: 2.5 };
  const a = vehicle("a", 1, { separation: { ...conflict, with: "b" }, position: position(0, 0, 10, { vel_world_mps: [1, 0, 0] }) });
  const b = vehicle("b", 2, { separation: { level: "warning", with: "a" }, position: position(10, 0, 10) });
  const meetings = meetingsOf(scene([a, b], 0, false).scene, frameAt(ORIGIN));
  assert.equal(meetings.length, 1);
  assert.equal(meetings[0]?.x, 6);
});

test("all that a person can see of a fleet that stands makes its picture another one, and less than a pixel does not", () => {
  const text = (more: object = {}, nowMs = 0) => pictureOf(scene([vehicle("a", 1, more)], nowMs).scene, 8);
  const at = (x: number, more: object = {}) => ({ position: position(x, 0, 10, more) });
  const before = text();
  assert.equal(text({ ...at(0.01, { yaw_world_deg: 90.1, vel_world_mps: [0.01, 0, 0] }), uptime_s: 7 }), before);
  const others = [at(0.1), at(0, { yaw_world_deg: 92 }), at(0, { alt_rel_m: 10.2 }), { armed: false }, { failsafe: true }].map((more) => text(more));
  const seen = [before, ...others, text({}, 6_000), text({}, 12_000)];
  assert.equal(new Set(seen).size, seen.length);
  assert.equal(text(at(0, { vel_world_mps: [2, 0, 0] })), null);
  assert.equal(text({ separation: { level: "warning", with: "b" } }), null);
});

test("the side view does not breathe with each climb", () => {
  const at = (z: number) => scene([vehicle("a", 1, { position: position(0, 0, z) })]).scene.bodies;
  const top = topOf(at(20), [], 0);
  assert.equal(topOf(at(19), [], top), top);
  assert.equal(topOf(at(15), [], top), top);
  assert.ok(topOf(at(40), [], top) > top);
  assert.ok(topOf(at(1), [], 100) < 100);
});

test("the side view has room for what is planned and for where vehicles are sent", () => {
  const plan = { shapes: [{ kind: "path" as const, points: [[0, 0, 5], [0, 0, 60]] as const, ink: "plan" as const }, { kind: "mark" as const, at: [0, 0, 80] as const, symbol: "goal" as const, ink: "goal" as const }] };
  assert.ok(topOf([], [plan], 0) > 80);
  assert.ok(topOf([{ z: 3, goal: [0, 0, 50] }], [], 0) > 50);
});
