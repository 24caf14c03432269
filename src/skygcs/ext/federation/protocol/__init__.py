"""Data that several sites share: names, batches of states, leases, orders and conflicts across sites. Pure."""
