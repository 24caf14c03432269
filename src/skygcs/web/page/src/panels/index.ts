// The panels of the page, in the order of their tabs. See registry.ts.

import type { Panel } from "./registry.ts";

export const PANELS: readonly Panel[] = [];
