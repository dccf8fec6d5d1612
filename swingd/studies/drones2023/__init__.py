"""Drones 2023, 7, 654: swing EKF, its FGDF baseline and the payload controller, sections 4.1 and 4.2."""
