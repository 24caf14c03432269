// STOP: always visible, one action, also by keyboard, on the press and not on the release; and the strip under the top bar after it,
// one chip for each vehicle, filled as answers come, until it is dismissed.

import type { Connection } from "./connection.ts";
import { ageText } from "./format.ts";
import { useStore, useTick, useWindowEvent } from "./hooks.ts";
import { sendStop } from "./orders.ts";
import { type Board, boardText, type Chip, type ChipState, stopBoard } from "./stop_chips.ts";
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

const MARKS: Readonly<Record<ChipState, string>> = { bad: "✕", open: "?", waiting: "…", ok: "✓" };
const WORDS: Readonly<Record<ChipState, string>> = { bad: "did not stop", open: "not known", waiting: "not answered yet", ok: "stopped" };

export function StopBoard({ store }: { store: Store }) {
  const orders = useStore(store, (state) => state.orders);
  useTick(500);
  const board = stopBoard(orders, performance.now());
  if (board === null) return null;
  const worst: ChipState = board.counts.bad + board.errors.length > 0 ? "bad" : board.counts.open > 0 ? "open" : board.counts.waiting > 0 ? "waiting" : "ok";
  const dismiss = (): void => board.ids.forEach((id) => store.dispatch({ type: "orderDismissed", id }));
  return (
    <section class="stopboard" data-state={worst} aria-label="What STOP has come to">
      <div class="stophead">
        <p role={worst === "bad" ? "alert" : "status"}><b>STOP</b> {boardText(board)}</p>
        <button type="button" class="quiet close" aria-label="Dismiss the STOP board" onClick={dismiss}>×</button>
      </div>
      {board.errors.map((error) => <p key={error} class="bad">{error}</p>)}
      <ChipList board={board} />
    </section>
  );
}

function ChipList({ board }: { board: Board }) {
  // a list that scrolls must be reached by keyboard
  return (
    <ul class="stopchips" tabIndex={0} aria-label="Vehicles, problems first">
      {board.chips.map((chip) => <ChipItem key={chip.name} chip={chip} waitedS={board.waitedS} />)}
    </ul>
  );
}

function ChipItem({ chip: { name, state, text }, waitedS }: { chip: Chip; waitedS: number }) {
  return (
    <li class="stopchip" data-state={state} title={text}>
      <span class="mark" role="img" aria-label={WORDS[state]}>{MARKS[state]}</span> <b>{name}</b>{" "}
      <span class="what">{state === "waiting" ? ageText(waitedS) : text}</span>
    </li>
  );
}
