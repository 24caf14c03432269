// The canvas' colours, read from the style sheet's variables, so that both follow one theme.

import type { Ink } from "./overlays.ts";

/** Vehicles have a colour each, by their place in the fleet; with more vehicles than colours they repeat. */
export const VEHICLE_COLOURS = 8;

export interface Palette {
  ground: string;
  surface: string;
  gridMinor: string;
  gridMajor: string;
  axis: string;
  text: string;
  muted: string;
  lost: string;
  accent: string;
  danger: string;
  warning: string;
  selection: string;
  vehicles: readonly string[];
  inks: Readonly<Record<Ink, string>>;
  font: string;
}

export function readPalette(element: Element): Palette {
  const styles = getComputedStyle(element);
  const colour = (name: string): string => styles.getPropertyValue(`--${name}`).trim() || "#888888";
  return {
    ground: colour("ground"),
    surface: colour("surface"),
    gridMinor: colour("grid-minor"),
    gridMajor: colour("grid-major"),
    axis: colour("grid-axis"),
    text: colour("text"),
    muted: colour("text-muted"),
    lost: colour("lost"),
    accent: colour("accent"),
    danger: colour("danger"),
    warning: colour("warning"),
    selection: colour("selection"),
    vehicles: Array.from({ length: VEHICLE_COLOURS }, (_, i) => colour(`vehicle-${i + 1}`)),
    inks: {
      plan: colour("ink-plan"),
      flown: colour("ink-flown"),
      fence: colour("ink-fence"),
      draft: colour("accent"),
      goal: colour("ink-goal"),
      warning: colour("warning"),
      danger: colour("danger"),
      muted: colour("text-muted"),
    },
    font: styles.fontFamily,
  };
}
