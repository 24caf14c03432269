// What the selected vehicles hold and where they are in it; start, pause, resume, another item.

import { useState } from "preact/hooks";
import { namesText } from "../format.ts";
import { HoldButton } from "../hold_button.tsx";
import { useStore } from "../hooks.ts";
import { type OrderRequest, runOrder, sendOrder } from "../orders.ts";
import { ask, mayOrder, said } from "./calls.ts";
import { Failure, keepFile, NumberField, PlainTable, Scroll, usePolled, useWork, type FileContent } from "./parts.tsx";
import type { PanelProps } from "./registry.ts";
import type { MissionStatus } from "../rpc_types.ts";
import type { Method } from "../types.ts";

/** Of the selected vehicles; without a selection of none. */
export function useMissionStatus({ store, connection }: PanelProps, targets: readonly string[]): readonly MissionStatus[] {
  const method = targets.length === 0 ? null : "missions.status";
  const { answer } = usePolled(store, connection, method, { targets }, 1000);
  return targets.length === 0 ? [] : (answer ?? []);
}

type FlightProps = PanelProps & { status: readonly MissionStatus[]; targets: readonly string[] };

export function MissionFlight(props: FlightProps & { showDownloaded: (file: FileContent) => void }) {
  const { store, status, targets } = props;
  const orders = useStore(store, mayOrder);
  if (targets.length === 0) return <p class="note">Select the vehicles that are to fly it.</p>;
  return (
    <section class="card" aria-label="On board">
      <h3>On board</h3>
      <Scroll label="Missions on board" tall>
        <PlainTable rows={status} keyOf={(one) => one.vehicle} columns={[
          ["vehicle", (one) => one.vehicle],
          ["state", (one) => <State one={one} />],
          ["item", (one) => one.item ?? "–", "number"],
          ["mission", (one) => one.counts.mission ?? "?", "number"],
          ["fence", (one) => one.counts.fence ?? "?", "number"],
        ]} />
      </Scroll>
      {orders && <Buttons {...props} />}
      {orders && targets.length === 1 && <Download key={targets[0]} {...props} name={targets[0] ?? ""} />}
    </section>
  );
}

function State({ one }: { one: MissionStatus }) {
  if (one.transfer === null) return <>{stateText(one)}</>;
  const percent = one.transfer.percent ?? 0;
  return <>{one.transfer.what} {percent} %<progress max={100} value={percent} aria-label={`Transfer of ${one.vehicle}`} /></>;
}

function Buttons({ store, connection, status, targets }: FlightProps) {
  const [item, setItem] = useState<number | null>(null);
  const order = <M extends Method>(label: string, method: M, params: OrderRequest<M>["params"]): void => void sendOrder(store, connection, { label, method, params, targets });
  const whom = namesText(targets);
  return (
    <div class="row wrap">
      <HoldButton targets={targets} what={`Start the mission of ${whom}: arms`} act={() => order("Start mission", "missions.start", {})}>
        Start
      </HoldButton>
      {targets.length > 1 && (
        <HoldButton targets={targets} what={`Start the missions of ${whom} one after another: arms`} act={() => order("Start missions one after another", "missions.start", { one_after_another: true })}>
          One after another
        </HoldButton>
      )}
      {status.some(({ turn }) => turn !== null) && (
        <button type="button" onClick={() => void runOrder(store, connection, { label: "End the turns", method: "missions.end_turns", params: {}, targets }, readEnded)}>
          End the turns
        </button>
      )}
      <button type="button" onClick={() => order("Pause mission", "missions.pause", {})}>Pause</button>
      <HoldButton targets={targets} what={`Resume the mission of ${whom}`} act={() => order("Resume mission", "missions.resume", {})}>Resume</HoldButton>
      <NumberField label="Item" value={item} least={1} most={65535} step={1} onValue={setItem} />
      <HoldButton targets={targets} what={`Send ${whom} to item ${item ?? "?"}`} disabled={item === null} act={() => item !== null && order(`Go to item ${item}`, "missions.set_current", { item })}>
        Go to it
      </HoldButton>
      <HoldButton danger targets={targets} what={`Delete the mission of ${whom}`} act={() => order("Delete mission", "missions.clear", { lists: ["mission"] })}>
        Delete mission
      </HoldButton>
      <HoldButton danger targets={targets} what={`Delete the fence of ${whom}`} act={() => order("Delete fence", "missions.clear", { lists: ["fence"] })}>
        Delete fence
      </HoldButton>
    </div>
  );
}

/** "active", or the turn of one that waits for others. */
function stateText({ state, turn }: MissionStatus): string {
  if (turn === null || turn.state === "done") return state ?? "unknown";
  return turn.state === "waits" ? `waits, turn ${turn.turn} of ${turn.of}` : `${state ?? "flies"}, turn ${turn.turn} of ${turn.of}`;
}

function readEnded({ ended }: { ended: boolean }): ReturnType<typeof said> {
  return said(ended, "no missions were flown one after another");
}

function Download(props: PanelProps & { name: string; showDownloaded: (file: FileContent) => void }) {
  const { name, showDownloaded } = props;
  const { busy, answer: file, error, run } = useWork<FileContent>();
  const read = async (): Promise<void> => {
    const found = await run(() => downloaded(props, name));
    if (found !== null) showDownloaded(found);
  };
  return (
    <div class="row wrap">
      <button type="button" disabled={busy} onClick={() => void read()}>{busy ? "Reading …" : `Read from ${name}`}</button>
      {file !== null && <button type="button" onClick={() => keepFile(file.name, file.text ?? "")}>Save to file</button>}
      <Failure text={error} />
    </div>
  );
}

/** Reads what a vehicle holds, as a file. */
async function downloaded({ store, connection }: PanelProps, name: string): Promise<FileContent> {
  const answer = await ask(store, connection, "missions.download", { target: name });
  if (answer.plan === null) throw new Error(answer.outcome.message);
  return { name: `${name}.plan`, text: answer.plan };
}
