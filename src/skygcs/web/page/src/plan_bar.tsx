// The plan that is being flown, in one line on every page: step, time left, largest error, Pause and Land.

import type { Connection } from "./connection.ts";
import { namesText } from "./format.ts";
import { HoldButton } from "./hold_button.tsx";
import { useStore } from "./hooks.ts";
import { mayOrder, readMessage } from "./panels/calls.ts";
import { runOrder } from "./orders.ts";
import { AT_REST, FAILED, HALTED, largestError, planText } from "./plan_status.ts";
import type { Store } from "./store.ts";
import type { PlanStatus } from "./types.ts";

export function PlanBar({ store, connection }: { store: Store; connection: Connection }) {
  const status = useStore(store, (state) => state.plan);
  const orders = useStore(store, mayOrder);
  if (status === null || AT_REST.has(status.state)) return null;
  const failed = FAILED.has(status.state);
  return (
    <section class="planbar" data-failed={failed} aria-label="Plan in flight">
      <p role={failed ? "alert" : undefined}>
        <b>{status.name ?? "plan"}</b> {planText(status)}
        {failed && status.reason ? `: ${status.reason}` : ""}
      </p>
      <LargestError status={status} />
      {orders && <span class="buttons"><PlanButtons store={store} connection={connection} status={status} /></span>}
    </section>
  );
}

function LargestError({ status }: { status: PlanStatus }) {
  const worst = largestError(status);
  if (worst === null) return null;
  const outside = worst.error_m > worst.tube_m;
  return (
    <p class={outside ? "worst outside" : "worst"}>
      {outside ? "! " : ""}{worst.vehicle} {worst.error_m.toFixed(2)} m off, {worst.tube_m.toFixed(2)} m allowed
    </p>
  );
}

/** Pause or Resume, and Land: also in the plan's own panel. */
export function PlanButtons({ store, connection, status }: { store: Store; connection: Connection; status: PlanStatus }) {
  const targets = status.vehicles.map(({ vehicle }) => vehicle);
  const order = (label: string, method: "plan.pause" | "plan.resume" | "plan.land"): void => void runOrder(store, connection, { label, method, params: {}, targets }, readMessage);
  return (
    <>
      {HALTED.has(status.state) ? (
        <HoldButton targets={targets} what={`Resume the plan of ${namesText(targets)}`} act={() => order("Resume plan", "plan.resume")}>Resume</HoldButton>
      ) : <button type="button" class="primary" onClick={() => order("Pause plan", "plan.pause")}>Pause</button>}
      <button type="button" onClick={() => order("Land the plan's vehicles", "plan.land")}>Land</button>
    </>
  );
}
