"""Control at the companion, as state machines without I/O: orders relayed once, the loss of the ground, the mirror of
its control on the ground."""
