"""What section VI of the paper prints."""

VALUES: dict[str, dict[str, float]] = {
    "square": {
        "lateral_rms": 0.4381,
        "lateral_max": 1.676,
        "vertical_rms": 0.04343,
        "vertical_max": 0.1157,
        "swing_level_max": 0.1380,
        "swing_max": 0.2609,
        "swing_rate_level_max": 0.4188,
        "swing_rate_max": 0.8264,
        "velocity_error_rms": 0.7492,
        "velocity_error_max": 3.512,
    },
    # The vertical RMS of the circle, 0.5515 m, is larger than the vertical maximum printed beside it: left out.
    "circle": {
        "lateral_rms": 0.4619,
        "lateral_max": 1.040,
        "vertical_max": 0.1182,
        "velocity_error_rms": 0.6912,
        "velocity_error_max": 1.4306,
    },
    "outdoor": {
        "lateral_rms": 0.7519,
        "lateral_max": 1.766,
        "vertical_rms": 0.5468,
        "vertical_max": 0.9413,
        "recovered": 5.26,
        "swing_max": 0.3532,
        "swing_rate_max": 1.384,
        "velocity_error_rms": 1.321,
        "velocity_error_max": 3.3718,
    },
}
UNITS = {
    "lateral_rms": "m",
    "lateral_max": "m",
    "vertical_rms": "m",
    "vertical_max": "m",
    "recovered": "s",
    "swing_level_max": "m",
    "swing_max": "m",
    "swing_rate_level_max": "m/s",
    "swing_rate_max": "m/s",
    "velocity_error_rms": "m/s",
    "velocity_error_max": "m/s",
}
REL_POS_RMSE_M = {"gp_ekf": 0.1377, "camera": 0.1234}
"""Section VI.B; the text there says that the filter is better, the figures say the camera is."""
REL_POS_MAX_M = {"gp_ekf": 0.6766, "camera": 0.8177}
