"""GP-EKF and robust path following of a slung load transport system, section VI of the paper."""
