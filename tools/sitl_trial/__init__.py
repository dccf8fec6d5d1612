"""Trial flights of swingd on a real autopilot in the loop (SITL)."""
