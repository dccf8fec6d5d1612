"""Escareno et al., ICINCO 2016: extended-state Kalman filter and hierarchical control with a rod-suspended load."""
