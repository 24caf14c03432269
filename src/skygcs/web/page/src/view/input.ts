// Pointer, fingers, wheel and keys on the canvas: pan, zoom, pinch, select, and the tool of a panel.

import { fixed } from "../format.ts";
import type { Store } from "../store.ts";
import type { FleetView } from "./fleet_view.ts";

/** A press that moves less is a click. */
const CLICK_PX = 6;
const PAN_KEY_PX = 60;
const PANS: Readonly<Record<string, readonly [number, number]>> = {
  ArrowLeft: [PAN_KEY_PX, 0],
  ArrowRight: [-PAN_KEY_PX, 0],
  ArrowUp: [0, PAN_KEY_PX],
  ArrowDown: [0, -PAN_KEY_PX],
};

export interface Reports {
  /** The place under the pointer, for people. */
  place: (text: string) => void;
  /** The rectangle that is being drawn to select vehicles. */
  band: (box: { left: number; top: number; width: number; height: number } | null) => void;
}

interface Point {
  x: number;
  y: number;
}

type Drag = { kind: "pan" } | { kind: "tool" } | { kind: "band"; from: Point };

/** Listens to the canvas; returns what ends it. */
export function beginInput(canvas: HTMLCanvasElement, view: FleetView, store: Store, reports: Reports): () => void {
  const input = new CanvasInput(canvas, view, store, reports);
  const listeners: readonly (readonly [string, (event: never) => void])[] = [
    ["pointerdown", (event: PointerEvent) => input.onDown(event)],
    ["pointermove", (event: PointerEvent) => input.onMove(event)],
    ["pointerup", (event: PointerEvent) => input.onUp(event)],
    ["pointercancel", (event: PointerEvent) => input.onUp(event)],
    ["pointerleave", () => input.onLeave()],
    ["keydown", (event: KeyboardEvent) => input.onKey(event)],
    ["wheel", (event: WheelEvent) => input.onWheel(event)],
  ];
  for (const [kind, listener] of listeners) canvas.addEventListener(kind, listener as EventListener, { passive: false });
  return () => {
    for (const [kind, listener] of listeners) canvas.removeEventListener(kind, listener as EventListener);
  };
}

class CanvasInput {
  private readonly fingers = new Map<number, Point>();
  private drag: Drag | null = null;
  private pressed: Point | null = null;
  private moved = false;

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly view: FleetView,
    private readonly store: Store,
    private readonly reports: Reports,
  ) {}

  onDown(event: PointerEvent): void {
    if (event.button > 1) return;
    this.canvas.setPointerCapture(event.pointerId);
    const at = this.here(event);
    this.fingers.set(event.pointerId, at);
    if (this.fingers.size > 1) {
      this.drag = null;
      this.reports.band(null);
      return;
    }
    this.pressed = at;
    this.moved = false;
    const { tool } = this.view;
    if (tool?.grab?.(this.view.pointerAt(at.x, at.y, event.shiftKey)) === true) this.drag = { kind: "tool" };
    else if (event.shiftKey && tool === null) this.drag = { kind: "band", from: at };
    else this.drag = { kind: "pan" };
  }

  onMove(event: PointerEvent): void {
    const at = this.here(event);
    const before = this.fingers.get(event.pointerId);
    if (before === undefined) {
      this.hover(at, event.shiftKey);
      return;
    }
    if (this.fingers.size === 2) {
      this.pinch(event.pointerId, before, at);
      return;
    }
    this.fingers.set(event.pointerId, at);
    if (this.pressed !== null && Math.hypot(at.x - this.pressed.x, at.y - this.pressed.y) > CLICK_PX) this.moved = true;
    if (!this.moved || this.drag === null) return;
    if (this.drag.kind === "pan") {
      this.view.pan(at.x - before.x, at.y - before.y);
      this.canvas.style.cursor = "grabbing";
    } else if (this.drag.kind === "tool") {
      this.view.tool?.dragTo?.(this.view.pointerAt(at.x, at.y, event.shiftKey), false);
    } else {
      this.reports.band(boxOf(this.drag.from, at));
    }
  }

  onUp(event: PointerEvent): void {
    if (!this.fingers.delete(event.pointerId)) return;
    const at = this.here(event);
    const ended = this.drag;
    this.drag = null;
    this.reports.band(null);
    this.canvas.style.cursor = this.view.tool?.cursor ?? "grab";
    if (event.type === "pointercancel" || this.fingers.size > 0 || ended === null) return;
    if (ended.kind === "tool") this.view.tool?.dragTo?.(this.view.pointerAt(at.x, at.y, event.shiftKey), true);
    else if (!this.moved) this.click(at, event);
    else if (ended.kind === "band") this.selectBand(ended.from, at);
  }

  onLeave(): void {
    this.reports.place("");
    this.view.tool?.hover?.(null);
  }

  onWheel(event: WheelEvent): void {
    event.preventDefault();
    const at = this.here(event);
    const pixels = event.deltaMode === 1 ? event.deltaY * 20 : event.deltaY;
    this.view.zoomAt(Math.exp(-Math.max(-300, Math.min(300, pixels)) * 0.0015), at.x, at.y);
  }

  onKey(event: KeyboardEvent): void {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const by = PANS[event.key];
    if (by === undefined) return;
    event.preventDefault();
    this.view.pan(...by);
  }

  private here(event: PointerEvent | WheelEvent): Point {
    const box = this.canvas.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top };
  }

  private hover(at: Point, shift: boolean): void {
    const place = this.view.pointerAt(at.x, at.y, shift);
    this.reports.place(`x ${fixed(place.x, 1) ?? ""} m   y ${fixed(place.y, 1) ?? ""} m`);
    this.view.tool?.hover?.(place);
    if (this.view.tool === null) this.canvas.style.cursor = this.view.vehicleAt(at.x, at.y) === null && this.view.beyondArrowAt(at.x, at.y).length === 0 ? "grab" : "pointer";
  }

  private pinch(id: number, before: Point, at: Point): void {
    const other = [...this.fingers].find(([key]) => key !== id)?.[1];
    if (other === undefined) return;
    const was = Math.hypot(before.x - other.x, before.y - other.y);
    const is = Math.hypot(at.x - other.x, at.y - other.y);
    this.view.pan((at.x - before.x) / 2, (at.y - before.y) / 2);
    if (was > 10) this.view.zoomAt(is / was, (at.x + other.x) / 2, (at.y + other.y) / 2);
    this.fingers.set(id, at);
    this.moved = true;
  }

  private click(at: Point, event: PointerEvent): void {
    const { view, store } = this;
    if (view.tool !== null) {
      view.tool.click?.(view.pointerAt(at.x, at.y, event.shiftKey));
      return;
    }
    const [beyond] = view.beyondArrowAt(at.x, at.y);
    if (beyond !== undefined) {
      view.centreOn(beyond);
      return;
    }
    const name = view.vehicleAt(at.x, at.y);
    const add = event.shiftKey || event.ctrlKey || event.metaKey;
    if (name !== null) store.dispatch({ type: "select", names: [name], how: add ? "toggle" : "only" });
    else if (!add) store.dispatch({ type: "select", names: [], how: "only" });
  }

  private selectBand(from: Point, at: Point): void {
    const box = boxOf(from, at);
    const names = this.view.vehiclesIn(box.left, box.top, box.left + box.width, box.top + box.height);
    this.store.dispatch({ type: "select", names, how: "add" });
  }
}

function boxOf(a: Point, b: Point): { left: number; top: number; width: number; height: number } {
  return { left: Math.min(a.x, b.x), top: Math.min(a.y, b.y), width: Math.abs(a.x - b.x), height: Math.abs(a.y - b.y) };
}
