// The bar between the view and the table: dragged by mouse or finger, moved by keys; a double click gives the table the height
// of its rows again.

import { useEffect, useLayoutEffect, useRef, useState } from "preact/hooks";
import { keepShare, LEAST_SHARE, MOST_SHARE, shareAfter, shareAt, type Share } from "./split.ts";

const TABLE = ".tablepane";

export function Splitter({ share, onShare }: { share: Share; onShare: (share: Share) => void }) {
  const bar = useRef<HTMLDivElement>(null);
  const [dragged, setDragged] = useState(false);
  const [now, setNow] = useState(share ?? LEAST_SHARE);
  useLayoutEffect(() => {
    const table = bar.current?.parentElement?.querySelector(TABLE) ?? null;
    if (table === null) return undefined;
    // what the table has, also where its rows say it
    const observer = new ResizeObserver(() => setNow(Math.round(measured(bar.current))));
    observer.observe(table);
    return () => observer.disconnect();
  }, []);
  useEffect(() => {
    if (!dragged) keepShare(share);
  }, [dragged, share]);
  const follow = (event: PointerEvent): void => {
    const box = bar.current?.parentElement?.getBoundingClientRect();
    if (box !== undefined) onShare(shareAt(event.clientY, box.top, box.height));
  };
  return (
    <div ref={bar} class="splitter" role="separator" aria-orientation="horizontal" aria-label="Height of the table" tabIndex={0}
      aria-valuemin={LEAST_SHARE} aria-valuemax={MOST_SHARE} aria-valuenow={now} aria-valuetext={`${now} percent for the table`}
      title="Drag: more room for the view or for the table. Double click: as high as its rows" data-dragged={dragged}
      onPointerDown={(event) => {
        if (event.button !== 0) return;
        event.currentTarget.setPointerCapture(event.pointerId);
        setDragged(true);
      }}
      onPointerMove={(event) => { if (dragged) follow(event); }}
      onPointerUp={() => setDragged(false)}
      onPointerCancel={() => setDragged(false)}
      onDblClick={() => onShare(null)}
      onKeyDown={(event) => {
        if (event.ctrlKey || event.metaKey || event.altKey) return;
        const next = shareAfter(event.key, measured(bar.current));
        if (next === undefined) return;
        event.preventDefault();
        onShare(next);
      }}
    />
  );
}

/** Percent of the height that the table has. */
function measured(bar: HTMLElement | null): number {
  const fleet = bar?.parentElement;
  const table = fleet?.querySelector(TABLE)?.clientHeight ?? 0;
  return (100 * table) / Math.max(fleet?.clientHeight ?? 0, 1);
}
