"""How the daemon is at this instant, as one JSON object: what `swingd status` shows."""

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import swingd
from swingd.engine import Engine
from swingd.model.actions import Health
from swingd.record.event_log import EventLogWriter
from swingd.service.links import Link
from swingd.service.meter import Meter

FORMAT = 1
"""Of the object; keys may be added without another number."""


@dataclass(frozen=True, slots=True)
class Standing:
    """Health and its reason, and since when both have been the same."""

    health: Health
    reason: str
    """Empty where it is good."""
    since_s: float
    """The host's monotonic clock [s]."""


def health_of(engine: Engine, load_problem: str = "") -> tuple[Health, str]:
    """Return the health and its reason, whether or not a pipeline has joined.

    Parameters
    ----------
    engine : Engine
        The daemon's.
    load_problem : str
        Why the filter could not be loaded; empty where it could, or is being loaded.
    """
    if engine.failure is not None:
        return Health.FAULT, f"{engine.failure}; everything passes uncorrected"
    if load_problem:
        return Health.FAULT, f"the filter cannot be loaded: {load_problem}; everything passes uncorrected"
    if not engine.has_joined:
        return Health.INIT, "loading the filter; everything passes uncorrected"
    return engine.pipeline.health, engine.pipeline.reason


def refusals(engine: Engine, links: Sequence[Link]) -> dict[str, dict[str, int]]:
    """Count what was not used or not passed, by reason, zeros left out.

    Returns
    -------
    dict
        ``drops``: frames and samples by adapter and engine; ``routing``: frames without a way; ``access``: whole frames
        that a link's key or systems refuse; ``framing``: what was no frame, by link; ``unsent``: by link, what nobody
        was there for or had room for; with a pipeline also ``refusals``: inputs by kind, and ``resets``: new beginnings
        of the estimate by reason.
    """
    by_link: dict[str, dict[str, int]] = {"access": {}, "framing": {}, "unsent": {}}
    for link in links:
        name, counters, transport = link.settings.name, link.counters, link.transport_counters
        by_link["access"] |= {
            f"{name} unsigned": counters.unsigned,
            f"{name} wrong_signature": counters.wrong_signature,
            f"{name} old_timestamp": counters.old_timestamp,
            f"{name} system_not_allowed": counters.system_not_allowed,
            f"{name} too_many_connections": transport.refused,
        }
        by_link["framing"] |= {
            f"{name} garbage_bytes": counters.framing.garbage_bytes,
            f"{name} bad_checksums": counters.framing.bad_checksums,
            f"{name} unknown_flags": counters.framing.unknown_flags,
        }
        by_link["unsent"][name] = transport.dropped
    counts = {
        "drops": {drop.value: count for drop, count in (engine.adapter.drops | engine.drops).items()},
        "routing": {refusal.value: count for refusal, count in engine.router.refusals.items()},
        **by_link,
    }
    if engine.has_joined:
        counts["refusals"] = dict(engine.pipeline.refusals)
        counts["resets"] = {reason.name.lower(): count for reason, count in engine.pipeline.resets.items()}
    return {kind: {reason: count for reason, count in of.items() if count} for kind, of in counts.items()}


def condition(
    t_mono_s: float,
    begun_s: float,
    configuration: Path | None,
    standing: Standing,
    engine: Engine,
    links: Sequence[Link],
    meter: Meter,
    event_log: EventLogWriter | None,
) -> dict[str, Any]:
    """Return everything at once, in JSON's types.

    Parameters
    ----------
    t_mono_s, begun_s : float
        The host's monotonic clock, now and at the start [s].
    """
    recent = meter.recent()
    told: dict[str, Any] = {
        "format": FORMAT,
        "version": swingd.__version__,
        "pid": os.getpid(),
        "configuration": None if configuration is None else str(configuration.absolute()),
        "uptime_s": t_mono_s - begun_s,
        "mode": engine.parameters.mode.value,
        "health": {
            "state": standing.health.value,
            "reason": standing.reason,
            "for_s": t_mono_s - standing.since_s,
        },
        "autopilot": _autopilot(engine),
        "payload": _payload(engine),
        "correction": _correction(engine),
        "disturbance": _disturbance(engine),
        "path": _path(engine),
        "camera": _camera(t_mono_s, engine),
        "filter": {
            "name": engine.parameters.estimator.name,
            "joined": engine.has_joined,
            "steps": recent.filter_steps,
            "rate_hz": recent.filter_hz,
            "asked_hz": engine.parameters.estimator.rate_hz,
        },
        "latency_ms": {"p50": recent.latency_ms_p50, "p99": recent.latency_ms_p99},
        "inputs": _inputs(t_mono_s, engine),
        "links": [
            {
                "name": link.settings.name,
                "url": str(link.settings.url),
                "state": link.state.value,
                "bytes_in": link.traffic[1],
                "bytes_out": link.traffic[0],
            }
            for link in links
        ],
        "counters": refusals(engine, links),
        "recording": None
        if event_log is None
        else {"file": str(event_log.path), "records": event_log.records, "lost": event_log.lost},
    }
    return told


def _autopilot(engine: Engine) -> dict[str, Any] | None:
    autopilot = engine.adapter.autopilot
    if autopilot is None:
        return None
    joined = engine.has_joined
    return {
        "kind": autopilot.kind.value,
        "system_id": autopilot.system_id,
        "armed": engine.pipeline.armed if joined else None,
        "flight_mode": engine.pipeline.flight_mode.value if joined else None,
    }


def _payload(engine: Engine) -> dict[str, Any] | None:
    if not engine.has_joined:
        return None
    pipeline = engine.pipeline
    return {"state": pipeline.payload.value, "reason": pipeline.payload_reason, "mass": asdict(pipeline.payload_mass)}


def _correction(engine: Engine) -> dict[str, Any]:
    enabled = engine.parameters.control.enabled
    if not engine.has_joined:
        return {"on": False, "enabled": enabled, "withheld_by": ["no filter runs"]}
    pipeline = engine.pipeline
    return {"on": pipeline.damping, "enabled": enabled, "withheld_by": list(pipeline.withheld_by)}


def _disturbance(engine: Engine) -> dict[str, Any] | None:
    """The force on the vehicle besides thrust and weight; None where none is estimated."""
    estimate = engine.pipeline.disturbance if engine.has_joined else None
    if estimate is None:
        return None
    pipeline = engine.pipeline
    return {
        "force_ned_n": list(estimate.force_ned_n),
        "std_n": list(estimate.force_std_n),
        "doubt": estimate.doubt,
        "fed_forward": any(pipeline.feed_forward_mps2),
        "withheld_by": list(pipeline.feed_forward_withheld_by),
    }


def _path(engine: Engine) -> dict[str, Any] | None:
    """How far mode path has led the load; None in any other mode."""
    progress = engine.pipeline.path if engine.has_joined else None
    if progress is None:
        return None
    return {
        **asdict(progress),
        "state": progress.state.value,
        "withheld_by": list(engine.pipeline.path_withheld_by),
    }


def _camera(t_mono_s: float, engine: Engine) -> dict[str, Any] | None:
    """What is known of the camera that sees the load; None where there is to be none."""
    camera = engine.pipeline.camera(t_mono_s) if engine.has_joined else None
    return None if camera is None else asdict(camera)


def _inputs(t_mono_s: float, engine: Engine) -> list[dict[str, Any]]:
    if not engine.has_joined:
        return []
    inputs = [asdict(state) for state in engine.pipeline.inputs(t_mono_s)]
    for state in inputs:
        state["stream"] = state["stream"].value
    return inputs
