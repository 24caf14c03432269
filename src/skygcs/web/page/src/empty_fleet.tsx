// What the table shows while no vehicle was heard: each link with what came through it, and the next step.

import type { Connection } from "./connection.ts";
import { useStore } from "./hooks.ts";
import { linkHint } from "./link_hints.ts";
import type { LinkState } from "./rpc_types.ts";
import { Failure, usePolled } from "./panels/parts.tsx";
import { countText } from "./format.ts";
import type { Store } from "./store.ts";

export function EmptyFleet({ store, connection }: { store: Store; connection: Connection }) {
  const asks = useStore(store, ({ hello, daemon }) => hello?.replay === false && daemon?.connected === true);
  const links = usePolled(store, connection, asks ? "links.list" : null, {}, 2000);
  return (
    <section class="emptyfleet" aria-label="No vehicle was heard yet">
      <h2>No vehicle was heard yet</h2>
      {asks && links.answer !== null && <ul>{links.answer.map((link) => <LinkRow key={link.name} link={link} />)}</ul>}
      {asks && links.answer?.length === 0 && (
        <p>There are no links. Add one to the fleet file, or for now: <code>skygcs-cli links add radio type=udp_server port=14550</code></p>
      )}
      {asks && <Failure text={links.error} />}
    </section>
  );
}

function LinkRow({ link }: { link: LinkState }) {
  const { bytes, frames, next, bad } = linkHint(link);
  return (
    <li data-link={link.name}>
      <p>
        <b>{link.name}</b> <span class="muted">{link.type.replaceAll("_", " ")}</span>{" "}
        <span class={link.state === "up" ? "good" : link.state === "disabled" ? "muted" : "danger"}>{link.state}</span>{" "}
        <span class="muted">{countText(bytes)} bytes, {countText(frames)} frames received</span>
      </p>
      <p class={bad ? "" : "muted"}>{next}</p>
    </li>
  );
}
