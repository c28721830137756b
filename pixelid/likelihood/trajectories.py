"""Trajectories of one section of lights, remembered while thresholds, dead time, leak and delay change."""

from __future__ import annotations

from collections.abc import Sequence

from pixelid.dynamics import slew
from pixelid.dynamics.equations import PRESENT_BELOW
from pixelid.dynamics.of_circuit import dynamics_of
from pixelid.dynamics.slewed import slewed
from pixelid.dynamics.trajectory import Dynamics, Trajectory, integrate
from pixelid.likelihood.extremes import Output
from pixelid.stages.circuit import Circuit
from pixelid.stages.modulation import OF_LIGHT
from pixelid.stimuli.drive import StackedDrive, stacked_drive
from pixelid.stimuli.stimulus import Stimulus

APART = 4e-3  # least relative gap of follower and extra pole: closer ones are as good as this far apart, see `_apart`


class Trajectories:
    """The trajectories of one section: two are remembered at most, the latest asked for with `keep` and its light.

    What is remembered does not change any result.

    Args:
        lights: Full-field, one trajectory each.
        end_s: Until when, the last value held.
        remember: Whether to remember the latest trajectory; its light is remembered anyway.
    """

    def __init__(self, lights: Sequence[Stimulus], end_s: float, remember: bool = True) -> None:
        self._lights, self._end_s, self._remember = lights, end_s, remember
        self._latest: tuple[tuple, tuple[Trajectory, Output, StackedDrive]] | None = None
        self._light: tuple[tuple, StackedDrive] | None = None

    def of(self, circuit: Circuit, keep: bool) -> tuple[Trajectory, Output, StackedDrive]:
        """The trajectory of a circuit, its output (without its runs unless `keep`), and the light behind it.

        `keep` remembers them for circuits that differ in none of these: thresholds, dead time, leak and delay do not.
        """
        reaching = (
            circuit.light_gain, circuit.dark, circuit.flicker_modulation, circuit.flicker_hz, circuit.flicker_phase,
            circuit.knee, circuit.knee_slope, *(m for m in circuit.described if m.quantity in OF_LIGHT),
        )  # fmt: skip
        limit = (circuit.slew_rise, circuit.slew_fall)
        linear = slew.without_slew_limit(circuit)
        dynamics = dynamics_of(linear) if slew.slews(circuit) else _apart(dynamics_of(linear))
        key = (dynamics, circuit.linearisation, *limit, *reaching)
        latest, known = self._latest, self._light  # taken once: another thread may put its own there
        if latest is not None and latest[0] == key:
            return latest[1]
        light = known[1] if known is not None and known[0] == reaching else None
        if light is None:
            light = stacked_drive(self._lights, circuit, self._end_s)
            self._light = reaching, light
        if slew.slews(circuit):
            trajectory = slewed(light.t, light.rate_radiance, circuit, dynamics, light.first, light.log_radiance)
        else:
            trajectory = integrate(
                light.t, light.rate_radiance, dynamics, linearisation=circuit.linearisation,
                log_radiance=light.log_radiance, first=light.first,
            )  # fmt: skip
        made = trajectory, Output.of(trajectory) if keep else Output.without_runs(trajectory), light
        if keep and self._remember:
            self._latest = key, made
        return made

    def under(self, lights: Sequence[Stimulus]) -> Trajectories:
        """Trajectories under other lights, none of them made yet."""
        return Trajectories(lights, self._end_s, self._remember)

    def forget(self) -> None:
        """Drop the remembered trajectory."""
        self._latest = None


def _apart(dynamics: Dynamics) -> Dynamics:
    """The dynamics, with follower and extra pole at least `APART` from each other at the same total delay.

    Fits end where the two coincide, as their order leaves no trace.  There the closed form fails and steps cost ten
    times as much; a gap of 0.4 % moves the response to a step by 4e-6 of it.
    """
    first, second = dynamics.follower, dynamics.extra_pole
    if max(first, second) > PRESENT_BELOW or abs(first - second) >= APART * (first + second):
        return dynamics
    half = 0.5 * (1.0 / first + 1.0 / second)
    tilt = APART if first >= second else -APART
    return dynamics._replace(follower=1.0 / (half * (1.0 - tilt)), extra_pole=1.0 / (half * (1.0 + tilt)))
