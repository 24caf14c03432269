// The radios: how the air is used and planned, what each class and vehicle takes, the radio's own reports over time,
// and what other programs cost.

import type { ComponentChildren } from "preact";
import { useEffect, useReducer, useRef } from "preact/hooks";
import { countText, fixed, percentText } from "../format.ts";
import { Chart } from "./chart.tsx";
import { areThere, ClassRates, fixesText, REPORT_SERIES, reportRow, sourceText, surveyText } from "./radio_figures.ts";
import { HistoryRing } from "./histories.ts";
import { Failure, PlainTable, Scroll, usePolled } from "./parts.tsx";
import type { PanelProps } from "./registry.ts";
import type { CorrectionsStatus, LinkState, RadioAir, RadioUp, RadioVehicle, ThirdPartyShare } from "../rpc_types.ts";

/** Ten minutes at one report a second. */
const REPORT_ROWS = 600;
const MAX_RADIOS = 16;

/** Kept while the page is open: what the radio said an hour ago is not asked for again. */
const kept = new Map<string, { reports: HistoryRing; classes: ClassRates }>();

function keptOf(link: string): { reports: HistoryRing; classes: ClassRates } {
  const known = kept.get(link) ?? { reports: new HistoryRing(REPORT_SERIES.length, REPORT_ROWS), classes: new ClassRates() };
  if (kept.size < MAX_RADIOS) kept.set(link, known);
  return known;
}

export default function RadioPanel({ store, connection }: PanelProps) {
  const radios = usePolled(store, connection, "link.status", {}, 1000);
  const links = usePolled(store, connection, "links.list", {}, 2000);
  const corrections = usePolled(store, connection, "corrections.status", {}, 2000);
  return (
    <div class="panel radiopanel">
      <Failure text={radios.error} />
      {radios.answer?.map((radio) => <RadioView key={`${radio.link} ${radio.peer}`} radio={radio} atMs={radios.atMs} />)}
      {radios.answer?.length === 0 && (
        <p class="note">No link has airtime to show: give the radio's link role = "radio" in the fleet file. Links that are not radios are below.</p>
      )}
      {corrections.answer !== null && areThere(corrections.answer) && <CorrectionsView corrections={corrections.answer} />}
      <Links links={links.answer ?? []} />
      <Failure text={links.error} />
    </div>
  );
}

/** RTK corrections: their source, its survey, and what the vehicles make of them. */
function CorrectionsView({ corrections }: { corrections: CorrectionsStatus }) {
  const source = sourceText(corrections);
  const survey = surveyText(corrections.own_source?.survey);
  return (
    <section class="radio" aria-label="Corrections">
      <h2>Corrections</h2>
      <p class={source.ok ? undefined : "failure"}>{source.text}</p>
      {survey !== null && <p>Base: {survey}</p>}
      <p>Vehicles: {fixesText(corrections)}</p>
    </section>
  );
}

function RadioView({ radio, atMs }: { radio: RadioAir; atMs: number }) {
  const { up, down } = radio;
  const own = keptOf(`${radio.link} ${radio.peer}`);
  const [, redraw] = useReducer((n: number) => n + 1, 0);
  const taken = useRef(0);
  useEffect(() => {
    if (taken.current === atMs) return;
    taken.current = atMs;
    const unix_s = Date.now() / 1000;
    // the first answer brings the last minute with it
    const rows = own.reports.length === 0 ? radio.history : up.radio === null ? [] : [up.radio];
    for (const report of rows) own.reports.add(unix_s - report.age_s, reportRow(report));
    own.classes.take(atMs / 1000, up.classes);
    redraw(0);
  }, [own, radio, up, atMs]);
  return (
    <section class="radio" aria-label={`Radio ${radio.link}`}>
      <header class="row wrap">
        <h2>{radio.link}</h2>
        <span class="muted">{radio.peer}</span>
        {up.round_s !== null && <span class="muted">a round takes {fixed(up.round_s, 2)} s</span>}
        {radio.poor.length > 0 && <span class="failure">degraded: {radio.poor.join(", ")}</span>}
      </header>
      <div class="bars">
        <Bar title="Down: measured" value={down.measured_bytes_per_s} most={down.budget_bytes_per_s} mark={down.planned_bytes_per_s}>
          {bytes(down.measured_bytes_per_s)} of {bytes(down.budget_bytes_per_s)} available, {bytes(down.planned_bytes_per_s)} planned
          {down.factor < 1 ? `, cut to ${percentText(down.factor)} after losses` : ""}
        </Bar>
        <Bar title="Up: sent" value={own.classes.total} most={up.base_bytes_per_s} mark={up.bytes_per_s}>
          {own.classes.total === null ? "–" : bytes(own.classes.total)} of {bytes(up.bytes_per_s)} now, {bytes(up.base_bytes_per_s)} at best, paced by its {up.paced_by}
        </Bar>
      </div>
      <div class="columns">
        <Reports radio={radio} reports={own.reports} />
        <div><Classes classes={up.classes} rates={own.classes} /><Others third={up.third_party} /></div>
      </div>
      <Vehicles vehicles={radio.vehicles} each={down.per_vehicle_bytes_per_s} />
    </section>
  );
}

function Reports({ radio, reports }: { radio: RadioAir; reports: HistoryRing }) {
  if (radio.up.radio === null && reports.length === 0) return <p class="note">The radio reports nothing (RADIO_STATUS): is its MAVLink framing on?</p>;
  const version = reports.version;
  return (
    <div>
      <Chart title="Free buffer, %" curves={[{ label: "txbuf", colour: 1 }]} columns={() => reports.columns([0])} version={version} range={[0, 100]} />
      <Chart
        title="Signal and noise"
        curves={[
          { label: "rssi", colour: 3 },
          { label: "noise", colour: 2 },
          { label: "remote rssi", colour: 7 },
          { label: "remote noise", colour: 4 },
        ]}
        columns={() => reports.columns([1, 2, 3, 4])}
        version={version}
        range={[0, null]}
      />
    </div>
  );
}

/** Counters of a class, and of a channel, by the titles of their columns. */
const COUNTED = [["sent", "sent"], ["bytes", "sent_bytes"], ["waiting", "waiting"], ["replaced", "replaced"], ["dropped", "dropped"], ["refused", "refused"]] as const;
const COUNTERS = [["received", "rx_frames"], ["sent", "tx_frames"], ["dropped", "tx_dropped"], ["bad CRC", "bad_crc"]] as const;

type Row = readonly [string, RadioUp["classes"][string]];

function Classes({ classes, rates }: { classes: RadioUp["classes"]; rates: ClassRates }) {
  const rows = Object.entries(classes).filter(([, one]) => one.waiting + one.sent + one.dropped + one.refused > 0);
  if (rows.length === 0) return <p class="note">Nothing was sent up yet.</p>;
  return (
    <Scroll label="Sent up, by class">
      <PlainTable caption="Sent up, by class" rows={rows} keyOf={([name]) => name} columns={[
        ["class", ([name]) => name.replaceAll("_", " ").toLowerCase()],
        ["B/s", ([name]) => fixed(rates.of(name), 0) ?? "–", "number"],
        ...COUNTED.map(([title, key]) => [title, ([, one]: Row) => countText(one[key]), "number"] as const),
        ["wait p95", ([, one]) => (one.wait_p95_s === null ? "–" : `${fixed(one.wait_p95_s, 2)} s`), "number"],
      ]} />
    </Scroll>
  );
}

function Others({ third }: { third: ThirdPartyShare | null }) {
  if (third === null || third.sources.length === 0) return <p class="note">No other program sends through this radio.</p>;
  return (
    <Scroll label="Other programs">
      <PlainTable caption={<>Other programs: together at most {bytes(third.bytes_per_s)}</>} rows={third.sources} keyOf={(one) => one.source}
        row={(one) => ({ class: one.age_s > 5 ? "lost" : "" })} columns={[
          ["from", (one) => one.source],
          ["sent", (one) => countText(one.sent), "number"],
          ["bytes", (one) => countText(one.sent_bytes), "number"],
          ["held back", (one) => Object.entries(one.counts).map(([what, count]) => `${what.replaceAll("_", " ")} ${countText(count)}`).join(", ") || "nothing"],
        ]} />
    </Scroll>
  );
}

function Vehicles({ vehicles, each }: { vehicles: readonly RadioVehicle[]; each: number }) {
  return (
    <Scroll label="Vehicles on this radio">
      <PlainTable caption={<>Vehicles: a timeslot carries {bytes(each)}</>} rows={[...vehicles].sort((a, b) => a.sysid - b.sysid)} keyOf={(one) => one.name} columns={[
        ["vehicle", (one) => one.name],
        ["used", (one) => <Meter value={one.measured_bytes_per_s} most={each} mark={one.planned_bytes_per_s} />, "barcell"],
        ["B/s", (one) => fixed(one.measured_bytes_per_s, 0) ?? "–", "number"],
        ["planned", (one) => fixed(one.planned_bytes_per_s, 0), "number"],
        ["position Hz", ({ streams: { GLOBAL_POSITION_INT: position } }) => (position === undefined ? "–" : `${fixed(position.measured_hz, 1)} of ${fixed(position.planned_hz, 1)}`), "number"],
        ["loss", (one) => percentText(one.loss) ?? "–", "number"],
        ["round trip", (one) => (one.round_trip_s === null ? "–" : `${fixed(one.round_trip_s, 2)} s`), "number"],
        ["", remarks, "muted"],
      ]} />
    </Scroll>
  );
}

function remarks(one: RadioVehicle): string {
  const words = [one.settled ? "" : "being set up", one.scaled ? "less than requested" : "", one.weight >= 4 ? "flown" : one.weight >= 2 ? "selected" : ""];
  return words.filter(Boolean).join(", ");
}

function Links({ links }: { links: readonly LinkState[] }) {
  return (
    <Scroll label="Links">
      <PlainTable caption="Links" keyOf={({ link, i }) => `${link.name} ${i}`} row={({ link }) => ({ class: link.state === "up" ? "" : "lost" })}
        rows={links.flatMap((link) => (link.channels.length === 0 ? [null] : link.channels.slice(0, 8)).map((channel, i) => ({ link, channel, i })))}
        columns={[
          ["link", ({ link, i }) => (i === 0 ? link.name : "")],
          ["type", ({ link, i }) => (i === 0 ? link.type.replaceAll("_", " ") : "")],
          ["state", ({ link, i }) => (i > 0 ? "" : link.state === "up" ? "up" : `${link.state}${link.last_error === null ? "" : `: ${link.last_error}`}`)],
          ["peer", ({ channel }) => channel?.peer ?? ""],
          ...COUNTERS.map(([title, key]) => [title, ({ channel }: { channel: LinkState["channels"][number] | null }) => countText(counterOf(channel, key)), "number"] as const),
        ]} />
    </Scroll>
  );
}

function counterOf(channel: LinkState["channels"][number] | null, key: string): number | null {
  const value = channel?.counters?.[key] ?? (channel as Readonly<Record<string, unknown>> | null)?.[key];
  return typeof value === "number" ? value : null;
}

function bytes(value: number): string {
  return `${countText(Math.round(value))} B/s`;
}

function Bar({ title, value, most, mark, children }: { title: string; value: number | null; most: number; mark: number; children: ComponentChildren }) {
  return <div class="bar"><span>{title}</span><Meter value={value} most={most} mark={mark} /><span class="muted">{children}</span></div>;
}

/** How much of a budget is used; a line where it is planned to be. */
function Meter({ value, most, mark }: { value: number | null; most: number; mark: number }) {
  const share = (of: number | null): number => (of === null || most <= 0 ? 0 : Math.min(Math.max(of / most, 0), 1) * 100);
  return (
    <span class="meter" role="meter" aria-valuemin={0} aria-valuemax={100} aria-valuenow={Math.round(share(value))} data-full={share(value) > 90}>
      <i style={{ width: `${share(value)}%` }} />
      <em style={{ left: `${share(mark)}%` }} />
    </span>
  );
}
