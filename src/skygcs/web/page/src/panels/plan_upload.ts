// Gives the text of a plan to the daemon, in parts where one request cannot hold it.

/** A line of the daemon's socket has 1 MiB, with the rest of the request. */
const UPLOAD_ABOVE_CHARS = 900_000;

/** Of one part. */
export const PART_CHARS = 400_000;

export interface Part {
  part: string;
  upload: number | null;
}

/** The parameter of plan.load: the plan itself, or the number under which the daemon took its parts. */
export async function givenPlan(text: string, send: (part: Part) => Promise<{ upload: number }>): Promise<{ plan: object } | { upload: number }> {
  if (text.length <= UPLOAD_ABOVE_CHARS) return { plan: JSON.parse(text) as object };
  let { upload } = await send({ part: text.slice(0, PART_CHARS), upload: null });
  for (let at = PART_CHARS; at < text.length; at += PART_CHARS) {
    ({ upload } = await send({ part: text.slice(at, at + PART_CHARS), upload }));
  }
  return { upload };
}
