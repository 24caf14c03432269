// A recording: play, speed, and a bar to scrub. It stands below the top bar, so that nobody takes it for the present.

import { useEffect, useRef, useState } from "preact/hooks";
import { useTick } from "../hooks.ts";
import { refusalText } from "../orders.ts";
import { clockText, type Mark, markAfter, markBefore, placeAt, type ReplayInfo } from "./replay_time.ts";
import { Failure } from "./parts.tsx";
import type { OwnMethod } from "../types.ts";
import type { PanelProps } from "./registry.ts";

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10, 30, 100];
/** A bar that is dragged asks for so many places a second at most: each is a whole fleet. */
const SEEK_EVERY_MS = 150;
const STEP_S = 10;

export default function ReplayPanel({ store, connection }: PanelProps) {
  const { info, error, order } = useReplay(connection);
  const [dragged, setDragged] = useState<number | null>(null);
  const nowMs = useTick(100);
  const marks = useMarks(connection, info?.info.scanned === true);
  const seek = useSeek((position_s) => order("replay.seek", { position_s }));
  if (info === null) return <p class="replay">Replay: opening the recording … <Failure text={error} /></p>;
  const now = info.info;
  const position_s = dragged ?? placeAt(now, info.atMs, nowMs);
  const may = store.state.hello?.role === "command";
  const at = new Date((now.start_unix_s + position_s) * 1000);
  const drag = (wanted: number | null): void => {
    setDragged(wanted);
    if (wanted !== null) seek(wanted);
  };
  return (
    <div class="replay" role="group" aria-label="Replay">
      <b class="replaymark">Replay</b>
      <span class="file" title={now.file}>{now.file.split("/").at(-1)}</span>
      <button type="button" class="primary" disabled={!may} aria-label={now.playing ? "Pause" : "Play"} onClick={() => order(now.playing ? "replay.pause" : "replay.play")}>
        {now.playing ? "Pause" : now.ended ? "Play again" : "Play"}
      </button>
      <select
        aria-label="Speed"
        disabled={!may}
        value={String(now.speed)}
        onChange={(event) => order("replay.speed", { speed: Number(event.currentTarget.value) })}
      >
        {[...new Set([...SPEEDS, now.speed])].sort((a, b) => a - b).map((speed) => <option key={speed} value={String(speed)}>{speed}×</option>)}
      </select>
      <span class="clock">{clockText(position_s)}</span>
      <MarkButtons marks={marks} position_s={position_s} may={may} seek={(at_s) => order("replay.seek", { position_s: at_s })} />
      <span class="bar">
        <Ticks marks={marks} duration_s={Math.max(now.duration_s, 0.1)} />
        <Bar position_s={position_s} duration_s={now.duration_s} may={may} drag={drag} seek={seek} />
      </span>
      <span class="clock muted">{clockText(now.duration_s)}{now.scanned === false ? " so far" : ""}</span>
      <span class="muted date">{at.toLocaleString([], { hour12: false })}</span>
      <LastMark mark={markBefore(marks, position_s + HERE_S)} />
      <Failure text={error} />
    </div>
  );
}

/** Where the replay is, as its process says it, and how to order it. */
function useReplay(connection: PanelProps["connection"]) {
  const [info, setInfo] = useState<{ info: ReplayInfo; atMs: number } | null>(null);
  const [error, setError] = useState<string | null>(null);
  const take = (next: ReplayInfo): void => setInfo({ info: next, atMs: performance.now() });
  const order = (method: OwnMethod, params: object = {}): void => {
    connection.call<ReplayInfo>(method, params).then(
      (next) => {
        take(next);
        setError(null);
      },
      (failed: unknown) => setError(refusalText(failed)),
    );
  };
  useEffect(() => {
    const ask = (): void => { connection.call<ReplayInfo>("replay.info").then(take, (failed: unknown) => setError(refusalText(failed))); };
    ask();
    const undo = [connection.on<ReplayInfo>("replay.position", take), connection.onPhase((phase) => phase.kind === "open" && ask())];
    return () => undo.forEach((each) => each());
  }, [connection]);
  return { info, error, order };
}

interface BarProps {
  position_s: number;
  duration_s: number;
  may: boolean;
  /** Null: it is let go. */
  drag: (position_s: number | null) => void;
  seek: (position_s: number) => void;
}

function Bar({ position_s, duration_s, may, drag, seek }: BarProps) {
  return (
    <input
      type="range"
      aria-label="Place in the recording"
      aria-valuetext={clockText(position_s)}
      min={0}
      max={Math.max(duration_s, 0.1)}
      step={0.1}
      disabled={!may}
      value={position_s}
      onInput={(event) => drag(event.currentTarget.valueAsNumber)}
      onChange={() => drag(null)}
      onKeyDown={(event) => {
        // a tenth of a second is too small a step for a recording of an hour
        const step = event.key === "PageUp" ? STEP_S : event.key === "PageDown" ? -STEP_S : 0;
        if (step === 0) return;
        event.preventDefault();
        seek(Math.min(Math.max(position_s + step, 0), duration_s));
      }}
    />
  );
}

/** The events that are marked; asked for once more when the whole recording was read. */
function useMarks(connection: PanelProps["connection"], scanned: boolean): readonly Mark[] {
  const [marks, setMarks] = useState<readonly Mark[]>([]);
  useEffect(() => {
    let here = true;
    connection.call<{ marks: Mark[] }>("replay.marks").then((answer) => here && setMarks(answer.marks), () => undefined);
    return () => { here = false; };
  }, [connection, scanned]);
  return marks;
}

/** They are seen, and found by the buttons: each of hundreds would be a stop of the keyboard. */
function Ticks({ marks, duration_s }: { marks: readonly Mark[]; duration_s: number }) {
  return (
    <span class="ticks" aria-hidden="true">
      {marks.map(({ at_s, event }, i) => <i key={i} data-severity={event.severity} style={{ left: `${(100 * at_s) / duration_s}%` }} />)}
    </span>
  );
}

/** A place that is so near is at the mark: places come in milliseconds. */
const HERE_S = 0.0005;

function MarkButtons({ marks, position_s, may, seek }: { marks: readonly Mark[]; position_s: number; may: boolean; seek: (at_s: number) => void }) {
  const before = markBefore(marks, position_s - HERE_S);
  const after = markAfter(marks, position_s + HERE_S);
  return (
    <span class="marks">
      <button type="button" aria-label="Previous event" disabled={!may || before === null} onClick={() => before !== null && seek(before.at_s)}>‹</button>
      <button type="button" aria-label="Next event" disabled={!may || after === null} onClick={() => after !== null && seek(after.at_s)}>›</button>
    </span>
  );
}

function LastMark({ mark }: { mark: Mark | null }) {
  if (mark === null) return null;
  return <span class="lastmark" data-severity={mark.event.severity}>{clockText(mark.at_s)} {mark.event.vehicle ?? ""} {mark.event.text}</span>;
}

/** The newest place that was wanted, not every one on the way. */
function useSeek(send: (position_s: number) => void): (position_s: number) => void {
  const wanted = useRef<number | null>(null);
  const timer = useRef<ReturnType<typeof setTimeout> | null>(null);
  const latest = useRef(send);
  latest.current = send;
  useEffect(() => () => {
    if (timer.current !== null) clearTimeout(timer.current);
  }, []);
  return (position_s) => {
    wanted.current = position_s;
    if (timer.current !== null) return;
    timer.current = setTimeout(() => {
      timer.current = null;
      if (wanted.current !== null) latest.current(wanted.current);
      wanted.current = null;
    }, SEEK_EVERY_MS);
  };
}
