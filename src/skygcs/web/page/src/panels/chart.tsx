// A chart over time: uPlot with the colours of the theme. What it draws is bounded by who keeps the values.

import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { onTheme } from "../theme.ts";
import type { Columns } from "./histories.ts";
import { bounds } from "./chart_bounds.ts";

export interface Curve {
  label: string;
  /** A colour of the theme: --vehicle-1 to --vehicle-7. */
  colour: 1 | 2 | 3 | 4 | 5 | 6 | 7;
  digits?: number;
  unit?: string;
}

export interface ChartProps {
  title: string;
  curves: readonly Curve[];
  /** Read when `version` changes. */
  columns: () => Columns;
  version: number;
  heightPx?: number;
  /** Bounds of the values; null: as the values are. */
  range?: readonly [number | null, number | null];
}

export function Chart({ title, curves, columns, version, heightPx = 130, range }: ChartProps) {
  const place = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot | null>(null);
  const read = useRef(columns);
  read.current = columns;
  const shape = JSON.stringify([title, curves, heightPx, range ?? null]);
  useEffect(() => {
    const here = place.current;
    if (here === null) return undefined;
    const given = JSON.parse(shape) as [string, Curve[], number, readonly [number | null, number | null] | null];
    const make = (): void => {
      plot.current?.destroy();
      plot.current = new uPlot(options(here, given[1], given[2], given[3]), read.current(), here);
    };
    make();
    const resize = new ResizeObserver(() => plot.current?.setSize({ width: Math.max(here.clientWidth, 120), height: given[2] }));
    resize.observe(here);
    const undo = onTheme(make);
    return () => {
      undo();
      resize.disconnect();
      plot.current?.destroy();
      plot.current = null;
    };
  }, [shape]);
  useEffect(() => { plot.current?.setData(read.current()); }, [version]);
  return (
    <figure class="chart">
      <figcaption>
        {title}
        <span class="legend">{curves.map((curve) => <span key={curve.label}><i class={`key key${curve.colour}`} /> {curve.label}</span>)}</span>
      </figcaption>
      <div ref={place} class="plot" role="img" aria-label={title} />
    </figure>
  );
}

function options(place: HTMLElement, curves: readonly Curve[], height: number, range: readonly [number | null, number | null] | null): uPlot.Options {
  const style = getComputedStyle(document.documentElement);
  const colour = (name: string, fallback: string): string => style.getPropertyValue(name).trim() || fallback;
  const ink = colour("--text-muted", "#888");
  const grid = { stroke: colour("--edge", "#8884"), width: 1 };
  const font = "11px system-ui, sans-serif";
  const axis = { stroke: ink, grid, ticks: { ...grid, size: 4 }, font };
  return {
    width: Math.max(place.clientWidth, 120),
    height,
    legend: { show: false },
    cursor: { y: false, drag: { x: false, y: false } },
    scales: { x: { time: true }, y: { range: (_, least, most) => bounds(least, most, range) } },
    axes: [{ ...axis, size: 22, space: 70 }, { ...axis, size: 46, space: 24 }],
    series: [{}, ...curves.map((curve) => ({
      label: curve.label,
      stroke: colour(`--vehicle-${curve.colour}`, "#48f"),
      width: 1.5,
      spanGaps: false,
      points: { show: false },
    }))],
  };
}
