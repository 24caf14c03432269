// Gives the text of a plan to the daemon, in parts where one request cannot hold it.

import type { Params } from "../types.ts";
/** A line of the daemon's socket has 1 MiB, with the rest of the request. */
const UPLOAD_ABOVE_CHARS = 900_000;

/** Of one part. */
export const PART_CHARS = 400_000;

/** The parameter of plan.load: the plan itself, or the number under which the daemon took its parts. */
export async function givenPlan(text: string, send: (part: Params["plan.upload"]) => Promise<{ upload: number }>): Promise<{ plan: Record<string, unknown> } | { upload: number }> {
  if (text.length <= UPLOAD_ABOVE_CHARS) return { plan: JSON.parse(text) as Record<string, unknown> };
  let { upload } = await send({ part: text.slice(0, PART_CHARS), upload: null });
  for (let at = PART_CHARS; at < text.length; at += PART_CHARS) {
    ({ upload } = await send({ part: text.slice(at, at + PART_CHARS), upload }));
  }
  return { upload };
}
