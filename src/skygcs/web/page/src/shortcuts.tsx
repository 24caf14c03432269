// The list of keys, and the keys that belong to no part of the page alone.

import { useRef } from "preact/hooks";
import { useWindowEvent } from "./hooks.ts";
import { isTextField } from "./stop_key.ts";
import type { Store } from "./store.ts";
import type { FleetView } from "./view/fleet_view.ts";

const KEYS: readonly (readonly [string, string])[] = [
  ["Shift+S or F8", "STOP: all vehicles hold where they are"],
  ["H", "Hold the selected vehicles"],
  ["A, T, R, L, D held for a second", "Arm, take off, return, land, disarm the selected vehicles"],
  ["G", "Go to: choose a place in the view; Enter held for a second sends it"],
  ["Ctrl+A / Escape", "Select all / none; Escape also ends a tool"],
  ["↑ ↓ in the table", "Move; Shift extends the selection, Space changes one"],
  ["/", "Filter the table"],
  ["F / C", "Show all / follow the selected vehicles"],
  ["+ − and arrows in the view", "Zoom and move"],
  ["?", "This list"],
];

/** Keys of the whole page: selection and view. */
function onPageKey(event: KeyboardEvent, store: Store, view: FleetView): void {
  if (isTextField(event.target)) return;
  if ((event.ctrlKey || event.metaKey) && event.key.toLowerCase() === "a") {
    event.preventDefault();
    store.dispatch({ type: "select", names: store.state.names, how: "only" });
    return;
  }
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  switch (event.key) {
    case "Escape":
      if (view.tool !== null) view.setTool(null);
      else store.dispatch({ type: "select", names: [], how: "only" });
      break;
    case "f":
      view.fit("all");
      break;
    case "c":
      view.setFollow(!view.follow);
      break;
    case "+":
    case "=":
      view.zoom(1.5);
      break;
    case "-":
      view.zoom(1 / 1.5);
      break;
  }
}

export function Shortcuts({ store, view }: { store: Store; view: FleetView }) {
  const dialog = useRef<HTMLDialogElement>(null);
  useWindowEvent("keydown", (event) => {
    if (dialog.current?.open === true) return;
    if (event.key === "?" && !isTextField(event.target)) dialog.current?.showModal();
    else onPageKey(event, store, view);
  });
  return (
    <>
      <button type="button" class="quiet keys" title="Keys (?)" aria-label="Keys" onClick={() => dialog.current?.showModal()}>?</button>
      <dialog ref={dialog} class="keylist" aria-label="Keys">
        <h2>Keys</h2>
        <dl>{KEYS.map(([key, what]) => <div key={key}><dt>{key}</dt><dd>{what}</dd></div>)}</dl>
        <form method="dialog"><button>Close</button></form>
      </dialog>
    </>
  );
}
