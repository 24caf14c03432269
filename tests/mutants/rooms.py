"""Rooms whose tests are measured by mutants: each module with the test files that are to notice its changes."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SRC = ROOT / "src/skygcs"
UNIT = ROOT / "tests/unit"

ROOMS: dict[str, dict[str, tuple[str, ...]]] = {
    "parsers": {
        "core/mavlink/parser.py": ("core/mavlink/test_parser.py",),
        "core/mavlink/signing.py": ("core/mavlink/test_signing.py",),
        "core/mavlink/heartbeat.py": ("core/mavlink/test_heartbeat.py",),
    },
    "routing": {
        "core/routing/router.py": (
            "core/routing/test_routing.py",
            "core/routing/test_routing_bound.py",
            "core/routing/test_routing_cases.py",
            "core/routing/test_routing_state.py",
            "core/routing/test_routing_table.py",
            "core/routing/test_heard_directly.py",
        ),
        "core/routing/routing_table.py": (
            "core/routing/test_routing.py",
            "core/routing/test_routing_table.py",
            "core/routing/test_heard_directly.py",
        ),
    },
    "state-sources": {
        "core/routing/source_selection.py": ("core/routing/test_routing_state.py", "core/routing/test_routing.py"),
        "core/routing/state_source.py": ("core/routing/test_state_source.py",),
        "core/vehicle/flight_evidence.py": (
            "core/vehicle/test_flight_evidence.py",
            "core/vehicle/test_landing_watch.py",
        ),
    },
    "takeoff": {"core/vehicle/takeoff_watch.py": ("core/vehicle/test_takeoff_watch.py",)},
    "guard": {"core/control/guard.py": ("core/control/test_guard.py",)},
    "order-gate": {"ext/federation/protocol/order_gate.py": ("ext/federation/protocol/test_order_gate.py",)},
    "outgoing-gate": {
        "core/vehicle/gate.py": (
            "core/vehicle/test_gate.py",
            "core/vehicle/test_gate_table.py",
            "core/vehicle/test_outgoing_gate.py",
        ),
        "core/vehicle/stick_modes.py": ("core/vehicle/test_gate.py",),
    },
    "certificates": {
        "ext/plans/certificates/certify.py": ("ext/plans/certificates/test_certify.py",),
        "ext/plans/certificates/closest_approach.py": (
            "ext/plans/certificates/test_closest_approach.py",
            "ext/plans/certificates/test_certify.py",
        ),
        "ext/plans/certificates/space_check.py": ("ext/plans/certificates/test_certify.py",),
        "ext/plans/certificates/bernstein_arrays.py": (
            "ext/plans/certificates/test_closest_approach.py",
            "ext/plans/certificates/test_certify.py",
        ),
        "ext/plans/certificates/certificate.py": (
            "ext/plans/certificates/test_certify.py",
            "ext/plans/flight/test_plan_preparation.py",
        ),
        "ext/plans/certificates/plan_search.py": ("ext/plans/certificates/test_plan_search.py",),
        "ext/plans/certificates/layered_flight.py": (
            "ext/plans/certificates/test_layered_flight.py",
            "ext/plans/certificates/test_plan_search.py",
        ),
    },
    "leases": {
        "ext/federation/protocol/lease.py": (
            "ext/federation/protocol/test_lease_steps.py",
            "ext/federation/protocol/test_lease.py",
        ),
        "ext/federation/protocol/lease_store.py": ("ext/federation/protocol/test_lease_store.py",),
        "ext/federation/bridge/leases.py": ("ext/federation/bridge/test_leases.py",),
    },
    "send-gates": {"core/routing/send_gates.py": ("core/routing/test_send_gates.py",)},
    "orders": {
        "runtime/order_runner.py": (
            "runtime/test_vehicle_actor.py",
            "runtime/test_stop_orders.py",
            "../integration/test_orders_as_they_come.py",
        ),
        "runtime/order_precedence.py": (
            "runtime/test_vehicle_actor.py",
            "../integration/test_orders_as_they_come.py",
        ),
        "runtime/takeoffs.py": ("runtime/test_takeoffs.py",),
        "core/vehicle/shared_ids.py": ("core/vehicle/test_shared_ids.py",),
        "back_off.py": ("test_back_off.py",),
    },
    "order-ledger": {
        "core/vehicle/order_ledger.py": ("core/vehicle/test_order_ledger.py",),
        "runtime/command_client.py": ("runtime/test_command_client.py", "runtime/test_vehicle_actor.py"),
        "runtime/entry_conditions.py": ("runtime/test_entry_conditions.py", "runtime/test_offboard_engagement.py"),
        "runtime/onboard_orders.py": ("runtime/test_mission_transfers.py",),
    },
    "monitor": {
        "core/monitor/monitor.py": ("core/monitor/test_monitor.py", "core/monitor/test_conflict_levels.py"),
        "core/monitor/conflict_levels.py": (
            "core/monitor/test_conflict_levels.py",
            "core/monitor/test_monitor.py",
            "core/monitor/test_approach.py",
        ),
        "core/monitor/approach.py": ("core/monitor/test_approach.py", "core/monitor/test_monitor.py"),
        "core/monitor/tracks.py": ("core/monitor/test_monitor.py",),
        "core/monitor/mission_ways.py": ("core/monitor/test_mission_ways.py",),
    },
    "companions": {
        "ext/companions/tls.py": ("ext/companions/test_identity.py", "ext/companions/test_tls_orders.py"),
        "ext/companions/ground_contact.py": ("ext/companions/test_ground.py",),
    },
    "unattended": {
        "core/vehicle/unattended.py": ("core/vehicle/test_unattended.py", "runtime/test_unattended_holds.py"),
        "runtime/unattended_holds.py": ("runtime/test_unattended_holds.py",),
        "runtime/flight_notes.py": (
            "../integration/test_restart_in_flight.py",
            "runtime/test_fleet.py",
            "runtime/test_flight_notes.py",
        ),
    },
    "returns": {
        "core/monitor/departures.py": ("core/monitor/test_departures.py",),
        "core/monitor/ways.py": ("core/monitor/test_ways.py",),
        "core/monitor/order_check.py": (
            "core/monitor/test_monitor.py",
            "core/monitor/test_hold_circle.py",
            "core/monitor/test_order_check.py",
        ),
        "runtime/returns.py": (
            "../integration/test_returns_that_hold.py",
            "../integration/test_returns_at_once.py",
            "../integration/test_returns.py",
        ),
        "runtime/return_members.py": (
            "../integration/test_returns_that_hold.py",
            "../integration/test_returns_at_once.py",
            "../integration/test_returns.py",
        ),
    },
}
