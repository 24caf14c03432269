// STOP: always visible, one action, also by keyboard. It acts on the press, not on the release.

import { useEffect } from "preact/hooks";
import type { Connection } from "./connection.ts";
import { useStore } from "./hooks.ts";
import { sendStop } from "./orders.ts";
import type { Store } from "./store.ts";

/** True for Shift+S outside of text fields, and for F8 everywhere. */
export function isStopKey(event: Pick<KeyboardEvent, "key" | "shiftKey" | "ctrlKey" | "metaKey" | "altKey" | "repeat">, inText: boolean): boolean {
  if (event.repeat || event.ctrlKey || event.metaKey || event.altKey) return false;
  return event.key === "F8" || (event.shiftKey && event.key.toLowerCase() === "s" && !inText);
}

export function isTextField(target: EventTarget | null): boolean {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement) return !["button", "checkbox", "radio", "range"].includes(target.type);
  return target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement || target.isContentEditable;
}

export function StopButton({ store, connection }: { store: Store; connection: Connection }) {
  const role = useStore(store, (state) => state.hello?.role ?? null);
  const replay = useStore(store, (state) => state.hello?.replay ?? false);
  const refused = role === "view" || replay;
  useEffect(() => {
    const onKey = (event: KeyboardEvent): void => {
      if (refused || !event.isTrusted || !isStopKey(event, isTextField(event.target))) return;
      event.preventDefault();
      void sendStop(store, connection);
    };
    addEventListener("keydown", onKey, { capture: true });
    return () => removeEventListener("keydown", onKey, { capture: true });
  }, [store, connection, refused]);
  if (replay) return null;
  return (
    <button
      type="button"
      class="stop"
      disabled={refused}
      title={refused ? "This address may only look" : "All vehicles hold where they are (Shift+S or F8)"}
      aria-label="Stop all vehicles"
      aria-keyshortcuts="Shift+S F8"
      onPointerDown={(event) => {
        if (event.button === 0) void sendStop(store, connection);
      }}
      onClick={(event) => {
        // a press was handled on its way down; this is the keyboard's, or a screen reader's
        if (event.detail === 0) void sendStop(store, connection);
      }}
    >
      STOP
    </button>
  );
}
