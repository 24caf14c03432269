// What became of orders, per vehicle, in the daemon's own words.

import { useState } from "preact/hooks";
import type { Connection } from "./connection.ts";
import { ageText, namesText } from "./format.ts";
import { useStore, useTick } from "./hooks.ts";
import { askOutcomes, isStop } from "./orders.ts";
import { groupOutcomes } from "./outcomes.ts";
import type { OrderRun, Store } from "./store.ts";

const SHOWN = 3;
/** What went well goes away by itself; what did not stays until a person dismisses it. */
const DONE_SHOWN_MS = 6_000;

interface ListProps {
  store: Store;
  connection: Connection;
}

/** The newest orders, above everything else; STOP has its board. */
export function OrderList({ store, connection }: ListProps) {
  const orders = useStore(store, (state) => state.orders);
  useTick(500);
  const now = performance.now();
  const shown = orders.filter((order) => !isStop(order) && order.dismissed !== true && !(order.state === "done" && now - (order.endedMs ?? now) > DONE_SHOWN_MS)).slice(0, SHOWN);
  return (
    <div class="toasts" role="log" aria-label="Orders" aria-live="polite">
      {shown.map((order) => <OrderCard key={order.id} order={order} store={store} connection={connection} />)}
    </div>
  );
}

/** All orders of this page. */
export function OrderHistory({ store, connection }: ListProps) {
  const orders = useStore(store, (state) => state.orders);
  if (orders.length === 0) return null;
  return (
    <section class="history" aria-label="Orders of this page">
      <h3>Orders of this page</h3>
      <ul>
        {orders.map((order) => (
          <li key={order.id} data-state={order.state}>
            <b>{order.label}</b> <span class="muted">{whomText(order)}</span>
            <OutcomeList order={order} store={store} connection={connection} />
          </li>
        ))}
      </ul>
    </section>
  );
}

interface OrderProps extends ListProps {
  order: OrderRun;
}

function OrderCard({ order, store, connection }: OrderProps) {
  return (
    <div class="toast" data-state={order.state}>
      <div class="toasthead">
        <StateMark order={order} />
        <b>{order.label}</b>
        <span class="muted">{whomText(order)}</span>
        {order.state !== "pending" && (
          <button type="button" class="quiet close" aria-label="Dismiss" onClick={() => store.dispatch({ type: "orderDismissed", id: order.id })}>×</button>
        )}
      </div>
      <OutcomeList order={order} store={store} connection={connection} />
    </div>
  );
}

/** An order for no vehicle, as one about the origin, says all in its label. */
function whomText({ targets }: OrderRun): string {
  return targets.length === 0 ? "" : namesText(targets);
}

function StateMark({ order }: { order: OrderRun }) {
  const text = { pending: "…", done: "✓", failed: "✕", unknown: "?" }[order.state];
  const name = { pending: "under way", done: "done", failed: "failed", unknown: "not known" }[order.state];
  return <span class="mark" role="img" aria-label={name}>{text}</span>;
}

function OutcomeList({ order, store, connection }: OrderProps) {
  if (order.error !== null) return <p class="outcome bad">{order.error}</p>;
  const waiting = order.state === "pending" ? order.targets.filter((name) => order.outcomes[name] === undefined) : [];
  return (
    <ul class="outcomes">
      {order.state === "pending" && (
        <li class="outcome muted">waiting for {waiting.length === 0 ? "the answer" : namesText(waiting)}, {ageText((performance.now() - order.startedMs) / 1000)}</li>
      )}
      {groupOutcomes(order.outcomes).map(({ ok, unknown, text, names }) => (
        <li key={names[0]} class={ok ? "outcome" : unknown ? "outcome open" : "outcome bad"}>
          <span class="who">{ok ? namesText(names) : names.join(", ")}</span> {text}
          {unknown && <AskButton order={order} names={names} store={store} connection={connection} />}
        </li>
      ))}
    </ul>
  );
}

/** The order is not sent again by it: the site only says what became of it. */
function AskButton({ order, names, store, connection }: OrderProps & { names: readonly string[] }) {
  const [asking, setAsking] = useState(false);
  const ask = async (): Promise<void> => {
    if (asking) return;
    setAsking(true);
    await askOutcomes(store, connection, order, names);
    setAsking(false);
  };
  return (
    <button type="button" class="ask" aria-disabled={asking} aria-label={`${asking ? "Asking for" : "Ask for"} the outcome: ${order.label}, ${namesText(names)}`}
      title="Asks the site what became of the order. Nothing is sent to the vehicle; an order that has not come there is refused from then on."
      onClick={() => void ask()}>
      {asking ? "Asking…" : "Ask for the outcome"}
    </button>
  );
}
