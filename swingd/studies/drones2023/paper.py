"""What the paper prints: Tables 2, 3 and 5, and the text around them."""

UNITS = {
    "t_m": "s",
    "chi_bar": "deg",
    "nu_bar": "deg/s",
    "d_bar": "m",
    "energy": "kJ",
    "chi_integral": "deg s",
    "nu_integral": "deg/√s",
    "distance_to_go": "m",
}
"""Of the indices, in the order of the tables; the last one is not the paper's."""

VALUES: dict[str, dict[str, dict[str, float]]] = {
    "case1": {
        "off": {"t_m": 35.4, "chi_bar": 4.20, "nu_bar": 5.53, "d_bar": 0.33, "energy": 820.7},
        "on": {"t_m": 23.9, "chi_bar": 4.16, "nu_bar": 5.82, "d_bar": 0.63, "energy": 553.9},
    },
    "case2": {
        "off": {"t_m": 66.9, "chi_bar": 3.99, "nu_bar": 5.04, "energy": 1553.1},
        "on": {"t_m": 49.0, "chi_bar": 2.66, "nu_bar": 3.86, "energy": 1136.5},
    },
    "case3": {
        "off": {"t_m": 140.3, "chi_bar": 2.22, "nu_bar": 1.86, "d_bar": 6.49, "energy": 3242.5},
        "on": {"t_m": 139.8, "chi_bar": 1.71, "nu_bar": 1.21, "d_bar": 6.48, "energy": 3230.1},
        "fgdf": {"t_m": 140.3, "chi_bar": 1.77, "nu_bar": 1.27, "d_bar": 6.52, "energy": 3249.9},
    },
}
"""By case, variant and index."""

CHANGES_PERCENT: dict[str, dict[str, dict[str, float]]] = {
    "case1": {
        "on": {
            "t_m": -32.6,
            "chi_bar": -1.0,
            "nu_bar": 5.2,
            "d_bar": 90.9,
            "energy": -32.5,
            "chi_integral": -33.2,
            "nu_integral": -13.7,
        }
    },
    "case2": {
        "on": {
            "t_m": -26.8,
            "chi_bar": -33.3,
            "nu_bar": -23.4,
            "energy": -26.8,
            "chi_integral": -51.1,
            "nu_integral": -34.4,
        }
    },
    "case3": {
        "on": {"t_m": -0.4, "chi_bar": -23.0, "nu_bar": -34.9, "d_bar": -0.2, "energy": -0.4},
        "fgdf": {"t_m": 0.0, "chi_bar": -20.3, "nu_bar": -31.7, "d_bar": 0.5, "energy": 0.2},
    },
}
"""Against "off", by case, variant and index."""

SETTLED_S = {"off": 24.6, "on": 13.5}
"""Case 1: chi under 5 % of its beginning."""
STEADY_FORCE_Y_N = -1.3
"""Case 2 with payload controller: mean of the estimated lateral disturbance between 20 and 30 s."""
