// The canvas as a part of the page: pointer, wheel, fingers and keys, and the buttons on it.

import { useEffect, useRef, useState } from "preact/hooks";
import { beginPlannedPaths, hideFences, showFences } from "./planned_paths.ts";
import { useChanges, useStore } from "./hooks.ts";
import type { PanelProps } from "./panels/registry.ts";
import { beginInput } from "./view/input.ts";

export function FleetCanvas({ store, connection, view }: PanelProps) {
  const canvas = useRef<HTMLCanvasElement>(null);
  const ground = useRef<HTMLCanvasElement>(null);
  const readout = useRef<HTMLOutputElement>(null);
  const band = useRef<HTMLDivElement>(null);
  useChanges(view);
  useEffect(() => beginPlannedPaths(store, connection, view), [store, connection, view]);
  useEffect(() => {
    const element = canvas.current;
    if (element === null || ground.current === null) return;
    const detach = view.attach(element, ground.current);
    view.buttons = () => {
      const { left, top } = element.getBoundingClientRect();
      return [...(element.parentElement?.querySelectorAll(".viewbuttons > .group") ?? [])].map((group) => {
        const box = group.getBoundingClientRect();
        return { left: box.left - left, top: box.top - top, right: box.right - left, bottom: box.bottom - top };
      });
    };
    const end = beginInput(element, view, store, {
      place: (text) => { if (readout.current !== null) readout.current.value = text; },
      band: (box) => showBand(band.current, box),
    });
    return () => {
      end();
      detach();
    };
  }, [view, store]);
  return (
    <div class="canvasbox">
      <canvas ref={ground} aria-hidden="true" />
      <canvas ref={canvas} tabIndex={0} role="img"
        aria-label="Fleet view: arrows move it, plus and minus zoom, F shows all, C follows the selected vehicles. The table has the same vehicles as text." />
      <div ref={band} class="band" hidden />
      <ViewButtons store={store} connection={connection} view={view} />
      <output ref={readout} class="readout" aria-hidden="true" />
      {view.tool !== null && (
        <div class="toolhint" role="status">
          <span>{view.tool.hint}</span>
          <button type="button" onClick={() => view.setTool(null)}>Cancel</button>
        </div>
      )}
    </div>
  );
}

function showBand(element: HTMLDivElement | null, box: { left: number; top: number; width: number; height: number } | null): void {
  if (element === null) return;
  element.hidden = box === null;
  if (box === null) return;
  for (const key of ["left", "top", "width", "height"] as const) element.style[key] = `${box[key]}px`;
}

function ViewButtons({ store, connection, view }: PanelProps) {
  const hasMap = useStore(store, (state) => state.hello?.map != null || state.hello?.tiles != null);
  const problem = useStore(store, (state) => state.hello?.tiles_problem ?? "");
  const { options } = view;
  const toggles = [["labels", "Labels"], ["trails", "Trails"], ["side", "Heights"], ...(hasMap ? [["map", "Map"]] : [])] as const;
  return (
    <div class="viewbuttons" role="toolbar" aria-label="View">
      <div class="group">
        <button type="button" aria-label="Zoom in" title="Zoom in (+)" onClick={() => view.zoom(1.5)}>+</button>
        <button type="button" aria-label="Zoom out" title="Zoom out (−)" onClick={() => view.zoom(1 / 1.5)}>−</button>
        <button type="button" title="Show all vehicles, targets and plans (F)" onClick={() => view.fit("all")}>Fit</button>
        <button type="button" title="Keep the selected vehicles in the middle (C)" aria-pressed={view.follow} onClick={() => view.setFollow(!view.follow)}>Follow</button>
      </div>
      <div class="group layers">
        {toggles.map(([key, title]) => {
          const name = key as keyof typeof options;
          return (
            <button key={key} type="button" aria-pressed={options[name]} onClick={() => view.setOptions({ [name]: !options[name] })}>{title}</button>
          );
        })}
        {problem !== "" && <MapProblem text={problem} />}
        <FenceButton store={store} connection={connection} view={view} />
      </div>
    </div>
  );
}

/** Why there is no map, for a person who asks. */
function MapProblem({ text }: { text: string }) {
  const [shown, setShown] = useState(false);
  return (
    <>
      <button type="button" aria-expanded={shown} title={text} onClick={() => setShown(!shown)}>No map</button>
      {shown && <span class="said" role="status">{text}</span>}
    </>
  );
}

/** Asks the vehicles for their fences: nothing goes over the radio before a person wants it. */
function FenceButton({ store, connection, view }: PanelProps) {
  const [said, setSaid] = useState<string | null>(null);
  const mayAsk = useStore(store, (state) => state.hello?.role === "command" && !state.hello.replay && state.daemon?.connected === true);
  if (!mayAsk) return null;
  const toggle = async (): Promise<void> => {
    if (said !== null) {
      hideFences(view);
      setSaid(null);
      return;
    }
    setSaid("asking …");
    setSaid(await showFences(store, connection, view));
  };
  return (
    <>
      <button type="button" aria-pressed={said !== null} title="Ask the vehicles for their fences about home" onClick={() => void toggle()}>Fences</button>
      {said !== null && <span class="said" role="status">{said}</span>}
    </>
  );
}
