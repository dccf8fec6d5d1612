"""What passes from the autopilot to the endpoints does so before anything is computed from it."""

from swingd.engine import TICK_S, Delivery, Engine
from swingd.link.codec import Framer
from swingd.link.router import AUTOPILOT, port_of
from swingd.model.actions import Action, SwingReport
from swingd.model.parameters import Parameters
from swingd.sim.lockstep import Lockstep
from swingd.sim.peer import SimulatedAutopilot


def test_frames_pass_before_the_filter_looks_at_them_and_nothing_else_changes() -> None:
    parameters = Parameters()
    order: list[str] = []
    passed: list[Delivery] = []

    def on_passed(deliveries: list[Delivery]) -> None:
        order.append("passed")
        passed.extend(deliveries)

    def on_action(_t_s: float, action: Action) -> None:
        if isinstance(action, SwingReport):
            order.append("computed")

    plain, quick = Engine(parameters), Engine(parameters, on_action, on_passed=on_passed)
    ground = port_of(0, 0)
    for engine in (plain, quick):
        engine.open_port(0.0, ground)
        engine.join(0.0)
    framers = Framer(), Framer()
    computed = tick_s = 0.0

    def companion(t_s: float, data: bytes) -> bytes:
        nonlocal computed, tick_s
        order.clear()
        passed.clear()
        whole = plain.receive(t_s, AUTOPILOT, framers[0].receive(data))
        rest = quick.receive(t_s, AUTOPILOT, framers[1].receive(data))
        assert passed + rest == whole
        assert {port for port, _ in passed} <= {ground}
        if "computed" in order:
            assert order == ["passed", "computed"]
            computed += 1
        if t_s >= tick_s:
            tick_s += TICK_S
            ticked = plain.tick(t_s)
            assert quick.tick(t_s) == ticked
            whole += ticked
        return b"".join(frame for port, frame in whole if port == AUTOPILOT)

    Lockstep(SimulatedAutopilot(parameters), companion).run_until(4.0)
    assert computed > 200
