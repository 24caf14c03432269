// Dark, daylight, or as the system has it. Kept in a cookie-free place that private windows also have.

export type Theme = "system" | "dark" | "daylight";

const KEY = "skygcs.theme";
const THEMES: readonly Theme[] = ["system", "dark", "daylight"];

let present: Theme = "system";
const listeners = new Set<() => void>();

export function theme(): Theme {
  return present;
}

export function setTheme(wanted: Theme): void {
  present = wanted;
  remember(KEY, wanted);
  apply();
}

/** Called when colours changed: the canvas reads them anew. */
export function onTheme(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

export function beginTheme(): void {
  const kept = recall(KEY);
  present = THEMES.find((one) => one === kept) ?? "system";
  matchMedia("(prefers-color-scheme: light)").addEventListener("change", apply);
  apply();
}

function apply(): void {
  const light = present === "daylight" || (present === "system" && matchMedia("(prefers-color-scheme: light)").matches);
  document.documentElement.dataset["theme"] = light ? "daylight" : "dark";
  for (const listener of listeners) listener();
}

/** Settings of this browser; a browser that forbids it forgets them. */
export function remember(key: string, value: string): void {
  try {
    window.localStorage.setItem(key, value);
  } catch {
    return;
  }
}

export function recall(key: string): string | null {
  try {
    return window.localStorage.getItem(key);
  } catch {
    return null;
  }
}
