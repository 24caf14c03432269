// The recordings of the station: which there are, and a page that replays one.

import { useState } from "preact/hooks";
import { useStore } from "../hooks.ts";
import { runOrder } from "../orders.ts";
import { mayOrder } from "./calls.ts";
import { Failure, PlainTable, Scroll, usePolled, type PlainColumn } from "./parts.tsx";
import type { RecordingsList } from "../rpc_types.ts";
import type { PanelProps } from "./registry.ts";
import { clockText } from "./replay_time.ts";

const EVERY_MS = 5_000;
/** The page of a replay is served on the station's own computer alone. */
const LOOPBACK = new Set(["localhost", "127.0.0.1", "[::1]"]);


export default function RecordingsPanel({ store, connection }: PanelProps) {
  const { answer, error, again } = usePolled(store, connection, "recordings.list", {}, EVERY_MS);
  const orders = useStore(store, mayOrder);
  const [opened, setOpened] = useState<{ name: string; address: string } | null>(null);
  const [starting, setStarting] = useState<string | null>(null);
  const replay = async (name: string): Promise<void> => {
    setStarting(name);
    setOpened(await runOrder(store, connection, { label: `Replay ${name}`, method: "recordings.replay", params: { name }, targets: [] }));
    setStarting(null);
    again();
  };
  const end = async (): Promise<void> => {
    setOpened(null);
    await runOrder(store, connection, { label: "End the replay", method: "recordings.end", params: {}, targets: [] });
    again();
  };
  if (answer === null) return error === null ? <p class="note">Asking …</p> : <Failure text={error} />;
  const near = LOOPBACK.has(location.hostname);
  return (
    <div class="panel recordings">
      <h2>Recordings</h2>
      <p class="muted">{answer.folder}. A replay is a page of its own, on the station's computer; nothing can be ordered on it.</p>
      {!near && <p class="note">This browser is on another computer: open replays in a browser of the station.</p>}
      {answer.replays !== null && (
        <section class="card" aria-label="Replay">
          <p><b>{answer.replays}</b> is replayed.</p>
          <div class="row wrap">
            {opened !== null && opened.name === answer.replays && <a class="open" href={opened.address} target="_blank" rel="noopener">Open the replay</a>}
            {orders && opened === null && <button type="button" disabled={starting !== null} onClick={() => void replay(answer.replays ?? "")}>Get an address of it</button>}
            {orders && <button type="button" onClick={() => void end()}>End the replay</button>}
          </div>
        </section>
      )}
      <Failure text={error} />
      {answer.recordings.length === 0 ? <p class="note">There are none yet.</p> : (
        <Scroll label="List of recordings">
          <PlainTable rows={answer.recordings} keyOf={(one) => one.name} columns={[
            ["begun", (one) => new Date((one.begun_unix_s ?? one.ended_unix_s) * 1000).toLocaleString([], { hour12: false })],
            ["length", (one) => (one.begun_unix_s === null ? "–" : clockText(one.ended_unix_s - one.begun_unix_s).replace(/\.\d$/, "")), "number"],
            ["size", (one) => `${(one.bytes / 1e6).toFixed(1)} MB`, "number"],
            ...(orders ? [[<span class="unseen">Replay</span>, (one) => (
              <button type="button" aria-label={`Replay ${one.name}`} disabled={starting !== null} onClick={() => void replay(one.name)}>{starting === one.name ? "Replay starts …" : "Replay"}</button>
            )] satisfies PlainColumn<RecordingsList["recordings"][number]>] : []),
            ["file", (one) => one.name],
          ]} />
        </Scroll>
      )}
      {answer.left_out > 0 && <p class="muted">{answer.left_out} older ones are not listed.</p>}
    </div>
  );
}
