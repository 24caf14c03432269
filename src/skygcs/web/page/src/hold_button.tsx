// A button that acts once it was held down for a second, by pointer, by Space or Enter, or by a key of its own.

import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import type { ComponentChildren } from "preact";
import { useWindowEvent } from "./hooks.ts";
import { isLetterFor } from "./stop_key.ts";

export const HOLD_MS = 1_000;
/** Time for which a press that was too short shows how long to hold. */
const HINT_MS = 2_000;

export interface HoldButtonProps {
  /** What it does, with its targets: "Arm alpha and bravo". Shown while it is held, and read aloud. */
  what: string;
  act: () => void;
  children: ComponentChildren;
  disabled?: boolean;
  /** All that it is for: a hold begins anew when it changes, also where `what` does not name everything. */
  targets?: readonly string[];
  /** A letter that does the same while it is held, outside of text fields. */
  hotkey?: string;
  danger?: boolean;
  class?: string;
  title?: string;
}

export function HoldButton({ what, act, children, targets = [], disabled = false, hotkey, danger = false, title, ...rest }: HoldButtonProps) {
  const [holding, setHolding] = useState(false);
  const [tooShort, setTooShort] = useState(false);
  const timer = useRef<ReturnType<typeof setTimeout> | null>(null);
  const button = useRef<HTMLButtonElement>(null);
  const action = useRef(act);
  action.current = act;

  const release = (): void => {
    if (timer.current !== null) clearTimeout(timer.current);
    timer.current = null;
    setHolding(false);
  };
  /** A person let go: too early, as a hold that acted has no timer any more. */
  const letGo = (): void => {
    if (timer.current !== null) setTooShort(true);
    release();
  };
  const press = (): void => {
    if (disabled || timer.current !== null) return;
    setHolding(true);
    setTooShort(false);
    timer.current = setTimeout(() => {
      // a page that stood still has the release in its queue, perhaps behind this timer: input comes before a frame
      requestAnimationFrame(() => {
        timer.current &&= setTimeout(() => {
          release();
          action.current();
        }, 0);
      });
    }, HOLD_MS);
  };
  useEffect(() => release, []);
  useEffect(() => {
    if (!tooShort) return undefined;
    const over = setTimeout(() => setTooShort(false), HINT_MS);
    return () => clearTimeout(over);
  }, [tooShort]);
  useLayoutEffect(() => {
    if (disabled) release();
  }, [disabled]);
  // what it is for changed under the finger: begin anew, before the timer can act for the new ones
  const about = `${what}\n${targets.join("\n")}`;
  useLayoutEffect(() => release, [about]);
  useWindowEvent("blur", letGo);
  useWindowEvent("keydown", (event) => {
    if (isLetterFor(event, hotkey, button.current)) press();
    // a Mac sends no keyup of a key that is let go while Cmd is down
    if (event.metaKey || event.key === "Meta") letGo();
  });
  useWindowEvent("keyup", (event) => { if (!disabled && event.key.toLowerCase() === hotkey) letGo(); });

  const isKey = (event: KeyboardEvent): boolean => event.key === " " || event.key === "Enter";
  return (
    <button
      ref={button}
      type="button"
      class={`hold ${danger ? "danger" : ""} ${rest.class ?? ""}`}
      data-holding={holding}
      disabled={disabled}
      title={title ?? `Hold down for a second: ${what}`}
      aria-keyshortcuts={hotkey?.toUpperCase()}
      onPointerDown={(event) => {
        if (event.button !== 0 || !event.isTrusted) return;
        event.currentTarget.setPointerCapture(event.pointerId);
        press();
      }}
      onPointerUp={letGo}
      onPointerCancel={release}
      onContextMenu={(event) => event.preventDefault()}
      onKeyDown={(event) => {
        if (!isKey(event)) return;
        event.preventDefault();
        if (!event.repeat && event.isTrusted) press();
      }}
      onKeyUp={(event) => {
        if (isKey(event)) letGo();
      }}
      onBlur={release}
    >
      {children}
      <span class="unseen">, {what}: hold down for a second</span>
      {holding && <HoldHint text={`${what}: keep holding`} />}
      {tooShort && !holding && <HoldHint text={`${what}: hold for ${HOLD_MS / 1000} s`} />}
    </button>
  );
}

/** What is about to happen and to whom, large, where no finger covers it. */
function HoldHint({ text }: { text: string }) {
  return <span class="holdhint" role="status">{text}</span>;
}
