"""Companions: computers on vehicles that run skygcs, too. The ground finds them, relays control to them, installs them.

ground.py             [companions] of a daemon on the ground: connections, flights at companions, mDNS
aboard.py             [companion] of the daemon on the vehicle: the ground's orders, its loss, the link to it
companions_table.py, companion_table.py, role.py   the two tables, and what [companion] makes of a fleet file
companion_link.py, companion_links.py              the ground's connections, with the companions' clocks
companion_control.py  control of a vehicle that its companion flies, as the ground has it
ground_orders.py      the same at the companion
ground_finder.py      mDNS on both sides
tls.py, tls_listener.py, pinned_client.py, identity.py   mutual TLS with pinned certificates, and their keys
methods.py, relayed_control.py   companions.status; companion.contact, companion.order, companion.setpoint
commands.py, bring_up_commands.py, keys.py   skygcs-cli companions, up and down; skygcs companion
bring_up/             companions over SSH: installed, updated, started; it works without a daemon

Pure: order_book.py (orders relayed once), relayed_order.py (one order until its outcome), ground_contact.py (the loss
of the ground), mirrored_control.py (the companion's control as the ground shows it), wire.py (what is relayed, as
JSON), ground_choice.py (which ground a companion sends to).
"""
