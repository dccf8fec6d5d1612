"""Simulated hours of flight, with everything that can go wrong, and what becomes of memory, latency and health."""
