// What several panels use: answers that are asked for again and again, files that are dropped, small pieces of text.

import type { ComponentChildren } from "preact";
import { useCallback, useEffect, useRef, useState } from "preact/hooks";
import type { Connection } from "../connection.ts";
import { ageText } from "../format.ts";
import { Changes, useChanges } from "../hooks.ts";
import { refusalText } from "../orders.ts";
import type { Store } from "../store.ts";
import type { Method, OwnMethod, Params, Results } from "../types.ts";
import type { Tool } from "../view/overlays.ts";
import type { FleetView } from "../view/fleet_view.ts";
import { ask } from "./calls.ts";

/** What may be wider or higher than its room: it scrolls, by the keyboard too. */
export function Scroll({ label, tall, children }: { label: string; tall?: boolean; children: ComponentChildren }) {
  return <div class={tall === true ? "scroll tall" : "scroll"} tabIndex={0} role="region" aria-label={label}>{children}</div>;
}

export interface Answer<T> {
  answer: T | null;
  /** When it came, on the page's clock. */
  atMs: number;
  error: string | null;
  again: () => void;
}

/** Asks every so often while it is shown, one question at a time, and not while the tab is hidden. */
export function usePolled<M extends Method>(store: Store, connection: Connection, method: M | null, params: Params[M], everyMs: number): Answer<Results[M]> {
  const [found, setFound] = useState<Omit<Answer<Results[M]>, "again">>({ answer: null, atMs: 0, error: null });
  const [turn, setTurn] = useState(0);
  const key = JSON.stringify(params);
  useEffect(() => {
    if (method === null) return undefined;
    let here = true;
    let timer: ReturnType<typeof setTimeout> | undefined;
    const turnOver = (): void => { timer = setTimeout(() => void next(), everyMs); };
    const next = async (): Promise<void> => {
      if (document.visibilityState === "hidden") {
        turnOver();
        return;
      }
      try {
        const answer = await ask(store, connection, method, JSON.parse(key) as Params[M]);
        if (here) setFound({ answer, atMs: performance.now(), error: null });
      } catch (error) {
        if (here) setFound((before) => ({ ...before, error: refusalText(error) }));
      }
      if (here) turnOver();
    };
    void next();
    return () => {
      here = false;
      clearTimeout(timer);
    };
  }, [store, connection, method, key, everyMs, turn]);
  // another question: its answer has not come yet
  const question = `${method} ${key}`;
  const asked = useRef(question);
  if (asked.current !== question) {
    asked.current = question;
    if (found.answer !== null) setFound({ answer: null, atMs: 0, error: null });
  }
  return { ...found, again: () => setTurn((n) => n + 1) };
}

interface Working<T> {
  busy: boolean;
  answer: T | null;
  error: string | null;
}

const IDLE = { busy: false, answer: null, error: null };

/** Work at a person's wish, that ends with an answer, or with an error beside the answer that was shown before. Newer work replaces
 *  it: an older answer is neither shown nor returned. `show` puts an answer in its place, and returns whether nothing newer has since. */
export function useWork<T>() {
  const [state, setState] = useState<Working<T>>(IDLE);
  const number = useRef(0);
  const show = useCallback((answer: T | null): (() => boolean) => {
    const mine = ++number.current;
    setState({ busy: false, answer, error: null });
    return () => mine === number.current;
  }, []);
  const run = useCallback(async (work: () => Promise<T>): Promise<T | null> => {
    const mine = ++number.current;
    setState((before) => ({ ...before, busy: true, error: null }));
    try {
      const answer = await work();
      if (mine !== number.current) return null;
      show(answer);
      return answer;
    } catch (error) {
      if (mine === number.current) setState((before) => ({ ...before, busy: false, error: refusalText(error) }));
      return null;
    }
  }, [show]);
  const clear = useCallback((): void => void show(null), [show]);
  return { ...state, run, show, clear };
}

type Asking<P, T> = Omit<ReturnType<typeof useWork<T>>, "run"> & { run: (params: P | Promise<P>) => Promise<T | null> };

/** One question at a person's wish; its parameters may have to be read from a file first. */
export function useAsk<M extends Method>(store: Store, connection: Connection, method: M): Asking<Params[M], Results[M]>;
export function useAsk<T>(store: Store, connection: Connection, method: OwnMethod): Asking<object, T>;
export function useAsk(store: Store, connection: Connection, method: OwnMethod): Asking<object, unknown> {
  const { run: work, ...rest } = useWork<unknown>();
  const run = useCallback(
    (params: object | Promise<object>) => work(async () => ask(store, connection, method, await params)),
    [work, store, connection, method],
  );
  return { ...rest, run };
}

/** A value that outlives its panel: another tab must not lose it, nor an answer that comes meanwhile. */
export class Kept<T> extends Changes {
  constructor(public value: T) { super(); }

  readonly keep = (next: T): void => {
    this.value = next;
    this.changed();
  };
}

export function useKept<T>(kept: Kept<T>): [value: T, keep: (next: T) => void] {
  useChanges(kept);
  return [kept.value, kept.keep];
}

/** The canvas' tool while a panel is shown. A person may end it with Escape; `resume` takes it up again. */
export function useTool(view: FleetView, make: () => Tool, key: string): { active: boolean; resume: () => void } {
  const [active, setActive] = useState(true);
  const latest = useRef(make);
  latest.current = make;
  useEffect(() => {
    if (!active) return undefined;
    let here = true;
    view.setTool({
      ...latest.current(),
      cancel: () => {
        if (here) setActive(false);
      },
    });
    return () => {
      here = false;
      view.setTool(null);
    };
  }, [view, key, active]);
  return { active, resume: () => setActive(true) };
}

// --- files ------------------------------------------------------------------------------------------------------------

/** In a message of the page, which has at most 4 MiB; base64 and JSON make a file longer. */
export const MAX_FILE_BYTES = 2_200_000;

export interface FileContent {
  name: string;
  text?: string;
  base64?: string;
}

/** The file as the checks take it: binary formats in base64. */
export async function contentOf(file: File): Promise<FileContent> {
  if (file.size > MAX_FILE_BYTES) {
    throw new Error(`${file.name}: ${(file.size / 1e6).toFixed(1)} MB; the page takes ${MAX_FILE_BYTES / 1e6} MB, skygcs-cli takes more`);
  }
  if (!/\.(skyc|zip)$/i.test(file.name)) return { name: file.name, text: await file.text() };
  const bytes = new Uint8Array(await file.arrayBuffer());
  let binary = "";
  for (let i = 0; i < bytes.length; i += 0x8000) binary += String.fromCharCode(...bytes.subarray(i, i + 0x8000));
  return { name: file.name, base64: btoa(binary) };
}

/** A place to drop files on, which is a button for choosing them, too. */
export function DropZone(props: { label: string; accept: string; several?: boolean; onFiles: (files: File[]) => void }) {
  const [over, setOver] = useState(false);
  const input = useRef<HTMLInputElement>(null);
  const take = (list: FileList | null | undefined): void => {
    const files = [...(list ?? [])];
    if (files.length > 0) props.onFiles(props.several === true ? files : files.slice(0, 1));
  };
  return (
    <div
      class={over ? "dropzone over" : "dropzone"}
      onDragOver={(event) => {
        event.preventDefault();
        setOver(true);
      }}
      onDragLeave={() => setOver(false)}
      onDrop={(event) => {
        event.preventDefault();
        setOver(false);
        take(event.dataTransfer?.files);
      }}
    >
      <button type="button" onClick={() => input.current?.click()}>{props.label}</button>
      <span class="muted bymouse">or drop it here</span>
      <input
        ref={input}
        type="file"
        hidden
        accept={props.accept}
        multiple={props.several === true}
        onChange={(event) => {
          take(event.currentTarget.files);
          event.currentTarget.value = "";
        }}
      />
    </div>
  );
}

/** Gives a text to the browser as a file to keep. */
export function keepFile(name: string, text: string): void {
  const url = URL.createObjectURL(new Blob([text], { type: "text/plain" }));
  const link = document.createElement("a");
  link.href = url;
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

// --- pieces -----------------------------------------------------------------------------------------------------------

export function Failure({ text }: { text: string | null }) {
  return text === null ? null : <p class="failure" role="alert">{text}</p>;
}

/** "3 s ago"; grey and plain to see where it is old. */
export function Age({ age_s, old_s = 5 }: { age_s: number | null; old_s?: number }) {
  if (age_s === null) return <span class="age old">never</span>;
  return <span class={age_s > old_s ? "age old" : "age"}>{ageText(age_s)}</span>;
}

/** A title that opens and closes what is below it. */
export function Fold({ title, side, open = false, children }: { title: ComponentChildren; side?: ComponentChildren; open?: boolean; children: ComponentChildren }) {
  return (
    <details class="fold" open={open}>
      <summary><span class="foldtitle">{title}</span>{side !== undefined && <span class="foldside">{side}</span>}</summary>
      {children}
    </details>
  );
}

/** A column: its title, what a row has there, and the class of its cells; those of "number" stand to the right. */
export type PlainColumn<T> = readonly [title: ComponentChildren, cell: (row: T) => ComponentChildren, kind?: string];

interface PlainTableProps<T> {
  rows: readonly T[];
  keyOf: (row: T) => string | number;
  columns: readonly PlainColumn<T>[];
  /** Attributes of a row. */
  row?: (row: T) => { class?: string; "aria-selected"?: boolean; "data-changed"?: string | undefined };
  caption?: ComponentChildren;
  class?: string;
}

export function PlainTable<T>({ rows, keyOf, columns, row: more, caption, class: kind = "" }: PlainTableProps<T>) {
  return (
    <table class={`plain ${kind}`}>
      {caption !== undefined && <caption>{caption}</caption>}
      <thead><tr>{columns.map(([title, , of], i) => <th key={i} class={of}>{title}</th>)}</tr></thead>
      <tbody>
        {rows.map((row) => <tr key={keyOf(row)} {...more?.(row)}>{columns.map(([, cell, of], i) => <td key={i} class={of}>{cell(row)}</td>)}</tr>)}
      </tbody>
    </table>
  );
}

/** Names and values below each other. */
export function Facts({ facts, raw }: { facts: readonly (readonly [ComponentChildren, ComponentChildren])[]; raw?: boolean }) {
  return (
    <dl class={raw === true ? "fields raw" : "fields"}>{facts.map(([name, value], i) => <div key={i}><dt>{name}</dt><dd>{value}</dd></div>)}</dl>
  );
}

export interface TabOf {
  id: string;
  title: string;
  count?: number;
}

export function SubTabs({ label, tabs, now, go }: { label: string; tabs: readonly TabOf[]; now: string; go: (id: string) => void }) {
  const row = useRef<HTMLDivElement>(null);
  // on a phone the row is wider than the screen
  useEffect(() => row.current?.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest", inline: "nearest" }), [now]);
  return (
    <div ref={row} class="subtabs" role="tablist" aria-label={label}>
      {tabs.map((tab) => (
        <button key={tab.id} type="button" role="tab" class="subtab" aria-selected={tab.id === now} onClick={() => go(tab.id)}>
          {tab.title}
          {tab.count !== undefined && tab.count > 0 && <span class="badge">{tab.count}</span>}
        </button>
      ))}
    </div>
  );
}

/** A number with a label, for a form. What is no number gives null. */
export function NumberField(props: {
  label: string;
  unit?: string;
  value: number | null;
  least?: number;
  most?: number;
  step?: number | "any";
  placeholder?: string;
  onValue: (value: number | null) => void;
}) {
  // what is being typed stays as it is, also while it is no number yet and the panel is drawn again
  const [typed, setTyped] = useState<string | null>(null);
  return (
    <label class="field">
      <span>{props.label}</span>
      <input
        type="number"
        aria-label={props.label}
        inputMode="decimal"
        value={typed ?? props.value ?? ""}
        min={props.least}
        max={props.most}
        step={props.step ?? "any"}
        placeholder={props.placeholder}
        onInput={(event) => {
          const { value, valueAsNumber, validity } = event.currentTarget;
          setTyped(value);
          props.onValue(Number.isFinite(valueAsNumber) && validity.valid ? valueAsNumber : null);
        }}
        onBlur={() => setTyped(null)}
      />
      {props.unit !== undefined && <span class="unit">{props.unit}</span>}
    </label>
  );
}

/** A box to tick, with its label behind it. */
export function Check({ checked, onChecked, title, class: kind = "check", children }: { checked: boolean; onChecked: (checked: boolean) => void; title?: string; class?: string; children: ComponentChildren }) {
  return <label class={kind} title={title}><input type="checkbox" checked={checked} onChange={(event) => onChecked(event.currentTarget.checked)} /> {children}</label>;
}

export function Choice<T extends string>(props: { label: string; value: T; options: readonly (readonly [T, string])[]; onValue: (value: T) => void }) {
  return (
    <label class="field">
      <span>{props.label}</span>
      <select value={props.value} onChange={(event) => props.onValue(event.currentTarget.value as T)}>
        {props.options.map(([value, text]) => <option key={value} value={value}>{text}</option>)}
      </select>
    </label>
  );
}
