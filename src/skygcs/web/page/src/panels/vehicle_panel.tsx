// The panel of one vehicle: everything that is known of it, each thing with its age.

import { useState } from "preact/hooks";
import { useStore, useTick } from "../hooks.ts";
import { isHeard, serverNowS, silenceOf } from "../store.ts";
import { Age, SubTabs, type TabOf } from "./parts.tsx";
import type { PanelProps } from "./registry.ts";
import { VehicleDrill } from "./vehicle_drill.tsx";
import { VehicleControl } from "./vehicle_control.tsx";
import { VehicleHistory, VehicleLinks } from "./vehicle_history.tsx";
import { VehicleFields, VehicleMessages, VehicleTexts } from "./vehicle_state.tsx";
import { VehicleParams } from "./vehicle_params.tsx";
import { VehiclePreflight } from "./vehicle_preflight.tsx";

/** What each part of the panel gets. */
export interface VehicleProps extends PanelProps {
  name: string;
}

/** Only where the daemon simulates vehicles. */
const DRILL: TabOf = { id: "drill", title: "Drill" };

const TABS: readonly TabOf[] = [
  { id: "state", title: "State" },
  { id: "history", title: "History" },
  { id: "control", title: "Control" },
  { id: "params", title: "Parameters" },
  { id: "preflight", title: "Preflight" },
  { id: "messages", title: "Messages" },
  { id: "texts", title: "Texts" },
  { id: "links", title: "Radio" },
];

export default function VehiclePanel(props: PanelProps) {
  const { store } = props;
  const shown = useStore(store, (state) => state.shown);
  const names = useStore(store, (state) => state.names);
  const drills = useStore(store, (state) => state.daemon?.drills === true);
  const [tab, setTab] = useState("state");
  const name = shown ?? (names.length === 1 ? (names[0] ?? null) : null);
  if (name === null) return <p class="note">{names.length === 0 ? "No vehicle was heard yet." : "Select a vehicle in the table or on the view."}</p>;
  const each: VehicleProps = { ...props, name };
  return (
    <div class="panel vehiclepanel">
      <VehicleHead {...each} />
      <SubTabs label="Parts of the vehicle" tabs={drills ? [...TABS, DRILL] : TABS} now={tab} go={setTab} />
      {/* another vehicle begins anew: an edit of one must never be sent to another */}
      <div key={name} class="panelbody" role="tabpanel">
        {tab === "state" && <VehicleFields {...each} />}
        {tab === "history" && <VehicleHistory {...each} />}
        {tab === "control" && <VehicleControl {...each} />}
        {tab === "params" && <VehicleParams {...each} />}
        {tab === "preflight" && <VehiclePreflight {...each} />}
        {tab === "messages" && <VehicleMessages {...each} />}
        {tab === "texts" && <VehicleTexts {...each} />}
        {tab === "links" && <VehicleLinks {...each} />}
        {tab === DRILL.id && <VehicleDrill {...each} />}
      </div>
    </div>
  );
}

function VehicleHead({ store, name }: VehicleProps) {
  const nowMs = useTick(500);
  const vehicle = store.state.vehicles.get(name);
  if (vehicle === undefined) return null;
  const now_s = serverNowS(store.state, nowMs);
  const heard = isHeard(vehicle, now_s);
  return (
    <header class={heard ? "vehiclehead" : "vehiclehead lost"}>
      <h2>{vehicle.name}</h2>
      <p class="muted">system {vehicle.sysid} · {vehicle.autopilot} {vehicle.type}{vehicle.firmware === null ? "" : ` · ${vehicle.firmware}`}</p>
      <p>
        <b>{vehicle.mode ?? "mode not known"}</b> · {vehicle.armed === null ? "armed or not is not known" : vehicle.armed ? "armed" : "disarmed"} ·{" "}
        {vehicle.landed.replace("_", " ")}
        {vehicle.failsafe && <b class="danger"> · failsafe</b>} · heard <Age age_s={silenceOf(vehicle, now_s)} /> ago
      </p>
      {!heard && <p class="failure">Not heard: what is shown below was true when it was last heard.</p>}
    </header>
  );
}
