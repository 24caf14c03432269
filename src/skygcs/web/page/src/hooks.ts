// Parts of the store as component state.

import { useCallback, useEffect, useLayoutEffect, useMemo, useReducer, useRef, useState } from "preact/hooks";
import { frameIsKnown, frameKeyOf, valueIn, type Framed } from "./framed.ts";
import type { State, Store } from "./store.ts";
import type { FleetView } from "./view/fleet_view.ts";
import type { Overlay } from "./view/overlays.ts";

/** A part of the state; the component is drawn again when it changed. */
export function useStore<T>(store: Store, pick: (state: State) => T): T {
  const [, redraw] = useReducer((n: number) => n + 1, 0);
  const value = pick(store.state);
  const shown = useRef(value);
  const picker = useRef(pick);
  shown.current = value;
  picker.current = pick;
  useEffect(() => {
    const check = (): void => {
      if (!Object.is(picker.current(store.state), shown.current)) redraw(0);
    };
    check();
    return store.subscribe(check);
  }, [store]);
  return value;
}

/** A choice in metres of the fleet's frame, and how to change it: `none` as soon as the frame is another one. */
export function useFramed<T>(store: Store, none: T): [value: T, set: (next: T | ((before: T) => T)) => void] {
  const frame = useStore(store, frameKeyOf);
  const [kept, setKept] = useState<Framed<T> | null>(null);
  const otherwise = useRef(none);
  otherwise.current = none;
  const set = useCallback((next: T | ((before: T) => T)): void => {
    const now = frameKeyOf(store.state);
    setKept((before) => ({ frame: now, value: typeof next === "function" ? (next as (before: T) => T)(valueIn(before, now, otherwise.current)) : next }));
  }, [store]);
  return [valueIn(kept, frame, none), set];
}

/** False while the frame that places are counted in is not known: nothing in metres may be chosen, checked or sent. */
export function useFrameKnown(store: Store): boolean {
  return useStore(store, frameIsKnown);
}

/** Shows an overlay of the view while the component is there; null: none. */
export function useOverlay(view: FleetView, id: string, shown: Overlay | null): void {
  useEffect(() => view.setOverlay(id, shown), [view, id, shown]);
  useEffect(() => () => view.setOverlay(id, null), [view, id]);
}

/** Listens to the window with what the component was drawn with last: a key must not act for vehicles that were selected before.
 *  The listener itself stays: one that is replaced while an event goes round, as a selection draws the page anew, would miss it. */
export function useWindowEvent<K extends keyof WindowEventMap>(kind: K, heard: (event: WindowEventMap[K]) => void, capture = false): void {
  const latest = useRef(heard);
  latest.current = heard;
  useLayoutEffect(() => {
    const listener = (event: WindowEventMap[K]): void => latest.current(event);
    addEventListener(kind, listener, { capture });
    return () => removeEventListener(kind, listener, { capture });
  }, [kind, capture]);
}

/** Calls its listeners at each change. */
export class Changes {
  private readonly listeners = new Set<() => void>();

  /** Returns what removes the listener. */
  onChange(listener: () => void): () => void {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  protected changed(): void {
    for (const listener of [...this.listeners]) listener();
  }
}

/** Draws the component again at each change of ``source``. It listens before anything else can happen: an effect that
 * waits for the next frame would miss what comes until then, and the frames of a hidden page do not come. */
export function useChanges(source: Pick<Changes, "onChange">): void {
  const [, redraw] = useReducer((n: number) => n + 1, 0);
  useLayoutEffect(() => source.onChange(() => redraw(0)), [source]);
}

/** Draws the component again so often, for ages and what changes at every update. Returns the page's time. */
export function useTick(everyMs: number): number {
  const [now, setNow] = useState(() => performance.now());
  useEffect(() => {
    const timer = setInterval(() => setNow(performance.now()), everyMs);
    return () => clearInterval(timer);
  }, [everyMs]);
  return now;
}

/** The names of the selected vehicles. */
export function useSelected(store: Store): readonly string[] {
  const selection = useStore(store, (state) => state.selection);
  return useMemo(() => [...selection], [selection]);
}

/** The state as it is every so many milliseconds: for lists of vehicles, which change faster than anybody reads. */
export function useSlowState(store: Store, everyMs: number): { state: State; nowMs: number } {
  const nowMs = useTick(everyMs);
  // selection and orders answer a person: at once
  useStore(store, (state) => state.selection);
  useStore(store, (state) => state.names);
  return { state: store.state, nowMs };
}
