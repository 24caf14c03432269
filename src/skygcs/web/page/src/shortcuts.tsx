// The list of keys, and the keys that belong to no part of the page alone.

import { useEffect, useRef } from "preact/hooks";
import { isTextField } from "./stop.tsx";

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

export function Shortcuts() {
  const dialog = useRef<HTMLDialogElement>(null);
  useEffect(() => {
    const onKey = (event: KeyboardEvent): void => {
      if (event.key === "?" && !isTextField(event.target)) dialog.current?.showModal();
    };
    addEventListener("keydown", onKey);
    return () => removeEventListener("keydown", onKey);
  }, []);
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
