// The page: top bar with STOP, banners, the fleet with its panels, other pages, and on phones one pane at a time.

import { useEffect, useLayoutEffect, useMemo, useState } from "preact/hooks";
import type { Connection } from "./connection.ts";
import { FleetCanvas } from "./fleet_canvas.tsx";
import { useChanges, useStore, useWindowEvent } from "./hooks.ts";
import { LateModule } from "./late_module.ts";
import { OrdersPanel } from "./orders_panel.tsx";
import { OrderList } from "./order_list.tsx";
import { PANELS } from "./panels/index.ts";
import type { Panel, PanelProps } from "./panels/registry.ts";
import { DrillBar } from "./drill_bar.tsx";
import { PlanBar } from "./plan_bar.tsx";
import { Banner, FleetSummary, ThemeButton, TroubleStrip } from "./status_bar.tsx";
import { recalledShare } from "./split.ts";
import { Splitter } from "./splitter.tsx";
import { StopBoard, StopButton } from "./stop.tsx";
import type { State, Store } from "./store.ts";
import { FleetTable } from "./table.tsx";
import { FleetView } from "./view/fleet_view.ts";
import { Shortcuts } from "./shortcuts.tsx";

const FLEET = "fleet";

export function App({ store, connection }: { store: Store; connection: Connection }) {
  const view = useMemo(() => {
    const made = new FleetView(store);
    Object.assign(globalThis, { skygcs: { store, connection, view: made } }); // for tests and the benchmark
    return made;
  }, [store, connection]);
  useLayoutEffect(() => loadPanelsWhenIdle(store, connection), [store, connection]);
  const [page, go] = usePage();
  const shown = useStore(store, (state) => visiblePanels(state).map((panel) => panel.id).join(" "));
  const panels = PANELS.filter((panel) => shown.split(" ").includes(panel.id));
  const open = panels.find((panel) => panel.id === page && panel.place === "page");
  const props = { store, connection, view };
  return (
    <div class="app">
      <a class="skip" href="#main">Skip to the fleet</a>
      <header class="top">
        <h1 class="unseen">skygcs</h1>
        <span class="brand" aria-hidden="true"><svg viewBox="0 0 24 24" width="22" height="22"><path d="M12 2 20 21 12 17 4 21z" /></svg>skygcs</span>
        <nav class="pages" aria-label="Pages">
          <PageTab id={FLEET} title="Fleet" now={open === undefined} go={go} />
          {panels.filter((panel) => panel.place === "page").map((panel) => (
            <PageTab key={panel.id} id={panel.id} title={panel.title} now={panel === open} go={go} badge={<Badge store={store} panel={panel} />} />
          ))}
        </nav>
        <FleetSummary store={store} />
        <ThemeButton />
        <Shortcuts store={store} view={view} />
        <TroubleStrip store={store} view={view} />
        <StopButton store={store} connection={connection} />
      </header>
      <StopBoard store={store} />
      <PlanBar store={store} connection={connection} />
      <DrillBar store={store} connection={connection} />
      <Banner store={store} connection={connection} />
      {panels.filter((panel) => panel.place === "dock").map((panel) => (
        <section key={panel.id} class="dock" aria-label={panel.title}><LazyPanel panel={panel} {...props} /></section>
      ))}
      <main id="main" class={open === undefined ? "main" : "main paged"}>
        <Fleet hidden={open !== undefined} sides={panels.filter((panel) => panel.place === "side")} {...props} />
        {open !== undefined && <section class="page" aria-label={open.title}><LazyPanel key={open.id} panel={open} {...props} /></section>}
      </main>
      <OrderList store={store} connection={connection} />
    </div>
  );
}

function visiblePanels(state: State): Panel[] {
  return PANELS.filter((panel) => panel.when === undefined || panel.when(state));
}

/** The page named after # in the address: a reload and the back button keep it. */
function usePage(): [string, (id: string) => void] {
  const read = (): string => location.hash.slice(1) || FLEET;
  const [page, setPage] = useState(read);
  useWindowEvent("hashchange", () => setPage(read()));
  return [page, (id) => { location.hash = id; }];
}

function PageTab({ id, title, now, go, badge }: { id: string; title: string; now: boolean; go: (id: string) => void; badge?: preact.ComponentChildren }) {
  return <button type="button" class="tab" aria-current={now ? "page" : undefined} onClick={() => go(id)}>{title}{badge}</button>;
}

function Badge({ store, panel }: { store: Store; panel: Panel }) {
  const count = useStore(store, (state) => panel.badge?.(state) ?? 0);
  return count === 0 ? null : <span class="badge">{count > 99 ? "99+" : count}</span>;
}

/** The panes of a phone's bottom bar; on a wide screen all of them are there at once. */
const VIEW = "view";
const TABLE = "table";
const ORDERS = "orders";

function Fleet({ hidden, sides, ...props }: PanelProps & { hidden: boolean; sides: readonly Panel[] }) {
  const { store } = props;
  const [pane, setPane] = useState(TABLE);
  const [side, setSide] = useState(ORDERS);
  const [share, setShare] = useState(recalledShare);
  const panel = sides.find((one) => one.id === side);
  const openSide = (id: string): void => {
    setSide(id);
    setPane(id);
  };
  return (
    <div class="fleet" hidden={hidden} data-pane={pane === VIEW || pane === TABLE ? pane : "side"} data-shared={share !== null}
      style={{ "--table-share": share === null ? null : `${share}%` }}>
      <section class="viewpane" aria-label="Fleet view"><FleetCanvas {...props} /></section>
      <Splitter share={share} onShare={setShare} />
      <section class="tablepane" aria-label="Fleet table"><FleetTable store={store} connection={props.connection} /></section>
      <aside class="sidepane" aria-label="Orders and panels">
        <div class="tabs" role="tablist" aria-label="Panels">
          <SideTab id={ORDERS} title="Orders" now={panel === undefined} open={openSide} />
          {sides.map((one) => (
            <SideTab key={one.id} id={one.id} title={one.title} now={one === panel} open={openSide} badge={<Badge store={store} panel={one} />} />
          ))}
        </div>
        <div class="sidebody" role="tabpanel" aria-label={panel?.title ?? "Orders"}>
          <h2 class="unseen">{panel?.title ?? "Orders"}</h2>
          {panel === undefined ? <OrdersPanel {...props} /> : <LazyPanel key={panel.id} panel={panel} {...props} />}
        </div>
      </aside>
      <nav class="bottom" aria-label="Panes">
        {[[VIEW, "View"], [TABLE, "Table"], [ORDERS, "Orders"], ...sides.map((one) => [one.id, one.title])].map(([id = "", title = ""]) => (
          <button key={id} type="button" class="tab" aria-current={pane === id ? "true" : undefined}
            onClick={() => (id === VIEW || id === TABLE ? setPane(id) : openSide(id))}>
            {title}
          </button>
        ))}
      </nav>
    </div>
  );
}

function SideTab({ id, title, now, open, badge }: { id: string; title: string; now: boolean; open: (id: string) => void; badge?: preact.ComponentChildren }) {
  return <button type="button" role="tab" class="tab" aria-selected={now} onClick={() => open(id)}>{title}{badge}</button>;
}

type Components = typeof import("./panels/components.ts");

/** For the life of the page: another tab must not begin with "Loading …". */
const components = new LateModule<Components>(() => import("./panels/components.ts"));

function loadPanels(connection: Connection): void {
  void components.ask(() => connection.call("web.ping").then(() => true, () => false));
}

/** Loads them when the page is connected and idle: a link that breaks later leaves them there. What failed is tried again with
 *  each new connection. */
function loadPanelsWhenIdle(store: Store, connection: Connection): () => void {
  return store.onAction((action) => {
    if (action.type !== "hello") return;
    const load = (): void => loadPanels(connection);
    if ("requestIdleCallback" in globalThis) requestIdleCallback(load);
    else setTimeout(load); // Safari
  });
}

/** A panel; the components of all are one module. */
function LazyPanel({ panel, ...props }: PanelProps & { panel: Panel }) {
  const { connection } = props;
  useChanges(components);
  useEffect(() => loadPanels(connection), [connection]);
  const { loaded, trouble } = components;
  if (loaded !== null) {
    const Component = loaded[panel.id];
    return <Component {...props} />;
  }
  if (trouble === null) return <p class="note">Loading …</p>;
  return (
    <div class="note" role="alert">
      <p>
        This part of the page could not be loaded
        {trouble === "refused"
          ? ": the ground station has another version of the page by now. Reload the page."
          : ". It is tried again with the next connection; do not reload the page before, it would be gone with its STOP."}
      </p>
      <button type="button" onClick={() => loadPanels(connection)}>Try again</button>
    </div>
  );
}
