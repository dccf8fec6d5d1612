"""A trained Gaussian process of the cable's acceleration error, (17) of the GP-EKF paper, and its file."""

import json
import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from swingd.core.gaussian_process import NUM_OUTPUTS, NUM_SWING_FEATURES, SAMPLES_MAX, predict, prepare
from swingd.core.status import Status
from swingd.model.errors import ConfigurationError
from swingd.model.estimate import FloatArray

FORMAT = "swingd-acceleration-model"
VERSION = 1
FEATURES = ("r_n_m", "r_e_m", "v_n_mps", "v_e_mps", "v_p_n_mps", "v_p_e_mps")
"""Vehicle relative to the load, ned: position and velocity, (17); and, in wider models, the load's velocity."""
SWING_FEATURES = FEATURES[:NUM_SWING_FEATURES]
"""Of (17)."""
OUTPUTS = ("acc_n_mps2", "acc_e_mps2")
"""What v' is more than the rigid cable's equation says."""
TRAINED_SHARE_MAX = 0.1
"""What it was trained for may differ from what it is used for by this share."""
NUMBER_MAX = 1e6
"""No number of the file is larger."""


@dataclass(frozen=True, slots=True)
class Prepared:
    """What the kernels take, see `swingd.core.gaussian_process`."""

    Z: FloatArray
    weights: FloatArray
    K_inv: FloatArray
    inv_sq_scales: FloatArray
    signal_var: FloatArray
    load_share: float = 0.0
    """See `AccelerationModel.load_share`."""


NOTHING_LEARNED = Prepared(np.empty((0, 4)), np.empty((0, 2)), np.empty((0, 0)), np.ones((2, 4)), np.ones(2))
"""No Gaussian process: the plain EKF."""


@dataclass(frozen=True, slots=True)
class TrainedFor:
    """The rigid cable's equation whose error was learned."""

    mass_kg: float
    payload_mass_kg: float
    cable_length_m: float


@dataclass(frozen=True, slots=True)
class AccelerationModel:
    """Hyperparameters and the bounded set of samples; two independent processes, north and east."""

    trained_for: TrainedFor
    scales: FloatArray
    """(2, k) length scale of each feature [m], [m/s], by output; k 4 or 6."""
    signal_std: FloatArray
    """(2,) sigma_f [m/s^2]."""
    features: FloatArray
    """(m, k), m <= SAMPLES_MAX: r [m], v [m/s], v_p [m/s], as `FEATURES`."""
    targets: FloatArray
    """(m, 2) [m/s^2]; each the mean of neighbouring samples."""
    target_std: FloatArray
    """(m, 2) deviation of each mean: sigma_n over the root of how many it is made of [m/s^2]."""
    load_share: float = 0.0
    """How much of the error pushes the load, the rest pushes the vehicle, 0..1; 0 is the careful guess."""

    def misfit(self, mass_kg: float, payload_mass_kg: float, cable_length_m: float) -> str:
        """Say why it is not of a vehicle, a load and a cable; empty where it is, within `TRAINED_SHARE_MAX`."""
        trained = self.trained_for
        for name, now, then in (
            ("vehicle.mass_kg", mass_kg, trained.mass_kg),
            ("payload.mass_kg", payload_mass_kg, trained.payload_mass_kg),
            ("cable.length_m", cable_length_m, trained.cable_length_m),
        ):
            if not math.isclose(now, then, rel_tol=TRAINED_SHARE_MAX):
                return f"trained for {name} {then:g}, configured is {now:g}"
        return ""

    def prepare(self) -> Prepared:
        """Compute once what the filter needs at every step.

        Raises
        ------
        ConfigurationError
            If the samples' covariance is not positive definite.
        """
        count = self.features.shape[0]
        weights, K_inv = np.empty((count, NUM_OUTPUTS)), np.empty((NUM_OUTPUTS * count, count))
        inv_sq_scales = np.ascontiguousarray(self.scales**-2.0)
        signal_var = self.signal_std**2
        noise_var = np.ascontiguousarray(self.target_std**2)
        status = prepare(weights, K_inv, self.features, self.targets, inv_sq_scales, signal_var, noise_var)
        if status != Status.OK:
            raise ConfigurationError("acceleration model: the samples' covariance is not positive definite")
        return Prepared(self.features, weights, K_inv, inv_sq_scales, signal_var, self.load_share)

    def to_json(self) -> str:
        """Return the file's text; the numbers survive it exactly."""
        return json.dumps(
            {
                "format": FORMAT,
                "version": VERSION,
                "trained_for": asdict(self.trained_for),
                "features": FEATURES[: self.features.shape[1]],
                "outputs": OUTPUTS,
                "length_scales": self.scales.tolist(),
                "signal_std": self.signal_std.tolist(),
                "load_share": self.load_share,
                "samples": {
                    "features": self.features.tolist(),
                    "targets": self.targets.tolist(),
                    "target_std": self.target_std.tolist(),
                },
            },
            indent=1,
            allow_nan=False,
        )

    @classmethod
    def from_json(cls, text: str, name: str) -> "AccelerationModel":
        """Read a file's text.

        Parameters
        ----------
        text : str
        name : str
            Of the file, for the message.

        Raises
        ------
        ConfigurationError
            If it is of another format or version, or a value is missing, of the wrong shape or out of range.
        """
        reader = _Reader(name)
        try:
            content = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise reader.refuse("file", "no JSON", f"expected a model by swingd gp train ({error})") from None
        if not isinstance(content, dict):
            raise reader.refuse("file", type(content).__name__, "expected an object")
        for key, wanted in (("format", FORMAT), ("version", VERSION)):
            if content.get(key) != wanted or isinstance(content.get(key), bool):
                raise reader.refuse(key, content.get(key), f"expected {wanted!r}")
        for key, known in (("features", (SWING_FEATURES, FEATURES)), ("outputs", (OUTPUTS,))):
            if content.get(key) not in [list(names) for names in known]:
                expected = " or ".join(str(list(names)) for names in known)
                raise reader.refuse(key, content.get(key), f"expected {expected}")
        width = len(content["features"])
        samples = reader.mapping(content, "samples")
        features = reader.array(samples, "samples.features", (None, width))
        count = features.shape[0]
        trained_for = reader.mapping(content, "trained_for")
        return cls(
            TrainedFor(
                *(reader.positive(trained_for, f"trained_for.{key}") for key in TrainedFor.__dataclass_fields__)
            ),
            reader.array(content, "length_scales", (NUM_OUTPUTS, width), positive=True),
            reader.array(content, "signal_std", (NUM_OUTPUTS,), positive=True),
            features,
            reader.array(samples, "samples.targets", (count, NUM_OUTPUTS)),
            reader.array(samples, "samples.target_std", (count, NUM_OUTPUTS), positive=True),
            reader.share(content, "load_share"),
        )


def correction(prepared: Prepared, features: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Give mean and variance at many points, (n, k) -> (n, 2), (n, 2) [m/s^2], [(m/s^2)^2]."""
    mean, var, J = np.empty((len(features), 2)), np.empty((len(features), 2)), np.empty((2, features.shape[1]))
    p = prepared
    for row, z in enumerate(np.ascontiguousarray(features)):
        predict(mean[row], var[row], J, z, p.Z, p.weights, p.K_inv, p.inv_sq_scales, p.signal_var)
    return mean, var


class _Reader:
    """Takes values out of a file's content and says what is wrong with them."""

    def __init__(self, name: str) -> None:
        self._name = name

    def refuse(self, key: str, value: object, expected: str) -> ConfigurationError:
        given = repr(value)
        return ConfigurationError(f"{self._name}: {key}: {given[:60]} given; {expected}")

    def mapping(self, content: dict[str, Any], key: str) -> dict[str, Any]:
        value = content.get(key)
        if not isinstance(value, dict):
            raise self.refuse(key, value, "expected an object")
        return value

    def positive(self, content: dict[str, Any], key: str) -> float:
        value = content.get(key.rpartition(".")[2])
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 < value <= NUMBER_MAX:
            raise self.refuse(key, value, f"expected a number over 0, at most {NUMBER_MAX:g}")
        return float(value)

    def share(self, content: dict[str, Any], key: str) -> float:
        value = content.get(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0.0 <= value <= 1.0:
            raise self.refuse(key, value, "expected a number between 0 and 1")
        return float(value)

    def array(
        self, content: dict[str, Any], key: str, shape: tuple[int | None, ...], positive: bool = False
    ) -> FloatArray:
        value = content.get(key.rpartition(".")[2])
        rows = value if isinstance(value, list) else []
        wanted = shape[0]
        bounded = 1 <= len(rows) <= SAMPLES_MAX if wanted is None else len(rows) == wanted
        expected = f"expected {f'1 to {SAMPLES_MAX}' if wanted is None else wanted}"
        expected += f" rows of {shape[1]} numbers" if len(shape) > 1 else " numbers"
        flat: list[object] = list(rows)
        if len(shape) > 1:
            bounded = bounded and all(isinstance(row, list) and len(row) == shape[1] for row in rows)
            flat = [number for row in rows for number in row] if bounded else []
        if not bounded:
            raise self.refuse(key, value, expected)
        for number in flat:
            if isinstance(number, bool) or not isinstance(number, int | float) or not math.isfinite(number):
                raise self.refuse(key, number, expected)
            if abs(number) > NUMBER_MAX or (positive and not number > 1.0 / NUMBER_MAX):
                low = f"{1.0 / NUMBER_MAX:g}" if positive else f"-{NUMBER_MAX:g}"
                raise self.refuse(key, number, f"expected numbers between {low} and {NUMBER_MAX:g}")
        return np.array(rows, dtype=float)
