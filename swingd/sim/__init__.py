"""A simulated autopilot with vehicle and slung load, for tests, the demo and anybody's MAVLink tool."""
