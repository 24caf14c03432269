// Parameters of one vehicle: search, edits that wait, a file to compare with. Nothing is set before a person says so,
// and a list that is on its way blocks nothing.

import { useRef, useState } from "preact/hooks";
import { HoldButton } from "../hold_button.tsx";
import { useChanges, useStore } from "../hooks.ts";
import { refusalText, runOrder } from "../orders.ts";
import { ask, mayOrder, readParams } from "./calls.ts";
import { Check, contentOf, DropZone, Failure, keepFile, PlainTable, useAsk, usePolled } from "./parts.tsx";
import { aboutText, matches, meaningText, outsideText, type ParamBook, paramBooks, parseValue, rangeText, sameValue, valueText } from "./param_values.ts";
import type { VehicleProps } from "./vehicle_panel.tsx";
import type { ParamDescription, ParamEntry, ParamResults, ParamStatus } from "../rpc_types.ts";

const SHOWN = 150;

export interface ParamsDifference {
  name: string;
  entries: number;
  same: number;
  changes: readonly { name: string; value: number; before: number | null; sort: string }[];
  skipped: readonly (readonly [string, string])[];
  unknown: readonly string[];
  problems: readonly string[];
  warnings: readonly string[];
}

export function VehicleParams(props: VehicleProps) {
  const { store, connection, name } = props;
  const orders = useStore(store, mayOrder);
  const book = useBook(name);
  const [search, setSearch] = useState("");
  const [onlyChanged, setOnlyChanged] = useState(false);
  const keep = (change: (book: ParamBook) => ParamBook): void => paramBooks.change(name, change);
  const read = (): Promise<void> => readList(props, keep);
  const cancel = (): Promise<void> => cancelList(props, keep);
  const { answer: status } = usePolled(store, connection, "params.status", { targets: [name] }, book.reading ? 500 : 5000);
  const loading = status?.[name]?.loading ?? null;
  const shown = book.params.filter((one) => matches(one.name, search) && (!onlyChanged || book.edits.has(one.name) || book.setHere.has(one.name)));
  return (
    <>
      <div class="row">
        <button type="button" class={book.params.length === 0 ? "primary" : ""} disabled={!orders || book.reading} onClick={() => void read()}>
          {book.reading ? "Reading …" : book.params.length === 0 ? "Read all" : "Read again"}
        </button>
        {book.reading && <button type="button" onClick={() => void cancel()}>Cancel</button>}
        {book.params.length > 0 && (
          <button type="button" onClick={() => keepFile(`${name}.param`, book.params.map((one) => `${one.name},${valueText(one.value)}\n`).join(""))}>
            Save to file
          </button>
        )}
        <span class="muted">{progressText(loading, book.params.length)}</span>
      </div>
      {loading !== null && <progress max={100} value={loading.percent ?? 0} aria-label="Parameters read" />}
      <Failure text={book.failure} />
      {!orders && book.params.length === 0 && <p class="note">This address may only look, and parameters are asked for over the radio.</p>}
      {book.params.length > 0 && (
        <>
          <div class="row">
            <input type="search" placeholder="Search: words, or MPC_*" aria-label="Search parameters" value={search} onInput={(event) => setSearch(event.currentTarget.value)} />
            <Check checked={onlyChanged} onChecked={setOnlyChanged}>changed</Check>
          </div>
          <Edits {...props} book={book} keep={keep} enabled={orders} />
          <FileDifference {...props} book={book} keep={keep} />
          <ParamTable book={book} rows={shown} keep={keep} enabled={orders} />
          {book.source !== "" && <p class="muted">Units and ranges: {book.source}</p>}
        </>
      )}
    </>
  );
}

function progressText(loading: ParamStatus["loading"], known: number): string {
  if (loading === null) return known === 0 ? "" : `${known} parameters`;
  const rest = loading.remaining_s === null ? "" : `, ${Math.ceil(loading.remaining_s)} s left`;
  return `${loading.received} of ${loading.count ?? "?"}${rest}`;
}

/** The book of a vehicle; the component is drawn again when it changed, by whomever: a list that was asked for before the
 * panel was closed comes into the book all the same. */
function useBook(name: string): ParamBook {
  useChanges(paramBooks);
  return paramBooks.of(name);
}

type Keep = (change: (book: ParamBook) => ParamBook) => void;

/** Asks for all parameters; the list comes when it is whole: minutes over a slow radio. */
async function readList({ store, connection, name }: VehicleProps, keep: Keep): Promise<void> {
  keep((book) => ({ ...book, reading: true, failure: null }));
  try {
    const found = (await ask(store, connection, "params.list", { targets: [name] })).lists[name];
    const failure = found === undefined || !found.ok ? found?.message ?? "no answer for this vehicle" : null;
    keep((book) => ({ ...book, reading: false, failure }));
    if (found !== undefined && found.params !== null && found.params.length > 0) {
      const { params, sysid, compid, autopilot } = found;
      keep((book) => ({ ...book, params: [...params].sort((a, b) => a.name.localeCompare(b.name)), sysid, compid, autopilot }));
      await readMetadata({ store, connection, name }, params.map((one) => one.name), keep);
    }
  } catch (failed) {
    keep((book) => ({ ...book, reading: false, failure: refusalText(failed) }));
  }
}

/** The daemon's limit of names in one request. */
const MOST_NAMES = 2000;

/** Units, ranges and descriptions of what is shown; without them the values are shown all the same. */
async function readMetadata({ store, connection, name }: Pick<VehicleProps, "store" | "connection" | "name">, names: readonly string[], keep: Keep): Promise<void> {
  const request = { targets: [name], names: names.slice(0, MOST_NAMES) };
  const found = (await ask(store, connection, "params.metadata", request)).vehicles[name];
  if (found !== undefined) keep((book) => ({ ...book, metadata: found.parameters, source: found.source }));
}

async function cancelList({ store, connection, name }: VehicleProps, keep: Keep): Promise<void> {
  try {
    await ask(store, connection, "params.cancel", { targets: [name] });
  } catch (failed) {
    keep((book) => ({ ...book, failure: refusalText(failed) }));
  }
}

// --- edits ------------------------------------------------------------------------------------------------------------

function Edits({ store, connection, name, book, keep, enabled }: VehicleProps & { book: ParamBook; keep: (change: (book: ParamBook) => ParamBook) => void; enabled: boolean }) {
  const [busy, setBusy] = useState(false);
  const [insisting, setInsisting] = useState(false);
  if (book.edits.size === 0) return null;
  const outside = [...book.edits].filter(([param, value]) => outsideText(value, book.metadata[param], book.autopilot) !== null);
  const force = insisting && outside.length > 0;
  const apply = async (): Promise<void> => {
    setBusy(true);
    const params = Object.fromEntries(book.edits);
    const label = book.edits.size === 1 ? `Set ${[...book.edits.keys()].join()}` : `Set ${book.edits.size} parameters`;
    const request = { label, method: "params.set" as const, params: { targets: [name], params, force }, targets: [name] };
    const answer = await runOrder(store, connection, request, ({ outcomes }) => readParams(outcomes[name] ?? {}));
    const outcomes = answer?.outcomes[name];
    if (outcomes !== undefined) keep((before) => afterSet(before, outcomes));
    setInsisting(false);
    setBusy(false);
  };
  return (
    <section class="card edits" aria-label="Changes that wait">
      <ul>
        {[...book.edits].map(([param, value]) => (
          <li key={param}>
            <code>{param}</code> {valueText(book.params.find((one) => one.name === param)?.value ?? null)} → <b>{valueText(value)}</b>
            {outsideText(value, book.metadata[param], book.autopilot) !== null && (
              <small class="failure"> {outsideText(value, book.metadata[param], book.autopilot)}</small>
            )}
            {book.metadata[param]?.reboot === true && <small class="muted"> takes effect after a reboot</small>}
            <button
              type="button"
              class="quiet"
              aria-label={`Leave ${param} as it is`}
              onClick={() => keep((before) => ({ ...before, edits: new Map([...before.edits].filter(([one]) => one !== param)) }))}
            >
              ×
            </button>
          </li>
        ))}
      </ul>
      {outside.length > 0 && <Check checked={insisting} onChecked={setInsisting}>set what is outside its range all the same</Check>}
      <div class="row">
        <HoldButton targets={[name]} what={`Set ${book.edits.size} parameters of ${name}`} disabled={!enabled || busy} act={() => void apply()}>
          {busy ? "Setting …" : `Set ${book.edits.size}`}
        </HoldButton>
        <button type="button" onClick={() => keep((before) => ({ ...before, edits: new Map() }))}>Discard</button>
      </div>
    </section>
  );
}

/** What the vehicle now reports takes the place of what was known; what it took is no edit any more. */
function afterSet(book: ParamBook, outcomes: ParamResults["outcomes"][string]): ParamBook {
  const edits = new Map([...book.edits].filter(([param]) => outcomes[param]?.ok !== true));
  const setHere = new Set([...book.setHere, ...Object.keys(outcomes).filter((param) => outcomes[param]?.ok === true)]);
  const params = book.params.map((one) => ({ ...one, value: outcomes[one.name]?.value ?? one.value }));
  return { ...book, edits, setHere, params };
}

function ParamTable({ book, rows, keep, enabled }: { book: ParamBook; rows: readonly ParamEntry[]; keep: (change: (book: ParamBook) => ParamBook) => void; enabled: boolean }) {
  const [most, setMost] = useState(SHOWN);
  const edit = (param: ParamEntry, value: number | null): void =>
    keep((before) => {
      const edits = new Map(before.edits);
      if (value === null || sameValue(value, param.value)) edits.delete(param.name);
      else edits.set(param.name, value);
      return { ...before, edits };
    });
  return (
    <>
      <PlainTable class="params" rows={rows.slice(0, most)} keyOf={(one) => one.name}
        row={(one) => ({ "data-changed": book.edits.has(one.name) ? "waits" : book.setHere.has(one.name) ? "set" : undefined })} columns={[
          ["parameter", (one) => (
            <span title={aboutText(book.metadata[one.name])}>
              <code>{one.name}</code>
              <Meaning value={book.edits.get(one.name) ?? one.value} known={book.metadata[one.name]} autopilot={book.autopilot} />
            </span>
          )],
          ["value", (one) => (enabled ? <ValueField param={one} known={book.metadata[one.name]} edited={book.edits.get(one.name)} edit={edit} /> : valueText(one.value)), "number"],
          ["unit", (one) => book.metadata[one.name]?.unit ?? "", "muted"],
        ]} />
      {rows.length === 0 && <p class="note">No parameter of that name.</p>}
      {rows.length > most && <button type="button" onClick={() => setMost(most + SHOWN)}>{rows.length - most} more</button>}
    </>
  );
}

/** What the value means, or that it is outside its range. */
function Meaning({ value, known, autopilot }: { value: number | null; known: ParamDescription | undefined; autopilot: string }) {
  if (value === null || known === undefined) return null;
  const outside = outsideText(value, known, autopilot);
  if (outside !== null) return <small class="failure"> {outside}</small>;
  const meaning = meaningText(value, known);
  return meaning === null ? null : <small class="muted"> {meaning}</small>;
}

function ValueField({ param, known, edited, edit }: { param: ParamEntry; known: ParamDescription | undefined; edited: number | undefined; edit: (param: ParamEntry, value: number | null) => void }) {
  const [typed, setTyped] = useState<string | null>(null);
  const [problem, setProblem] = useState<string | null>(null);
  const take = (text: string): void => {
    const parsed = parseValue(text, param.type);
    setProblem(parsed.ok ? null : parsed.problem);
    if (!parsed.ok) return;
    setTyped(null);
    edit(param, parsed.value);
  };
  return (
    <>
      <input
        class="value"
        aria-label={`${param.name}: ${rangeText(param.type)}`}
        aria-invalid={problem !== null}
        title={[aboutText(known), rangeText(param.type)].filter((text) => text !== "").join("; ")}
        inputMode="decimal"
        value={typed ?? valueText(edited ?? param.value)}
        onInput={(event) => setTyped(event.currentTarget.value)}
        onKeyDown={(event) => {
          if (event.key === "Enter") take(event.currentTarget.value);
          if (event.key === "Escape") {
            setTyped(null);
            setProblem(null);
          }
        }}
        onBlur={(event) => {
          if (typed !== null) take(event.currentTarget.value);
        }}
      />
      {problem !== null && <small class="failure">{problem}</small>}
    </>
  );
}

// --- a file -----------------------------------------------------------------------------------------------------------

function FileDifference({ store, connection, book, keep }: VehicleProps & { book: ParamBook; keep: (change: (book: ParamBook) => ParamBook) => void }) {
  const check = useAsk<ParamsDifference>(store, connection, "web.params.check");
  const latest = useRef(book);
  latest.current = book;
  const compare = async ([file]: File[]): Promise<object> => {
    const { params, sysid, compid, autopilot } = latest.current;
    return { file: file === undefined ? null : await contentOf(file), params, sysid, compid, autopilot };
  };
  const found = check.answer;
  return (
    <>
      <DropZone label="Compare with a file" accept=".params,.param,.parm,.txt" onFiles={(files) => void check.run(compare(files))} />
      <Failure text={check.error} />
      {found !== null && (
        <section class="card" aria-label={`Compared with ${found.name}`}>
          <header class="row"><h3>{found.name}</h3><button type="button" class="quiet" aria-label="Close" onClick={check.clear}>×</button></header>
          <p class="muted">{found.changes.length} of {found.entries} differ, {found.same} are the same</p>
          {[...found.warnings, ...found.problems].map((text) => <p key={text} class="failure">{text}</p>)}
          {found.unknown.length > 0 && <p class="muted">{found.unknown.length} that the vehicle does not have: {found.unknown.slice(0, 8).join(", ")}</p>}
          {found.skipped.length > 0 && <p class="muted">{found.skipped.length} that belong to one vehicle are left out: calibration, statistics, identity</p>}
          <PlainTable rows={found.changes} keyOf={(change) => change.name} columns={[
            ["parameter", (change) => <code>{change.name}</code>],
            ["vehicle", (change) => valueText(change.before), "number"],
            ["file", (change) => <b>{valueText(change.value)}</b>, "number"],
          ]} />
          {found.changes.length > 0 && (
            <button
              type="button"
              onClick={() => {
                keep((before) => ({ ...before, edits: new Map([...before.edits, ...found.changes.map((change) => [change.name, change.value] as const)]) }));
                check.clear();
              }}
            >
              Take over {found.changes.length === 1 ? "1 value" : `${found.changes.length} values`}
            </button>
          )}
        </section>
      )}
    </>
  );
}
