"""The simulated vehicle and load behind a real autopilot: its external simulator."""
