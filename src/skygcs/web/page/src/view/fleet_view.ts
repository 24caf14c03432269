// The fleet view: vehicles on one canvas above another of what lies beneath them, drawn when something changed and only then. Pan, zoom,
// fit, follow, and the tools of panels.

import { Changes } from "../hooks.ts";
import { frameIsKnown, frameKey } from "../framed.ts";
import { recall, remember, onTheme } from "../theme.ts";
import type { State, Store } from "../store.ts";
import { Backdrop, BACKDROP_EVERY_MS } from "./backdrop.ts";
import { extended, fitted, panned, sameCamera, toScreenX, toScreenY, toWorld, zoomedAt, type Bounds, type Camera } from "./camera.ts";
import * as draw from "./drawing.ts";
import { arrowAt, edgeArrows, type Arrow } from "./edge_arrows.ts";
import { frameAt, fromGeodetic, toGeodetic, type Frame } from "./frame.ts";
import { LabelSprites, LABEL_HEIGHT_PX, LABEL_WIDTH_PX, placeLabels, widthOf, type Box, type LabelTone, type Placement } from "./labels.ts";
import { MapLayer } from "./map_layer.ts";
import type { Overlay, PointerAt, Tool } from "./overlays.ts";
import { readPalette, type Palette } from "./palette.ts";
import { Sprites, type Pen } from "./sprites.ts";
import { labelLine, meetingsOf, pictureOf, sceneOf, type Body, type Scene } from "./scene.ts";
import { drawSideBodies, drawSideGround, sidePxOf, sideScale, topOf, type SideScale } from "./side_view.ts";

const START: Camera = { x: 0, y: 0, pxPerM: 8, widthPx: 0, heightPx: 0 };
/** The canvas is never finer than that: twice the pixels cost four times the time, and nobody sees the difference. */
const MOST_RATIO = 2;
const HIT_PX = 18;
/** Between the buttons and a vehicle that is fitted into the view: its ring has a radius of 19. */
const BELOW_BUTTONS_PX = 24;
const LABELS_EVERY_MS = 150;
/** While the view moves trails are drawn anew as often as the backdrop, or when that took long, in a tenth of the time. */
const TRAILS_SHARE = 10;
/** What has fallen out of the trails' bounds goes away with the next full drawing. */
const TRAILS_ANEW_MS = 10_000;
/** A frame that takes longer to draw is followed by a pause of as long, so that the page stays quick to answer. */
const SLOW_DRAW_MS = 10;
/** A vehicle is shown as silent though nothing comes any more, of it or of others. */
const AGES_EVERY_MS = 1000;
/** A pause shorter than a frame of the screen is left out. */
const SCREEN_FRAME_MS = 17;
/** Motion looks smooth in steps of so many pixels of the screen. */
const STEP_PX = 1.25;
/** What takes longer for a step is drawn with the states, ten a second: the browser makes a frame for the table then. */
const WITH_STATES_MS = 80;
/** Should no state come. */
const NO_STATE_MS = 170;
/** A state is drawn when what moves has made most of a step since the last frame, and at the latest after so long. */
const MOST_OF_STEP = 0.7;
const STATE_WITHIN_MS = 200;
/** Of vehicles that move with the states alone each state is drawn. */
const EACH_STATE_MS = 100;
/** A picture that stays the same is drawn so often only: a fleet that waits on the ground for hours, on a laptop's battery, cost as
 *  much as one in flight. So long after a change each frame is drawn, until labels and trails have settled. */
const SAME_PICTURE_MS = 1000;
/** A state that comes before one is due is drawn with the next one, which makes a frame for the table in any case, or after so long. */
const NEXT_STATE_MS = 130;

/** More vehicles at once are dots, and have no label but those that need a person. */
const MANY_SHOWN = 200;
const MOST_URGENT = 60;

export interface ViewOptions {
  side: boolean;
  labels: boolean;
  trails: boolean;
  map: boolean;
}

export interface DrawFigures {
  frames: number;
  lastMs: number;
  longestMs: number;
  /** Frames that could not be drawn to their end. */
  faults: number;
}

/** What is drawn in one frame, and in which colours. */
interface Look {
  nowMs: number;
  palette: Palette;
  shown: readonly Body[];
  /** They are so many that they are dots. */
  afar: boolean;
  side: SideScale | null;
  colourOf: (body: Body) => string;
  colours: draw.Colours;
}

export class FleetView extends Changes {
  /** Of the part above the side view. */
  camera: Camera = START;
  follow = false;
  /** Null while it is not known: what is known by degrees alone has no place then. */
  frame: Frame | null = null;
  private lastFrame: Frame | null = null;
  options: ViewOptions = { side: true, labels: true, trails: true, map: true, ...recalledOptions() };
  readonly figures: DrawFigures = { frames: 0, lastMs: 0, longestMs: 0, faults: 0 };
  tool: Tool | null = null;
  /** What lies on the canvas: buttons. */
  buttons: () => readonly Box[] = () => [];
  private canvas: HTMLCanvasElement | null = null;
  private pen: CanvasRenderingContext2D | null = null;
  /** Of the canvas beneath. */
  private ground: CanvasRenderingContext2D | null = null;
  private palette: Palette | null = null;
  private ratio = 1;
  /** Of the whole canvas. */
  private heightPx = 0;
  private scene: Scene = { bodies: [], acrossMps: 0, upMps: 0, jumps: false };
  private arrows: readonly Arrow[] = [];
  private requested = false;
  /** More than states asks for the next frame: it is drawn though it shows the same vehicles. */
  private wanted = true;
  private picture: { text: string | null; sinceMs: number; drawnMs: number } = { text: null, sinceMs: 0, drawnMs: 0 };
  /** The frame of the screen that was drawn last: none is drawn twice. */
  private frameDrawn: number | null = null;
  /** A frame that is drawn later unless another one comes first. */
  private later: ReturnType<typeof setTimeout> | undefined;
  private laterAtMs = Infinity;
  /** From then on a state is drawn in the frame in which it comes. */
  private stateDueMs = 0;
  /** Vehicles that the view was fitted to; it is fitted anew with each further one until a person moves it or draws on it. */
  private fittedTo = 0;
  private moved = false;
  /** The view was fitted to vehicles once. Before that nothing can hold it: it shows where none are, or has no size yet. */
  private fitted = false;
  /** Of the store's vehicles, as they were when the view was drawn last. */
  private generation = -1;
  private names: readonly string[] = [];
  private sideTopM = 0;
  private readonly overlays = new Map<string, Overlay>();
  private readonly labels = new LabelSprites();
  private readonly sprites = new Sprites();
  private placements = new Map<string, Placement>();
  private placedMs = 0;
  private readonly backdrop = new Backdrop();
  private readonly trailLayer: HTMLCanvasElement = document.createElement("canvas");
  private trailsDrawn: { camera: Camera; ms: number; tookMs: number } | null = null;
  private readonly map = new MapLayer(() => this.repaint());
  private readonly stillMotion = matchMedia("(prefers-reduced-motion: reduce)");

  constructor(readonly store: Store) {
    super();
    store.subscribe((state, inFrame) => {
      this.onState(state);
      // the answer to a key or a click does not wait for the canvas, and no frame of the screen is drawn twice
      if (!inFrame) this.redraw();
      else if (this.frameDrawn === screenFrame()) this.requestFrame();
      else if (this.canvas !== null && !this.requested) this.drawState();
    });
    onTheme(() => this.forgetPictures());
    void document.fonts.ready.then(() => this.forgetPictures());
  }

  // --- what panels and buttons use

  /** Shows shapes under this name, in place of those before; null: none. */
  setOverlay(id: string, overlay: Overlay | null): void {
    if (overlay === null) this.overlays.delete(id);
    else this.overlays.set(id, overlay);
    this.repaint();
  }

  /** Gives the pointer to a tool; the tool before it is cancelled. The view stays then where the person sees it: what is drawn
   *  makes a panel higher, and the canvas smaller, and would be fitted with each click. */
  setTool(tool: Tool | null): void {
    const before = this.tool;
    this.tool = tool;
    if (tool !== null && this.fitted) this.moved = true;
    if (before !== null && before !== tool) before.cancel?.();
    if (this.canvas !== null) this.canvas.style.cursor = tool?.cursor ?? "grab";
    this.changed();
  }

  setOptions(options: Partial<ViewOptions>): void {
    this.options = { ...this.options, ...options };
    remember("skygcs.view", JSON.stringify(this.options));
    this.resize();
    this.changed();
  }

  setFollow(on: boolean): void {
    this.follow = on;
    this.changed();
  }

  /** Everything into view: the selected vehicles, or all vehicles, where they are sent, and overlays. */
  fit(what: "all" | "selected" = "all"): void {
    const bounds = this.boundsOf(what);
    const topPx = Math.max(0, ...this.buttons().map((box) => box.bottom + BELOW_BUTTONS_PX));
    if (bounds !== null) this.camera = fitted(this.camera, bounds, topPx);
    if (bounds !== null && this.camera.widthPx > 0) this.fitted = true;
    this.changed();
  }

  zoom(factor: number): void {
    this.zoomAt(factor, this.camera.widthPx / 2, this.camera.heightPx / 2);
  }

  /** Zoomed by a factor; the place under this point of the canvas stays there. */
  zoomAt(factor: number, xPx: number, yPx: number): void {
    this.camera = zoomedAt(this.camera, factor, xPx, yPx);
    this.moved = true;
    this.changed();
  }

  pan(dxPx: number, dyPx: number): void {
    this.camera = panned(this.camera, dxPx, dyPx);
    this.moved = true;
    this.setFollow(false);
  }

  /** Place of a point of the canvas in the fleet's frame. */
  pointerAt(xPx: number, yPx: number, shift: boolean): PointerAt {
    return { ...toWorld(this.camera, xPx, yPx), reachM: HIT_PX / this.camera.pxPerM, shift };
  }

  geodeticOf(x: number, y: number): { lat_deg: number; lon_deg: number } | null {
    return this.frame === null ? null : toGeodetic(this.frame, x, y);
  }

  /** The nearest vehicle within reach of a point of the canvas. */
  vehicleAt(xPx: number, yPx: number): string | null {
    const { camera } = this;
    let nearest: string | null = null;
    let least = HIT_PX;
    for (const body of this.scene.bodies) {
      const distance = Math.hypot(toScreenX(camera, body.x) - xPx, toScreenY(camera, body.y) - yPx);
      if (distance < least) [nearest, least] = [body.name, distance];
    }
    return nearest;
  }

  /** Vehicles off the screen that an arrow under a point of the canvas stands for. */
  beyondArrowAt(xPx: number, yPx: number): readonly string[] {
    return arrowAt(this.arrows, xPx, yPx)?.names ?? [];
  }

  /** Moves the view to a vehicle, at its scale. */
  centreOn(name: string): void {
    const body = this.scene.bodies.find((one) => one.name === name);
    if (body === undefined) return;
    this.camera = { ...this.camera, x: body.x, y: body.y };
    this.moved = true;
    this.setFollow(false);
  }

  /** Vehicles within a rectangle of the canvas. */
  vehiclesIn(left: number, top: number, right: number, bottom: number): string[] {
    const { camera } = this;
    return this.scene.bodies.filter(({ x, y }) => {
        const [px, py] = [toScreenX(camera, x), toScreenY(camera, y)];
        return px >= left && px <= right && py >= top && py <= bottom;
      })
      .map((body) => body.name);
  }

  /** `ground`: of the same place and size, beneath the canvas that has the pointer. */
  attach(canvas: HTMLCanvasElement, ground: HTMLCanvasElement): () => void {
    this.canvas = canvas;
    this.pen = canvas.getContext("2d");
    this.ground = ground.getContext("2d", { alpha: false });
    this.palette = null;
    const resized = (): void => {
      this.resize();
      this.drawTimed(); // the canvas is empty now, and would be shown so until the next frame
    };
    const observer = new ResizeObserver(resized);
    observer.observe(canvas);
    const unwatch = onPixelRatio(resized);
    // the pictures that are kept went with the context, or with the memory of a page that nobody saw
    const restored = (): void => {
      this.palette = null;
      this.resize();
    };
    const seen = (): void => {
      if (document.visibilityState === "visible") this.forgetPictures();
    };
    for (const one of [canvas, ground]) one.addEventListener("contextrestored", restored);
    document.addEventListener("visibilitychange", seen);
    this.resize();
    return () => {
      observer.disconnect();
      unwatch();
      for (const one of [canvas, ground]) one.removeEventListener("contextrestored", restored);
      document.removeEventListener("visibilitychange", seen);
      this.canvas = null;
      this.pen = null;
      this.ground = null;
    };
  }

  redraw(): void {
    this.wanted = true;
    this.requestFrame();
  }

  // --- inside

  private requestFrame(): void {
    if (this.requested || this.canvas === null) return;
    this.requested = true;
    requestAnimationFrame(() => {
      this.requested = false;
      this.drawTimed();
    });
  }

  /** Something beneath the vehicles changed. */
  private repaint(): void {
    this.backdrop.stale();
    this.redraw();
  }

  /** All that is kept as a picture is drawn anew. */
  private forgetPictures(): void {
    this.palette = null;
    this.repaint();
  }

  /** Options, tool, follow or camera changed. */
  protected override changed(): void {
    this.redraw();
    super.changed();
  }

  private onState(state: State): void {
    const origin = state.origin ?? standInOrigin(state);
    // what stands in for an origin stays where it was: else the whole view would move with a vehicle
    const stays = state.origin === null && this.lastFrame?.standIn === true;
    if (origin !== null && !stays && (this.lastFrame === null || frameKey(this.lastFrame) !== frameKey(origin))) {
      this.lastFrame = frameAt(origin, state.origin === null);
      this.trailsDrawn = null; // the old trails are in metres of the frame before
    }
    const frame = frameIsKnown(state) ? this.lastFrame : null;
    // after a jump in a replay or a new connection the trails are others
    const others = state.generation !== this.generation || state.names !== this.names;
    [this.generation, this.names] = [state.generation, state.names];
    if (others) this.trailsDrawn = null;
    if (others || frame !== this.frame) this.backdrop.stale();
    this.frame = frame;
    this.map.show(state.hello);
  }

  private resize(): void {
    const canvas = this.canvas;
    if (canvas === null) return;
    const { width, height } = canvas.getBoundingClientRect();
    this.ratio = Math.min(devicePixelRatio || 1, MOST_RATIO);
    for (const one of [canvas, this.trailLayer, this.ground?.canvas]) {
      if (one === undefined) continue;
      one.width = Math.max(Math.round(width * this.ratio), 1);
      one.height = Math.max(Math.round(height * this.ratio), 1);
    }
    this.backdrop.stale();
    this.heightPx = height;
    this.camera = { ...this.camera, widthPx: width, heightPx: Math.max(height - (this.options.side ? sidePxOf(height) : 0), 1) };
    this.trailsDrawn = null;
    this.fittedTo = 0;
    this.labels.clear(this.ratio);
    this.sprites.clear(this.ratio);
    this.redraw();
  }

  private boundsOf(what: "all" | "selected"): Bounds | null {
    let bounds: Bounds | null = null;
    const bodies = this.scene.bodies.filter((body) => what === "all" || body.selected);
    for (const { x, y, goal } of bodies) {
      bounds = extended(bounds, x, y);
      if (goal !== null && what === "all") bounds = extended(bounds, goal[0], goal[1]);
    }
    if (what === "all") {
      for (const overlay of this.overlays.values()) if (overlay.fit === true) bounds = withOverlay(bounds, overlay);
    }
    return bounds;
  }

  private drawTimed(): void {
    clearTimeout(this.later);
    this.laterAtMs = Infinity;
    this.frameDrawn = screenFrame();
    const begun = performance.now();
    this.contained(() => this.drawAll(begun));
    const took = performance.now() - begun;
    if (this.picture.drawnMs === begun) {
      this.figures.frames += 1;
      this.figures.lastMs = took;
      this.figures.longestMs = Math.max(this.figures.longestMs, took);
    }
    const { camera, scene } = this;
    const sidePxPerM = this.options.side ? (this.heightPx - camera.heightPx) / Math.max(this.sideTopM, 1) : 0;
    const stepMs = (1000 * STEP_PX) / (Math.max(scene.acrossMps * camera.pxPerM, scene.upMps * sidePxPerM) * this.ratio);
    const alone = stepMs < WITH_STATES_MS;
    const pauseMs = alone ? pauseOf(stepMs) : Math.max(stepMs, NO_STATE_MS);
    const dueMs = alone ? pauseMs : Math.min(stepMs * MOST_OF_STEP, scene.jumps ? EACH_STATE_MS : STATE_WITHIN_MS);
    this.stateDueMs = begun + (took > SLOW_DRAW_MS ? Math.max(dueMs, 2 * took) : dueMs);
    if (scene.bodies.some(({ heard }) => heard)) this.redrawIn(Math.min(Math.max(pauseMs, took > SLOW_DRAW_MS ? took : 0), AGES_EVERY_MS));
  }

  /** One fault, say of a shape from a panel, must not freeze the whole view: the vehicles, and the next frame, are drawn all the
   *  same. False: there was one. */
  private contained(step: () => void): boolean {
    try {
      step();
      return true;
    } catch (error) {
      this.figures.faults += 1;
      if (this.figures.faults === 1) console.error("the fleet view could not be drawn", error);
      return false;
    }
  }

  /** A state has come, in a frame of the screen. */
  private drawState(): void {
    const leftMs = this.stateDueMs - performance.now();
    if (leftMs > SCREEN_FRAME_MS) this.redrawIn(Math.max(leftMs, NEXT_STATE_MS));
    else this.drawTimed();
  }

  /** Draws after so long, if nothing is drawn before. */
  private redrawIn(ms: number): void {
    const atMs = performance.now() + ms;
    if (ms <= 0) this.requestFrame();
    if (ms <= 0 || atMs >= this.laterAtMs) return;
    clearTimeout(this.later);
    this.laterAtMs = atMs;
    this.later = setTimeout(() => this.requestFrame(), ms);
  }

  private drawAll(nowMs: number): void {
    const { canvas, pen, ground } = this;
    if (canvas === null || pen === null || ground === null || this.camera.widthPx === 0) return;
    if (this.palette === null) {
      this.palette = readPalette(canvas);
      this.labels.clear(this.ratio);
      this.sprites.clear(this.ratio);
      this.trailsDrawn = null;
      this.backdrop.stale();
    }
    const palette = this.palette;
    this.scene = sceneOf(this.store.state, this.frame, nowMs, !this.stillMotion.matches);
    this.steer();
    if (this.showsAlready(nowMs)) return;
    this.wanted = false;
    this.picture.drawnMs = nowMs;
    const { bodies } = this.scene;
    const shown = this.visible(this.camera);
    const afar = shown.length > MANY_SHOWN;
    this.store.near = afar ? [] : shown.map(({ name }) => name);
    const look: Look = {
      nowMs,
      palette,
      shown,
      afar,
      side: this.sideScale(this.camera),
      colourOf: (body) => (body.heard || body.lostInAir ? (palette.vehicles[body.colour] ?? palette.accent) : palette.lost),
      colours: new Map(bodies.map(({ name, colour }) => [name, palette.vehicles[colour] ?? palette.accent])),
    };
    const painted = !this.backdrop.due(this.camera, nowMs) || this.contained(() => this.on(ground, () => this.drawBackdrop(ground, look)));
    if (!painted) this.backdrop.stale();
    pen.clearRect(0, 0, canvas.width, canvas.height); // of whole pixels of the screen: what was there need not be kept
    this.on(pen, () => this.drawVehicles(pen, look));
  }

  /** The scene has been drawn, a short while ago, and has not changed for a longer one. */
  private showsAlready(nowMs: number): boolean {
    const text = pictureOf(this.scene, this.camera.pxPerM * this.ratio);
    if (text === null || text !== this.picture.text) Object.assign(this.picture, { text, sinceMs: nowMs });
    const settled = nowMs - this.picture.sinceMs > SAME_PICTURE_MS;
    return settled && !this.wanted && !this.backdrop.isStale && nowMs - this.picture.drawnMs < SAME_PICTURE_MS;
  }

  /** Draws in pixels of the page, and leaves nothing of the pen's settings behind: a clip would hold for all that follows. */
  private on(pen: Pen, drawing: () => void): void {
    pen.save();
    try {
      pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      drawing();
    } finally {
      pen.restore();
    }
  }

  private drawVehicles(pen: Pen, { nowMs, palette, shown, afar, side, colourOf, colours }: Look): void {
    const { camera } = this;
    if (this.options.trails) draw.drawTrailEnds(pen, camera, this.store.trails, shown, colourOf);
    draw.drawGoals(pen, camera, shown, colourOf);
    draw.drawMeetings(pen, camera, palette, meetingsOf(this.scene, this.frame));
    if (afar) draw.drawDots(pen, camera, palette, shown, colourOf);
    else draw.drawBodies(pen, camera, palette, shown, colourOf, this.sprites);
    if (this.options.labels) this.drawLabels(pen, camera, palette, afar ? shown.filter(isUrgent).slice(0, MOST_URGENT) : shown, nowMs);
    this.drawArrows(pen, camera, palette, colours);
    if (side !== null) drawSideBodies(pen, camera, side, palette, this.scene.bodies, colourOf, this.sprites);
  }

  /** What the vehicles are drawn on: see `Backdrop`. */
  private drawBackdrop(pen: Pen, { nowMs, palette, afar, side, colourOf, colours }: Look): void {
    const { camera, options } = this;
    pen.fillStyle = palette.ground;
    // its last column and row are parts of a pixel of the screen where the ratio is no whole number
    pen.fillRect(0, 0, Math.ceil(camera.widthPx * this.ratio) / this.ratio, Math.ceil(this.heightPx * this.ratio) / this.ratio);
    if (options.map && this.frame !== null) this.map.draw(pen, camera, this.frame, this.ratio, palette);
    draw.drawGrid(pen, camera, palette);
    draw.drawOrigin(pen, camera, palette);
    draw.drawOverlays(pen, camera, palette, this.overlays.values(), colours);
    if (!afar) draw.drawHomes(pen, camera, palette, this.homes(this.store.state), this.sprites);
    if (options.trails) this.drawTrails(pen, camera, palette, colourOf, nowMs);
    draw.drawScale(pen, camera, palette, this.frame);
    if (options.map) draw.drawAttribution(pen, camera, palette, this.map.attribution);
    if (side !== null) drawSideGround(pen, camera, side, palette, this.overlays.values(), colours);
  }

  /** Of the strip of heights; null: it is not shown. */
  private sideScale(camera: Camera): SideScale | null {
    if (!this.options.side) return null;
    const topM = topOf(this.scene.bodies, this.overlays.values(), this.sideTopM);
    if (topM !== this.sideTopM) this.backdrop.stale();
    this.sideTopM = topM;
    return sideScale(camera.heightPx, this.heightPx - camera.heightPx, topM);
  }

  private drawArrows(pen: Pen, camera: Camera, palette: Palette, colours: draw.Colours): void {
    const shown = new Set(this.visible(camera));
    const hidden = this.scene.bodies.filter((body) => !shown.has(body));
    const places = hidden.map((body) => ({ name: body.name, x: body.x, y: body.y, urgency: (isAlarming(body) ? 2 : 0) + (body.selected ? 1 : 0) }));
    // where the buttons are is asked of the page, which costs
    this.arrows = hidden.length === 0 ? [] : edgeArrows(camera, places, this.buttons());
    const alarming = new Set(hidden.filter(isAlarming).map(({ name }) => name));
    draw.drawArrows(pen, camera, palette, this.arrows, (name) => (alarming.has(name) ? palette.danger : (colours.get(name) ?? palette.muted)));
  }

  /** Follows the selected vehicles; fits the fleet as its vehicles come. */
  private steer(): void {
    const { bodies } = this.scene;
    if ((!this.moved || !this.fitted) && bodies.length > (this.fitted ? this.fittedTo : 0)) {
      this.fittedTo = bodies.length;
      this.fit("all");
      if (this.tool !== null) this.moved = true; // see setTool
    }
    if (!this.follow) return;
    const selected = this.boundsOf("selected") ?? this.boundsOf("all");
    if (selected === null) return;
    this.camera = { ...this.camera, x: (selected.left + selected.right) / 2, y: (selected.bottom + selected.top) / 2 };
  }

  private visible(camera: Camera): Body[] {
    return this.scene.bodies.filter((body) => {
      const [x, y] = [toScreenX(camera, body.x), toScreenY(camera, body.y)];
      return x > -30 && y > -30 && x < camera.widthPx + 30 && y < camera.heightPx + 30;
    });
  }

  private *homes(state: State): Iterable<readonly [number, number]> {
    if (this.frame === null) return;
    for (const { home } of state.vehicles.values()) if (home !== null) yield fromGeodetic(this.frame, home.lat_deg, home.lon_deg);
  }

  /** Trails are a layer of their own: what comes is added to it; it is drawn anew for another camera, and moved till then. */
  private drawTrails(pen: Pen, camera: Camera, palette: Palette, colourOf: (body: Body) => string, nowMs: number): void {
    const { trails } = this.store;
    if (trails.byName.size === 0) {
      this.trailsDrawn = null;
      return;
    }
    const layer = this.trailLayer.getContext("2d");
    if (layer === null) return;
    const drawn = this.trailsDrawn;
    const colours = new Map(this.scene.bodies.map((body) => [body.name, colourOf(body)]));
    const same = drawn !== null && sameCamera(drawn.camera, camera);
    const pauseMs = same ? TRAILS_ANEW_MS : Math.max(BACKDROP_EVERY_MS, (drawn?.tookMs ?? 0) * TRAILS_SHARE);
    if (drawn === null || nowMs - drawn.ms > pauseMs) {
      layer.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
      layer.clearRect(0, 0, camera.widthPx, this.heightPx);
      draw.drawTrails(layer, camera, trails, colours, palette.lost);
      this.trailsDrawn = { camera, ms: nowMs, tookMs: performance.now() - nowMs };
    } else if (same) {
      draw.extendTrails(layer, camera, trails, colours, palette.lost);
    } else {
      this.backdrop.stale();
      this.redrawIn(pauseMs - (nowMs - drawn.ms));
    }
    const from = (this.trailsDrawn ?? { camera }).camera;
    const scale = camera.pxPerM / from.pxPerM;
    const left = toScreenX(camera, from.x) - (from.widthPx / 2) * scale;
    const top = toScreenY(camera, from.y) - (from.heightPx / 2) * scale;
    pen.imageSmoothingEnabled = false; // six times as quick, and seen only while the view moves
    pen.drawImage(this.trailLayer, left, top, camera.widthPx * scale, this.heightPx * scale);
    pen.imageSmoothingEnabled = true;
  }

  private drawLabels(pen: Pen, camera: Camera, palette: Palette, shown: readonly Body[], nowMs: number): void {
    this.labels.beginFrame();
    const sprites = shown.map((body) => this.labels.get(body.name, body.name, labelLine(body), labelTone(body), palette, nowMs));
    if (nowMs - this.placedMs > LABELS_EVERY_MS) {
      this.placedMs = nowMs;
      const requests = shown.map((body, i) => ({
        id: body.name,
        xPx: toScreenX(camera, body.x),
        yPx: toScreenY(camera, body.y),
        widthPx: sprites[i]?.widthPx ?? 0,
        nameWidthPx: sprites[i]?.nameWidthPx ?? 0,
        reachPx: draw.reachOf(body),
        urgent: isUrgent(body),
        urgency: (isAlarming(body) ? 2 : 0) + (body.selected ? 1 : 0),
      }));
      requests.sort((a, b) => b.urgency - a.urgency);
      this.placements = placeLabels(requests, this.placements, camera.widthPx, camera.heightPx, [
        ...this.buttons(),
        ...draw.scaleBoxes(camera),
        ...draw.attributionBox(camera, this.options.map ? this.map.attribution : ""),
      ]);
    }
    const led = shown.flatMap((body, i) => {
      const at = this.placements.get(body.name);
      return at?.led === true ? [{ body, at, widthPx: sprites[i]?.nameWidthPx ?? 0 }] : [];
    });
    draw.drawLeaders(pen, camera, palette, led);
    pen.imageSmoothingEnabled = false; // they lie on whole pixels
    shown.forEach((body, i) => {
      const at = this.placements.get(body.name);
      const sprite = sprites[i];
      if (at === undefined || sprite == null) return;
      const x = Math.round((toScreenX(camera, body.x) + at.dx) * this.ratio) / this.ratio;
      const y = Math.round((toScreenY(camera, body.y) + at.dy) * this.ratio) / this.ratio;
      const height = at.full ? LABEL_HEIGHT_PX : LABEL_HEIGHT_PX / 2;
      const width = Math.min(Math.ceil(widthOf(sprite, at.full)), LABEL_WIDTH_PX);
      pen.drawImage(sprite.picture, 0, 0, width * this.ratio, height * this.ratio, x, y, width, height);
    });
    pen.imageSmoothingEnabled = true;
  }
}

/** The time of the screen's present frame: one for all that is called in it. */
function screenFrame(): number | null {
  const time = document.timeline.currentTime;
  return time === null ? null : Number(time);
}

/** Before the frame of the screen in which a step is made. */
function pauseOf(stepMs: number): number {
  return stepMs <= 2 * SCREEN_FRAME_MS ? 0 : stepMs - SCREEN_FRAME_MS;
}

function labelTone({ trouble, heard }: Body): LabelTone {
  if (trouble?.severity === "danger") return "danger";
  return heard ? "plain" : "dim";
}

/** Its label has room before all others. */
function isAlarming({ trouble, conflict }: Body): boolean {
  return trouble?.severity === "danger" || conflict !== null;
}

function isUrgent(body: Body): boolean {
  return isAlarming(body) || body.selected;
}

function withOverlay(bounds: Bounds | null, overlay: Overlay): Bounds | null {
  for (const shape of overlay.shapes) {
    if (shape.kind === "path") for (const [x, y] of shape.points) bounds = extended(bounds, x, y);
    else if (shape.kind === "circle") bounds = extended(bounds, shape.centre[0], shape.centre[1], shape.radiusM);
    else bounds = extended(bounds, shape.at[0], shape.at[1]);
  }
  return bounds;
}

/** Without an origin metres are counted from the first vehicle that has a place. */
function standInOrigin(state: State): { lat_deg: number; lon_deg: number; alt_amsl_m: number; x_heading_deg: number } | null {
  for (const name of state.names) {
    const position = state.vehicles.get(name)?.position;
    if (position?.lat_deg == null || position.lon_deg === null) continue;
    return { lat_deg: position.lat_deg, lon_deg: position.lon_deg, alt_amsl_m: position.alt_amsl_m ?? 0, x_heading_deg: 90 };
  }
  return null;
}

function recalledOptions(): Partial<ViewOptions> {
  try {
    const kept: unknown = JSON.parse(recall("skygcs.view") ?? "{}");
    if (typeof kept !== "object" || kept === null) return {};
    return Object.fromEntries(Object.entries(kept).filter(([, value]) => typeof value === "boolean"));
  } catch {
    return {};
  }
}

/** Calls `changed` when the page comes to a screen of other pixels: the size of the canvas may stay the same then. */
function onPixelRatio(changed: () => void): () => void {
  let now: MediaQueryList;
  const watch = (): void => {
    now = matchMedia(`(resolution: ${devicePixelRatio}dppx)`);
    now.addEventListener("change", heard, { once: true });
  };
  const heard = (): void => {
    watch();
    changed();
  };
  watch();
  return () => now.removeEventListener("change", heard);
}
