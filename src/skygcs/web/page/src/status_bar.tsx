// What the top bar says of fleet and connection, a pill for each vehicle in trouble, and the banners of what is wrong.

import { useState } from "preact/hooks";
import { fleetFigures } from "./columns.ts";
import type { Connection } from "./connection.ts";
import { ageText } from "./format.ts";
import { useSlowState, useStore, useTick } from "./hooks.ts";
import { serverNowS, type Store } from "./store.ts";
import { setTheme, theme, type Theme } from "./theme.ts";
import { type Trouble, troublesOf } from "./trouble.ts";
import type { FleetView } from "./view/fleet_view.ts";

export function FleetSummary({ store }: { store: Store }) {
  const { state, nowMs } = useSlowState(store, 500);
  const { vehicles, armed, inAir, failsafe, silent, silentInAir } = fleetFigures([...state.vehicles.values()], serverNowS(state, nowMs));
  return (
    <p class="summary">
      <Figure count={vehicles} word={vehicles === 1 ? "vehicle" : "vehicles"} />
      {state.sites.length > 1 && <Figure count={state.sites.length} word="sites" />}
      <Figure count={armed} word="armed" />
      <Figure count={inAir} word="in the air" />
      {failsafe > 0 && <Figure count={failsafe} word="failsafe" tone="danger" />}
      {silent > 0 && <Figure count={silent} word="not heard" more={silentInAir > 0 ? `, ${silentInAir} last in the air` : ""} tone="warning" />}
    </p>
  );
}

function Figure({ count, word, more, tone }: { count: number; word: string; more?: string; tone?: string }) {
  return <span class={tone === undefined ? "figure" : `figure ${tone}`}><b>{count}</b> {word}<span class="more">{more}</span></span>;
}

const NAMES: Record<Theme, string> = { system: "System", dark: "Dark", daylight: "Daylight" };
const NEXT: Record<Theme, Theme> = { system: "dark", dark: "daylight", daylight: "system" };

export function ThemeButton() {
  const [now, setNow] = useState(theme);
  return (
    <button type="button" class="quiet theme" title={`Colours: ${NAMES[now]}; next: ${NAMES[NEXT[now]]}`} aria-label={`Colours: ${NAMES[now]}`}
      onClick={() => { setTheme(NEXT[now]); setNow(NEXT[now]); }}>
      <svg viewBox="0 0 24 24" width="18" height="18" aria-hidden="true">
        <circle cx="12" cy="12" r="8" fill="none" stroke="currentColor" stroke-width="2" />
        <path d="M12 4a8 8 0 0 1 0 16z" fill="currentColor" />
      </svg>
    </button>
  );
}

/** One line for each thing that is wrong with what is shown; nothing while all is well. */
export function Banner({ store, connection }: { store: Store; connection: Connection }) {
  const phase = useStore(store, (state) => state.phase);
  const daemon = useStore(store, (state) => state.daemon);
  const hello = useStore(store, (state) => state.hello);
  useTick(1000);
  const state = store.state;
  if (phase.kind === "lost" || (phase.kind === "connecting" && hello !== null)) {
    const heard = state.clock === null ? null : (performance.now() - state.clock.atMs) / 1000;
    return (
      <div class="banner danger" role="alert">
        <span><b>Not connected.</b> {phase.kind === "lost" ? `${sentence(phase.reason)}. ` : ""}
          {heard !== null && `What is shown is ${ageText(heard)} old. `}Orders are not sent.</span>
        <button type="button" onClick={() => connection.retryNow()}>Connect now</button>
      </div>
    );
  }
  if (phase.kind === "connecting") return <div class="banner" role="status">Connecting …</div>;
  if (daemon !== null && (daemon.slow || !daemon.connected)) {
    return (
      <div class="banner danger" role="alert">
        <span><b>{daemon.slow ? "Slow daemon" : "No daemon"} for {ageText(serverNowS(state, performance.now()) - daemon.since_s)}.</b>{" "}
          {sentence(daemon.text)}. {daemon.slow ? "It refuses orders that it reads too late." : "Orders are not sent."}</span>
      </div>
    );
  }
  if (daemon?.note != null) return <div class="banner" role="status">{daemon.note}.</div>;
  if (hello?.replay === true) return null;
  if (hello?.role === "view") return <div class="banner" role="status">This address may only look: no orders.</div>;
  return null;
}

function sentence(text: string): string {
  return text.slice(0, 1).toUpperCase() + text.slice(1).replace(/\.$/, "");
}

/** Pills that there is room for; CSS shows the first one alone where there is room for no more. */
const MOST_SHOWN = 3;

const MARKS = { danger: "!", warning: "?" } as const;

export function TroubleStrip({ store, view }: { store: Store; view: FleetView }) {
  const { state, nowMs } = useSlowState(store, 500);
  if (state.hello?.replay === true) return null;
  const found = troublesOf([...state.vehicles.values()], serverNowS(state, nowMs));
  if (found.length === 0) return null;
  const show = (names: readonly string[]): void => {
    store.dispatch({ type: "select", names, how: "only" });
    location.hash = "fleet";
    view.fit("selected");
  };
  const all = found.map(({ name }) => name);
  const more = (shown: number, where: string) => found.length > shown && (
    <button type="button" class={`pill more ${where}`} title={`Select all ${found.length} vehicles in trouble`} onClick={() => show(all)}>
      +{found.length - shown} more
    </button>
  );
  return (
    <section class="troubles" aria-label="Vehicles in trouble">
      {found.slice(0, MOST_SHOWN).map((trouble) => <Pill key={trouble.name} trouble={trouble} show={show} />)}
      {more(MOST_SHOWN, "wide")}
      {more(1, "narrow")}
    </section>
  );
}

function Pill({ trouble: { name, severity, text }, show }: { trouble: Trouble; show: (names: readonly string[]) => void }) {
  return (
    <button type="button" class="pill" data-severity={severity} title={`${name}: ${text}`} onClick={() => show([name])}>
      <span class="mark" aria-hidden="true">{MARKS[severity]}</span> <b>{name}</b> {text}
    </button>
  );
}
