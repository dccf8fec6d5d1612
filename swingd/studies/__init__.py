"""The papers' cases, recomputed: scenario, indicators, printed figures beside ours, pictures."""
