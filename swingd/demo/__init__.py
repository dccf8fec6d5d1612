"""The demonstration: one manoeuvre flown twice on a simulated PX4, measured and drawn."""
