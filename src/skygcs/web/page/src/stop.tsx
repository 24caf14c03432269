// STOP: always visible, one action, also by keyboard. It acts on the press, not on the release.

import type { Connection } from "./connection.ts";
import { useStore, useWindowEvent } from "./hooks.ts";
import { sendStop } from "./orders.ts";
import { isStopKey, isTextField } from "./stop_key.ts";
import type { Store } from "./store.ts";

export function StopButton({ store, connection }: { store: Store; connection: Connection }) {
  const role = useStore(store, (state) => state.hello?.role ?? null);
  const replay = useStore(store, (state) => state.hello?.replay ?? false);
  const refused = role === "view" || replay;
  useWindowEvent("keydown", (event) => {
    if (refused || !event.isTrusted || !isStopKey(event, isTextField(event.target))) return;
    event.preventDefault();
    sendStop(store, connection);
  }, true);
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
        if (event.button === 0) sendStop(store, connection);
      }}
      onClick={(event) => {
        // a press was handled on its way down; this is the keyboard's, or a screen reader's
        if (event.detail === 0) sendStop(store, connection);
      }}
    >
      STOP
    </button>
  );
}
