// Charts of the last minutes of one vehicle, and the numbers of its links.

import { fixed, percentText } from "../format.ts";
import { useStore, useTick } from "../hooks.ts";
import { serverNowS } from "../store.ts";
import { Chart, type ChartProps, type Curve } from "./chart.tsx";
import { histories, SERIES, type SeriesName } from "./histories.ts";
import { Age, Facts, Failure, PlainTable, usePolled } from "./parts.tsx";
import type { VehicleProps } from "./vehicle_panel.tsx";

type Picture = readonly [title: string, curves: readonly (readonly [SeriesName, Curve["colour"]])[], range?: ChartProps["range"]];

const PICTURES: readonly Picture[] = [
  ["Height above home, m", [["height", 1]]],
  ["Speed, m/s", [["speed", 1], ["climb", 2]]],
  ["Battery, V", [["volts", 3]]],
  ["Battery, %", [["percent", 3]], [0, 100]],
  ["Loss, %", [["loss", 4]], [0, null]],
  ["Round trip, s", [["rtt", 5]], [0, null]],
  ["Satellites", [["satellites", 7]], [0, null]],
];

export function VehicleHistory({ name }: VehicleProps) {
  useTick(1000);
  const ring = histories.of(name);
  return (
    <>
      {ring.length < 2 && <p class="note">The history begins when the page is opened.</p>}
      {PICTURES.map(([title, curves, range]) => (
        <Chart
          key={title}
          title={title}
          curves={curves.map(([label, colour]) => ({ label, colour }))}
          columns={() => ring.columns(curves.map(([series]) => SERIES.indexOf(series)))}
          version={ring.version}
          {...(range === undefined ? {} : { range })}
        />
      ))}
    </>
  );
}

export function VehicleLinks({ store, connection, name }: VehicleProps) {
  const nowMs = useTick(500);
  const vehicle = useStore(store, (state) => state.vehicles.get(name));
  const { answer, error } = usePolled(store, connection, "link.status", {}, 1000);
  if (vehicle === undefined) return null;
  const since_s = Math.max(serverNowS(store.state, nowMs) - vehicle.heard_s, 0);
  const radios = (answer ?? []).flatMap((radio) => radio.vehicles.filter((one) => one.name === name).map((one) => ({ link: radio.link, ...one })));
  const { uplink } = vehicle;
  return (
    <>
      <PlainTable rows={Object.entries(vehicle.links)} keyOf={([link]) => link} columns={[
        ["link", ([link]) => link],
        ["frames", ([, { frames }]) => frames, "number"],
        ["lost", ([, { lost }]) => lost, "number"],
        ["loss", ([, { loss_ratio }]) => percentText(loss_ratio) ?? "–", "number"],
        ["age", ([, { age_s }]) => <Age age_s={age_s + since_s} />, "number"],
      ]} />
      <Facts facts={[
        ["uplink", (
          <>
            {uplink === null ? "not known" : uplink.heard ? "it answers" : `does not answer: ${uplink.unanswered} requests`}
            {uplink !== null && <>, last <Age age_s={uplink.age_s + since_s} /> ago</>}
          </>
        )],
        ["round trip", `${fixed(uplink?.rtt_s, 3) ?? "–"} s`],
        ...radios.map((one) => [`air of ${one.link}`, [
          `${fixed(one.measured_bytes_per_s, 0) ?? "–"} of ${fixed(one.planned_bytes_per_s, 0)} B/s planned`,
          `${one.scaled ? ", less than it would send" : ""}, loss ${percentText(one.loss) ?? "–"}`,
        ].join("")] as const),
      ]} />
      <Failure text={error} />
    </>
  );
}
