// Numbers as people read them. Null is "not known" and gives null: what is shown then is for the place to say.

export function fixed(value: number | null | undefined, digits: number): string | null {
  if (value === null || value === undefined || !Number.isFinite(value)) return null;
  const text = value.toFixed(digits);
  return /^-0(\.0*)?$/.test(text) ? text.slice(1) : text.replace("-", "−");
}

/** An age or a duration in two places at most: 0.4 s, 12 s, 3 min, 2 h. */
export function ageText(seconds: number): string {
  if (seconds < 9.95) return `${Math.max(seconds, 0).toFixed(1)} s`;
  if (seconds < 100) return `${seconds.toFixed(0)} s`;
  if (seconds < 5400) return `${(seconds / 60).toFixed(0)} min`;
  return `${(seconds / 3600).toFixed(0)} h`;
}

/** The time of day of an event. */
export function timeText(unix_s: number): string {
  return new Date(unix_s * 1000).toLocaleTimeString([], { hourCycle: "h23" });
}

export function percentText(ratio: number | null | undefined): string | null {
  if (ratio === null || ratio === undefined) return null;
  const percent = ratio * 100;
  return `${percent === 0 || percent >= 9.95 ? percent.toFixed(0) : percent.toFixed(1)} %`;
}

/** "alpha, bravo and 3 more", or "3 of north and 12 of south": who an order is for. */
export function namesText(names: readonly string[], most = 3): string {
  if (names.length === 0) return "nothing";
  if (names.length <= most) return listText(names);
  if (names.some((name) => name.includes("/"))) return listText(countsBySite(names));
  return `${names.slice(0, most - 1).join(", ")} and ${names.length - most + 1} more`;
}

function countsBySite(names: readonly string[]): string[] {
  const counts = new Map<string, number>();
  for (const name of names) {
    const site = name.includes("/") ? name.slice(0, name.indexOf("/")) : "this site";
    counts.set(site, (counts.get(site) ?? 0) + 1);
  }
  return [...counts].map(([site, count]) => `${count} of ${site}`);
}

function listText(names: readonly string[]): string {
  if (names.length === 1) return names[0] ?? "";
  return `${names.slice(0, -1).join(", ")} and ${names.at(-1) ?? ""}`;
}

/** Nobody points better on a screen. */
export function toDecimetre(metres: number): number {
  return Math.round(metres * 10) / 10;
}

/** The set with this one where it was not, without it where it was. */
export function toggled<T>(set: ReadonlySet<T>, one: T): ReadonlySet<T> {
  const next = new Set(set);
  if (!next.delete(one)) next.add(one);
  return next;
}

/** 12,345 with thin spaces. */
export function countText(count: number | null | undefined): string {
  if (count === null || count === undefined) return "–";
  return String(count).replace(/\B(?=(\d{3})+(?!\d))/g, " ");
}
