// Orders that follow each other, as engage, load and start: each vehicle is owned by the newest chain or order for it.

const owners = new Map<string, OrderChain>();

export class OrderChain {
  constructor(readonly targets: readonly string[]) {
    takeOver(targets);
    for (const name of targets) owners.set(name, this);
  }

  /** No newer chain and no other order was for one of its vehicles. */
  get goesOn(): boolean {
    return this.targets.length > 0 && this.targets.every((name) => owners.get(name) === this);
  }

  /** No further step is sent. Idempotent. */
  end(): void {
    for (const name of this.targets) if (owners.get(name) === this) owners.delete(name);
  }
}

/** A newer order for these vehicles ends, as a whole, each chain that owns one of them. */
export function takeOver(targets: readonly string[]): void {
  for (const name of targets) owners.get(name)?.end();
}
