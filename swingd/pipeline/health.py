"""The age of every input, and what swingd makes of it."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field

from swingd.model.actions import Health, Severity, StatusText, StreamRequest
from swingd.model.events import Stream
from swingd.model.parameters import Parameters
from swingd.pipeline.payload_state import PayloadState

RATE_WINDOW_S = 2.0
ARRIVALS_MAX = 8192
"""Kept of one stream: four times what may be asked for, so that no flood fills the memory."""
REQUEST_EVERY_S = 2.0
REQUESTS_BEFORE_COMPLAINT = 4
RATE_SHARE = 0.75
"""Of the rate asked for: PX4 delivers 224 Hz where 250 are asked, 125 where 200 are."""
LATE_S = 0.1
"""IMU and attitude older than this make the correction fade."""
SETTLE_S = 2.0
"""Time after a reset for which the filter must have been consistent before it may be used, and the angles' deviation
that it must have reached by then."""
ANGLE_STD_READY_RAD = 0.12
NIS_MAX = 20.0
"""Mean normalised innovation squared, 3 degrees of freedom, beyond which the filter and the world disagree."""
NIS_TIME_CONSTANT_S = 0.5
ROUND_TRIP_MAX_S = 0.2
"""To the autopilot and back; beyond it the correction would come too late to damp and soon in time to drive."""
ROUND_TRIP_SILENCE_S = 0.8
"""Without an answer for longer, where there were answers, the link is taken to be that slow: eight lost in a row, which
happens every ten minutes where a fifth is lost each way."""
CLOCK_REQUEST_S = 0.1
CLOCK_REQUEST_UNANSWERED_S = 1.0
HEARTBEAT_LATE_S = 3.0
"""A mode that was not reported for longer is not known."""
HEARTBEAT_LOST_S = 5.0


@dataclass(slots=True)
class _Watched:
    """A stream that is asked for."""

    rate_hz: float
    arrivals: deque[float] = field(default_factory=lambda: deque(maxlen=ARRIVALS_MAX))
    """In order, none older than the window."""
    last_s: float | None = None
    requests: int = 0
    asked_s: float = -1e9
    complained: bool = False
    refused: str | None = None


@dataclass(frozen=True, slots=True)
class StreamState:
    """What is known of one input."""

    stream: Stream
    asked_hz: float
    got_hz: float
    age_s: float | None
    """None before the first arrival."""
    refused: str | None


class StreamWatch:
    """Measures what arrives, asks for what is missing, and says what does not come and why."""

    def __init__(self, parameters: Parameters) -> None:
        rates = {
            Stream.IMU: parameters.link.imu_rate_hz,
            Stream.ATTITUDE: 100.0,
            Stream.THROTTLE: 100.0,
            Stream.MOTORS: 100.0,
            Stream.BATTERY: 10.0,
            Stream.LOCAL_POSITION: 50.0,
            Stream.LANDED_STATE: 2.0,
        }
        self.rates_hz = rates
        """What is asked for [Hz]."""
        self._watched = {stream: _Watched(rate) for stream, rate in rates.items()}

    def arrived(self, stream: Stream, t_mono_s: float) -> None:
        """Note one arrival."""
        watched = self._watched[stream]
        if watched.last_s is not None and t_mono_s < watched.last_s:
            return
        watched.last_s = t_mono_s
        watched.arrivals.append(t_mono_s)
        _forget(watched.arrivals, t_mono_s)

    def restarted(self) -> None:
        """The autopilot restarted: it has forgotten every request."""
        for watched in self._watched.values():
            watched.requests = 0
            watched.asked_s = -1e9
            watched.complained = False
            watched.refused = None

    def refused(self, stream: Stream, reason: str) -> None:
        """Note a denied request."""
        self._watched[stream].refused = reason

    def age_s(self, stream: Stream, t_mono_s: float) -> float | None:
        """Time since the last arrival [s]."""
        last_s = self._watched[stream].last_s
        return t_mono_s - last_s if last_s is not None else None

    def state(self, stream: Stream, t_mono_s: float) -> StreamState:
        """Return what is known of one stream."""
        watched = self._watched[stream]
        _forget(watched.arrivals, t_mono_s)
        got_hz = len(watched.arrivals) / RATE_WINDOW_S
        return StreamState(stream, watched.rate_hz, got_hz, self.age_s(stream, t_mono_s), watched.refused)

    def tick(self, t_mono_s: float, armed: bool) -> list[StreamRequest | StatusText]:
        """Ask again for what arrives too slowly, ever less often; complain once for each stream.

        Without being armed an autopilot drives no motors, and their outputs are nothing to complain about.
        """
        actions: list[StreamRequest | StatusText] = []
        for stream, watched in self._watched.items():
            wait_s = REQUEST_EVERY_S * min(1 + watched.requests // REQUESTS_BEFORE_COMPLAINT, 8)
            if t_mono_s - watched.asked_s < wait_s:
                continue
            got_hz = self.state(stream, t_mono_s).got_hz
            if got_hz >= RATE_SHARE * watched.rate_hz:
                watched.requests = 0
                watched.complained = False
                continue
            expected = armed or stream not in (Stream.MOTORS, Stream.THROTTLE)
            if watched.requests >= REQUESTS_BEFORE_COMPLAINT and not watched.complained and expected:
                watched.complained = True
                why = f"refused: {watched.refused}" if watched.refused else "link or autopilot gives no more"
                text = f"{stream.value}: asked {watched.rate_hz:.4g} Hz, got {got_hz:.4g} Hz ({why})"
                actions.append(StatusText(Severity.WARNING, text))
            watched.requests += 1
            watched.asked_s = t_mono_s
            actions.append(StreamRequest(stream, watched.rate_hz))
        return actions


def _forget(arrivals: deque[float], t_mono_s: float) -> None:
    """Drop what is older than the window; the rate is then a length, whatever the stream."""
    while arrivals and arrivals[0] <= t_mono_s - RATE_WINDOW_S:
        arrivals.popleft()


class RoundTripWatch:
    """How long the link takes to the autopilot and back; ages alone do not show a link that delays everything."""

    def __init__(self) -> None:
        self.restarted()

    def restarted(self) -> None:
        """Forget every answer."""
        self._answers_s: deque[float] = deque(maxlen=3)
        self._answered_s: float | None = None
        self._asked_s = float("-inf")

    def request_due(self, t_mono_s: float) -> bool:
        """Whether to ask now; an autopilot that never answered is asked less often."""
        every_s = CLOCK_REQUEST_UNANSWERED_S if self._answered_s is None else CLOCK_REQUEST_S
        if t_mono_s - self._asked_s < every_s - 1e-6:
            return False
        self._asked_s = t_mono_s
        return True

    def answered(self, t_mono_s: float, round_trip_s: float) -> None:
        """Take an answer."""
        self._answers_s.append(round_trip_s)
        self._answered_s = t_mono_s

    def is_slow(self, t_mono_s: float) -> bool:
        """Whether setpoints come too late; not known, and taken for a no, where the autopilot never answered."""
        if self._answered_s is None:
            return False
        if t_mono_s - self._answered_s > ROUND_TRIP_SILENCE_S:
            return True
        return sorted(self._answers_s)[len(self._answers_s) // 2] > ROUND_TRIP_MAX_S


@dataclass(frozen=True, slots=True)
class Evidence:
    """What health depends on at one instant; where a field is not True it tells against swingd."""

    imu_heard: bool
    """Ever."""
    attitude_heard: bool
    imu_present: bool
    """Not silent for longer than a gap that the filter can bridge."""
    attitude_present: bool
    heartbeat: bool
    """The autopilot's HEARTBEAT is not lost; True before the first."""
    finite: bool
    """The filter does not diverge again and again."""
    payload: PayloadState
    settled: bool
    """The filter has been consistent for long enough since it began, and then certain."""
    fresh: bool
    """IMU and attitude are not late."""
    link: bool
    """The link is fast enough to damp by."""
    certain: bool
    """The covariance of the angles is within its bound."""
    consistent: bool
    """The innovations are as large as their covariance promises."""


_Rule = tuple[Callable[[Evidence], bool], Health, Callable[[Evidence], str]]


def _says(text: str) -> Callable[[Evidence], str]:
    return lambda _evidence: text


_RULES: tuple[_Rule, ...] = (
    (lambda e: e.imu_heard, Health.INIT, _says("waiting for the autopilot's IMU")),
    (lambda e: e.attitude_heard, Health.INIT, _says("waiting for the autopilot's attitude")),
    # The same words for as long as it lasts: they are told once.
    (lambda e: e.imu_present, Health.FAULT, _says("the IMU has stopped")),
    (lambda e: e.attitude_present, Health.FAULT, _says("the attitude has stopped")),
    (lambda e: e.heartbeat, Health.FAULT, _says(f"no HEARTBEAT for more than {HEARTBEAT_LOST_S:g} s")),
    (lambda e: e.finite, Health.FAULT, _says("the filter diverged three times in 10 s")),
    (lambda e: e.payload.hangs, Health.INIT, lambda e: e.payload.value),
    (lambda e: e.settled, Health.INIT, _says("the estimate is settling")),
    (lambda e: e.fresh, Health.DEGRADED, _says("IMU or attitude late")),
    (lambda e: e.payload is PayloadState.ATTACHED, Health.DEGRADED, lambda e: e.payload.value),
    (lambda e: e.link, Health.DEGRADED, _says(f"link slower than {ROUND_TRIP_MAX_S:g} s there and back")),
    (lambda e: e.certain, Health.DEGRADED, _says("the estimate is uncertain")),
    (lambda e: e.consistent, Health.DEGRADED, _says("measurements and model disagree")),
)
"""What must hold, the state where it does not, and its reason; the first that does not hold counts."""

_RECOVERY_S = {Health.INIT: 0.0, Health.READY: 0.0, Health.DEGRADED: 0.5, Health.FAULT: 0.5}
"""For how long everything must hold before a state gives way to READY: what flickers is not to be trusted."""


@dataclass(frozen=True, slots=True)
class Assessment:
    """Health without regard to whether a correction is being given."""

    health: Health
    """INIT, READY, DEGRADED or FAULT."""
    reason: str


def judge(evidence: Evidence) -> Assessment:
    """Return the state that this instant asks for, without regard to the one before."""
    for holds, health, reason in _RULES:
        if not holds(evidence):
            return Assessment(health, reason(evidence))
    return Assessment(Health.READY, "")


class HealthWatch:
    """Judges inputs and estimate."""

    def __init__(self, parameters: Parameters) -> None:
        self._max_gap_s = parameters.estimator.max_gap_s
        self._nis_gate = parameters.estimator.nis_gate
        self.round_trip = RoundTripWatch()
        self.assessment = Assessment(Health.INIT, "waiting for the autopilot's IMU")
        """As of the last `assess`."""
        self._begin()
        self._resets_s: deque[float] = deque(maxlen=3)
        self._doubted_s = float("-inf")

    def reset(self, t_mono_s: float, fault: bool) -> None:
        """Note that the estimator began anew; ``fault`` where it had to."""
        self._begin()
        if fault:
            self._resets_s.append(t_mono_s)

    def _begin(self) -> None:
        self._settled_s = 0.0
        self._was_certain = False
        self._nis = 0.0
        self._std_rad = float("inf")

    def step(self, dt_s: float, nis: float, std_rad: float) -> None:
        """Note one filter step with its innovation and the larger of the angles' deviations."""
        self._nis += dt_s / (dt_s + NIS_TIME_CONSTANT_S) * (min(nis, self._nis_gate) - self._nis)
        self._std_rad = std_rad
        if self._settled_s < SETTLE_S:
            self._settled_s = self._settled_s + dt_s if self._nis <= NIS_MAX else 0.0
        self._was_certain |= self._settled_s >= SETTLE_S and std_rad <= ANGLE_STD_READY_RAD

    def evidence(
        self, t_mono_s: float, streams: StreamWatch, payload: PayloadState, heartbeat_age_s: float | None
    ) -> Evidence:
        """Gather what is known at this instant; ``heartbeat_age_s`` is None before the autopilot's first HEARTBEAT."""
        imu_s = streams.age_s(Stream.IMU, t_mono_s)
        attitude_s = streams.age_s(Stream.ATTITUDE, t_mono_s)
        oldest_s = max(_or_never(imu_s), _or_never(attitude_s))
        return Evidence(
            imu_heard=imu_s is not None,
            attitude_heard=attitude_s is not None,
            imu_present=_or_never(imu_s) <= self._max_gap_s,
            attitude_present=_or_never(attitude_s) <= self._max_gap_s,
            heartbeat=heartbeat_age_s is None or heartbeat_age_s <= HEARTBEAT_LOST_S,
            finite=math.isfinite(self._nis) and (len(self._resets_s) < 3 or t_mono_s - self._resets_s[0] >= 10.0),
            payload=payload,
            settled=self._was_certain,
            fresh=oldest_s <= LATE_S,
            link=not self.round_trip.is_slow(t_mono_s),
            certain=self._std_rad <= ANGLE_STD_READY_RAD,
            consistent=self._nis <= NIS_MAX,
        )

    def assess(self, t_mono_s: float, evidence: Evidence) -> Assessment:
        """Advance the state: at once to a worse one, to READY once nothing has spoken against it for a while."""
        asked = judge(evidence)
        if asked.health is not Health.READY:
            self._doubted_s = t_mono_s
        elif t_mono_s - self._doubted_s < _RECOVERY_S[self.assessment.health]:
            return self.assessment
        self.assessment = asked
        return asked


def _or_never(age_s: float | None) -> float:
    return float("inf") if age_s is None else age_s
