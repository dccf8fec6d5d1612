"""Payload state estimation for cooperative manipulation using multiple UAVs (tether UKF), recomputed."""
