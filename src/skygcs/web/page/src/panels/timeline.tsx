// The scrubber of a plan: a bar, play, and what is closest at the time that is shown.

import { useEffect, useRef, useState } from "preact/hooks";
import type { PlanTimeline } from "./plan_timeline.ts";
import { Choice } from "./parts.tsx";

const SPEEDS = [["0.5", "½×"], ["1", "1×"], ["2", "2×"], ["5", "5×"], ["10", "10×"]] as const;
/** Pairs of more vehicles are not compared at each frame. */
const COMPARED = 60;

export function Timeline({ timeline, phases, downwashRatio, t_s, setT }: { timeline: PlanTimeline; phases: readonly string[]; downwashRatio: number; t_s: number; setT: (t_s: number) => void }) {
  const [playing, setPlaying] = useState(false);
  const [speed, setSpeed] = useState<(typeof SPEEDS)[number][0]>("1");
  const now = useRef(t_s);
  now.current = t_s;
  const set = useRef(setT);
  set.current = setT;
  useEffect(() => {
    if (!playing) return undefined;
    let before: number | null = null;
    let frame = 0;
    const step = (atMs: number): void => {
      const next = now.current + (before === null ? 0 : ((atMs - before) / 1000) * Number(speed));
      before = atMs;
      set.current(Math.min(next, timeline.duration_s));
      if (next >= timeline.duration_s) setPlaying(false);
      else frame = requestAnimationFrame(step);
    };
    frame = requestAnimationFrame(step);
    return () => cancelAnimationFrame(frame);
  }, [playing, speed, timeline]);
  const closest = timeline.paths.size > 1 && timeline.paths.size <= COMPARED ? timeline.closestAt(t_s, downwashRatio) : null;
  return (
    <section class="timeline" aria-label="Timeline of the plan">
      <div class="row">
        <button
          type="button"
          aria-label={playing ? "Pause the picture" : "Play the picture"}
          onClick={() => {
            if (!playing && t_s >= timeline.duration_s) setT(0);
            setPlaying(!playing);
          }}
        >
          {playing ? "Pause" : "Play"}
        </button>
        <Choice label="Speed" value={speed} options={SPEEDS} onValue={setSpeed} />
        <output>{t_s.toFixed(1)} of {timeline.duration_s.toFixed(1)} s</output>
      </div>
      <input
        type="range"
        aria-label="Time of the plan"
        aria-valuetext={`${t_s.toFixed(1)} seconds`}
        min={0}
        max={timeline.duration_s}
        step={0.05}
        value={t_s}
        onInput={(event) => {
          setPlaying(false);
          setT(event.currentTarget.valueAsNumber);
        }}
      />
      {closest !== null && <p class="muted">closest now: {closest.pair.join(" and ")}, {closest.distance_m.toFixed(1)} m</p>}
      {phases.length > 0 && <p class="muted">Phases: {phases.join(", ")}</p>}
    </section>
  );
}
