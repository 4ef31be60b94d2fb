"""Rows of a made-up fleet: vehicles with and without trouble, tiers, gaps, refused logs, and names that attack."""

from datetime import UTC, datetime, timedelta

from mavdem.fleet.row import FlightRow

MOTORS = (
    "motor 1 (front right)",
    "motor 2 (rear left)",
    "motor 3 (front left)",
    "motor 4 (rear right)",
)
START = datetime(2026, 1, 5, 9, tzinfo=UTC)
WEAK = {"effect": (-40.0, 40.0, 0.7 * 41.0, -39.0), "trim_share": (0.97, 0.95, 1.12, 0.96)}


def flight_row(vehicle, number, axis="roll", **changed):
    """Returns a row of a fleet's table with complete figures; flights of a vehicle are a day apart."""
    values = {
        "file": f"/logs/{vehicle}/{number:04d}.ulg",
        "key": f"{vehicle}-{number}",
        "vehicle": vehicle,
        "date": START + timedelta(days=number),
        "frame": "QUADROTOR",
        "firmware": "ArduCopter V4.5",
        "axis": axis,
        "tier": "a",
        "duration": 60.0 + number,
        "flight_time": 90.0 + number,
        "lean_roll": 0.0,
        "lean_pitch": 0.0,
        "motors": MOTORS,
        "trim_share": (1.0, 0.98, 1.03, 0.99),
        "trim_share_interval": (0.01,) * 4,
        "effect": (-40.0, 40.0, 41.0, -39.0),
        "effect_interval": (2.0,) * 4,
        "effect_status": "reported",
        "damping": 0.6,
        "damping_interval": 0.2,
        "damping_status": "reported",
        "lag": 0.04,
        "lag_interval": 0.01,
        "lag_status": "reported",
        "wind_torque_sd": 0.8,
        "residual_mean": 0.01,
        "error_ratio": 0.2,
        "health": "ok",
        "page": f"pages/{vehicle}-{number}.html",
    }
    return FlightRow(**(values | changed))


def fleet_rows(flights):
    """So many flights of two axes each of five vehicles, of which the second has a fault at its end; 3 refused logs."""
    fault = {"health": "fault", "suspect_motor": 3, "fault_probability": 0.97}
    fault["health_reason"] = "motor 3 works harder."
    rows = [
        FlightRow(
            file=f"/logs/{number}.bin",
            key=f"bad{number}-1",
            status=f"It is cut off at {number}.",
            status_code="log_cut_off",
        )
        for number in range(3)
    ]
    for number in range(flights):
        flown, vehicle = divmod(number, 5)
        health_columns = fault if vehicle == 1 and flown > 0.7 * flights / 5 else {}
        damping = 0.6 + 0.01 * flown if number % 4 else None
        for axis in ("roll", "pitch"):
            rows.append(
                flight_row(f"quad-{vehicle}", flown, axis, damping=damping, **health_columns)
            )
    return rows
