import assert from "node:assert/strict";
import { mock, test } from "node:test";
import { Store } from "../src/store.ts";
import { FleetView } from "../src/view/fleet_view.ts";
import type { Tool } from "../src/view/overlays.ts";
import { batch, position, vehicle } from "./fleet.ts";

/** What a page has of a browser, as far as the view asks for it. Frames come when the test says, and drawing takes as long. */
class Browser {
  nowMs = 0;
  /** What a picture drawn on the canvas costs. */
  drawMs = 0;
  size = { width: 800, height: 600 };
  /** Canvases without an element, which labels and sprites are drawn on. */
  offscreen = 0;
  /** How often the layer of trails was. */
  cleared = 0;
  visibilityState = "visible";
  /** Drawn with any pen. */
  pictures = 0;
  private frames: (() => void)[] = [];
  private resized: () => void = () => undefined;
  private readonly listeners = new Map<string, () => void>();
  readonly canvas = this.element();
  readonly ground = this.element();

  constructor() {
    const counted = (): void => { this.offscreen += 1; };
    const pen = (canvas: object): object => this.pen(canvas);
    const observing = (resized: () => void): void => { this.resized = resized; };
    const nowMs = (): number => this.nowMs;
    const visibility = (): string => this.visibilityState;
    class Offscreen {
      constructor() { counted(); }
      getContext(): object { return pen(this); }
      transferToImageBitmap(): object { return { close: () => undefined }; }
    }
    const listen = (kind: string, run: () => void): void => void this.listeners.set(kind, run);
    const globals = {
      OffscreenCanvas: Offscreen,
      ResizeObserver: class {
        constructor(resized: () => void) { observing(resized); }
        observe(): void { /* the first call comes with a frame */ }
        disconnect(): void { /* nothing is observed */ }
      },
      document: {
        createElement: () => this.element(),
        fonts: { ready: Promise.resolve() },
        timeline: { get currentTime() { return nowMs(); } },
        get visibilityState() { return visibility(); },
        addEventListener: listen,
        removeEventListener: () => undefined,
      },
      matchMedia: (query: string) => ({
        matches: false,
        addEventListener: (_kind: string, run: () => void) => listen(query, run),
        removeEventListener: () => void this.listeners.delete(query),
      }),
      devicePixelRatio: 1,
      getComputedStyle: () => ({ getPropertyValue: () => "#888888", fontFamily: "sans-serif" }),
      requestAnimationFrame: (run: () => void) => this.frames.push(run),
      Path2D: class { moveTo(): void { /* not drawn */ } lineTo(): void { /* not drawn */ } closePath(): void { /* not drawn */ } },
    };
    for (const [name, value] of Object.entries(globals)) Object.defineProperty(globalThis, name, { value, configurable: true, writable: true });
    Object.defineProperty(performance, "now", { value: () => this.nowMs, configurable: true });
  }

  private element(): HTMLCanvasElement {
    const element = {
      width: 0,
      height: 0,
      style: {},
      getBoundingClientRect: () => this.size,
      getContext: () => this.pen(element),
      addEventListener: (kind: string, run: () => void) => void this.listeners.set(kind, run),
      removeEventListener: () => undefined,
    };
    return element as never;
  }

  private pen(canvas: object): object {
    return new Proxy<Record<string | symbol, unknown>>({ canvas }, {
      get: (own, name) => {
        if (name in own) return own[name];
        if (name === "measureText") return () => ({ width: 20 });
        if (name === "clearRect") return () => { this.cleared += canvas === this.canvas ? 0 : 1; };
        if (name === "drawImage") return () => { this.nowMs += this.drawMs; this.pictures += 1; };
        return () => undefined;
      },
    });
  }

  /** The next frame of the screen. */
  frame(): void {
    this.nowMs += 17;
    const due = this.frames;
    this.frames = [];
    for (const run of due) run();
  }

  say(kind: string): void {
    this.listeners.get(kind)?.();
  }

  resize(width: number, height: number): void {
    this.size = { width, height };
    this.resized();
  }
}

function shown(): { browser: Browser; store: Store; view: FleetView; fly: (...at: [number, number][]) => void } {
  const browser = new Browser();
  const store = new Store();
  store.dispatch({ type: "origin", origin: { lat_deg: 43.7806, lon_deg: -79.4653, alt_amsl_m: 180, x_heading_deg: 90 }, generation: 1 });
  const view = new FleetView(store);
  let seq = 0;
  const fly = (...at: [number, number][]): void => {
    seq += 1;
    const vehicles = at.map(([x, y], i) => vehicle(`v${i + 1}`, i + 1, { position: position(x, y, 10) }));
    store.dispatch({ type: "batch", batch: batch(vehicles, { seq, full: seq === 1 }), atMs: browser.nowMs });
    browser.frame();
    browser.frame();
  };
  return { browser, store, view, fly };
}

test("on a screen of other pixels the canvas gets them, as often as the page is moved, and not after it is left", () => {
  const { browser, view, fly } = shown();
  const leave = view.attach(browser.canvas, browser.ground);
  fly([0, 0]);
  for (const [from, to] of [[1, 2], [2, 1.5], [1.5, 1]] as const) {
    devicePixelRatio = to;
    browser.say(`(resolution: ${from}dppx)`);
    assert.equal(browser.canvas.width, 800 * to);
  }
  leave();
  devicePixelRatio = 2;
  browser.say("(resolution: 1dppx)");
  assert.equal(browser.canvas.width, 800);
});

const TOOL: Tool = { cursor: "crosshair", hint: "Click points" };

test("a tool that is taken before the view has a size does not keep it from being fitted", () => {
  const { browser, view, fly } = shown();
  browser.size = { width: 0, height: 0 };
  view.attach(browser.canvas, browser.ground);
  fly([100, 40], [120, 60]);
  view.setTool(TOOL);
  browser.resize(400, 600);
  browser.frame();
  assert.equal(view.figures.faults, 0);
  assert.deepEqual([view.camera.x, view.camera.y], [110, 50]);
  // and then the tool holds it
  browser.resize(400, 300);
  fly([100, 40], [500, 60], [900, 60]);
  assert.deepEqual([view.camera.x, view.camera.y], [110, 50]);
});

test("a tool that is taken before the first vehicle has a place does not keep the view from being fitted", () => {
  const { browser, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  browser.frame();
  view.setTool(TOOL);
  view.setTool(null);
  fly([100, 40], [120, 60]);
  assert.deepEqual([view.camera.x, view.camera.y], [110, 50]);
  view.pan(80, 0);
  const { x } = view.camera;
  browser.resize(700, 500);
  fly([100, 40], [120, 60], [900, 60]);
  assert.equal(view.camera.x, x);
});

test("pictures that went with the canvas' context, or while nobody saw the page, are made anew", () => {
  const { browser, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  fly([100, 40]);
  const settled = (): number => {
    fly([100, 40]);
    const before = browser.offscreen;
    fly([100, 40]);
    assert.equal(browser.offscreen, before);
    return before;
  };
  for (const kind of ["contextrestored", "visibilitychange"]) {
    const before = settled();
    browser.say(kind);
    browser.frame();
    assert.ok(browser.offscreen >= before + 2, kind); // labels, and one sheet of sprites at least
  }
  const before = settled();
  browser.visibilityState = "hidden";
  browser.say("visibilitychange");
  browser.frame();
  assert.equal(browser.offscreen, before);
  assert.equal(view.figures.faults, 0);
});

test("trails are drawn anew with the next frame after everything was sent anew", () => {
  const { browser, store, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  for (let i = 0; i < 40; i++) fly([100 + i, 40]);
  view.pan(1, 0);
  for (let i = 0; i < 40; i++) fly([140 + i, 40]);
  const before = browser.cleared;
  fly([181, 40]);
  assert.equal(browser.cleared, before);
  browser.nowMs += 300; // the state is drawn in the frame in which it comes
  store.dispatch({ type: "batch", batch: batch([vehicle("v1", 1, { position: position(190, 40, 10) })], { seq: 100 }), atMs: browser.nowMs });
  browser.frame();
  assert.equal(browser.cleared, before + 1);
});

test("a canvas that changed its size is not shown empty", () => {
  const { browser, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  fly([100, 40]);
  const before = view.figures.frames;
  browser.resize(700, 500);
  assert.equal(view.figures.frames, before + 1);
});

test("after a frame that took long as much time is left to the page before the next state is drawn", () => {
  const { browser, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  for (let i = 0; i < 5; i++) fly([100, 40]);
  browser.drawMs = 100;
  browser.nowMs += 1000;
  fly([100, 40]);
  browser.drawMs = 0;
  const { frames, lastMs } = view.figures;
  assert.ok(lastMs > 200);
  browser.nowMs += 0.5 * lastMs;
  fly([100, 40]);
  assert.equal(view.figures.frames, frames);
  browser.nowMs += lastMs;
  fly([101, 40]);
  assert.equal(view.figures.frames, frames + 1);
});

test("a state that comes soon before one is due is drawn in its frame, and an earlier one makes none of its own", () => {
  const { browser, store, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  for (let i = 0; i < 5; i++) fly([100, 40]);
  browser.nowMs += 1000;
  fly([100, 40]);
  const { frames } = view.figures;
  const drawnAfter = (ms: number): number => {
    browser.nowMs += ms;
    store.dispatch({ type: "batch", batch: batch([vehicle("v1", 1, { position: position(100 + ms, 40, 10) })], { seq: 100 }), atMs: browser.nowMs });
    browser.frame();
    return view.figures.frames - frames;
  };
  assert.equal(drawnAfter(20), 0);
  assert.equal(drawnAfter(119), 1); // 190 ms after the one before, of 200
});

test("vehicles that stand are drawn once a second, and what a state changes with that state", () => {
  const { browser, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  const framesIn = (states: number, ...at: [number, number][]): number => {
    const { frames } = view.figures;
    for (let i = 0; i < states; i++) {
      browser.nowMs += 66; // a state each 100 ms
      fly(...at);
    }
    return view.figures.frames - frames;
  };
  framesIn(20, [100, 40], [120, 60]);
  assert.ok(framesIn(40, [100, 40], [120, 60]) <= 4);
  assert.ok(framesIn(2, [100.5, 40], [120, 60]) > 0);
  assert.ok(framesIn(20, [100.5, 40], [120, 60]) < 10); // a second of settling
  view.setOverlay("drawn", { shapes: [] });
  const { frames } = view.figures;
  browser.frame();
  assert.equal(view.figures.frames, frames + 1);
});

test("a shape that cannot be drawn stops neither the vehicles above it nor the next frame", () => {
  const { browser, view, fly } = shown();
  view.attach(browser.canvas, browser.ground);
  const said = mock.method(console, "error", () => undefined);
  const broken = { get shapes(): never { throw new Error("a shape"); } };
  fly([100, 40]);
  view.options = { ...view.options, side: false };
  view.setOverlay("broken", broken);
  for (const faults of [1, 2]) {
    const before = browser.pictures;
    browser.frame();
    view.redraw();
    assert.equal(view.figures.faults, faults);
    assert.ok(browser.pictures > before);
  }
  assert.equal(said.mock.callCount(), 1);
  said.mock.restore();
});
