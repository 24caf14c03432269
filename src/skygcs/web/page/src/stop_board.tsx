// The strip under the top bar after a STOP: one chip for each vehicle, filled as answers come, until it is dismissed.

import { ageText } from "./format.ts";
import { useStore, useTick } from "./hooks.ts";
import type { Store } from "./store.ts";
import { boardText, stopBoard, type Board, type Chip, type ChipState } from "./stop_chips.ts";

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
