"""Source follower: a unity-gain buffer whose bias sets a first-order bandwidth."""

from __future__ import annotations

import math
from collections.abc import Mapping

from pixelid.parameters.parameter import Parameter
from pixelid.stages.circuit import Circuit
from pixelid.stages.effect import Effect


class SourceFollowerPole(Effect):
    name = "source_follower_pole"
    stage = "source_follower"
    sentence = "The source follower limits the bandwidth with a first-order pole that does not move with light."
    equation = "d ysf/dt = ωsf (y − ysf)"
    source = "Low & Lee, arXiv 2409.17988 (3122 Hz: DVS128 reference simulator)"
    parameters = (Parameter("sf_cutoff_hz", 3122.0, "Hz", 1e-2, 1e7, "log"),)
    vanishes_at = math.inf
    trades_places = True

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(follower=2.0 * math.pi * values["sf_cutoff_hz"])


class ExtraPole(Effect):
    name = "extra_pole"
    stage = "source_follower"
    sentence = "One more first-order pole after the source follower."
    equation = "d ye/dt = ωe (ysf − ye)"
    source = "docs/model.md: a chain of poles behind the photoreceptor"
    parameters = (Parameter("extra_pole.cutoff_hz", 1500.0, "Hz", 1e-2, 1e7, "log"),)
    vanishes_at = math.inf
    tried_after = ("source_follower_pole", "differencing_pole")
    trades_places = True

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(extra_pole=2.0 * math.pi * values["extra_pole.cutoff_hz"])


class SlewLimit(Effect):
    name = "slew_limit"
    stage = "source_follower"
    sentence = "Large steps are slew-limited: the follower's rate is capped, differently up and down."
    equation = "d ysf/dt = clip(ωsf (y − ysf), −fall, +rise)"
    source = "docs/model.md: a bias current that charges a load"
    parameters = (
        Parameter("slew_limit.rise_per_s", 3000.0, "1/s", 1e-2, 1e9, "log"),
        Parameter("slew_limit.fall_per_s", 3000.0, "1/s", 1e-2, 1e9, "log"),
    )
    vanishes_at = math.inf
    requires = ("source_follower_pole", "differencing_pole")

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(slew_rise=values["slew_limit.rise_per_s"], slew_fall=values["slew_limit.fall_per_s"])


class LowerCutoff(Effect):
    name = "lower_cutoff"
    stage = "source_follower"
    sentence = "A first-order high-pass lets slow changes fade before they reach a threshold."
    equation = "dz/dt = ωhp (ysf − z), output ysf − z"
    source = "Low & Lee, arXiv 2409.17988, supplement"
    parameters = (Parameter("lower_cutoff.cutoff_hz", 0.5, "Hz", 1e-5, 1e4, "log"),)

    def apply(self, circuit: Circuit, values: Mapping[str, float]) -> Circuit:
        return circuit.with_(lower_cutoff=2.0 * math.pi * values["lower_cutoff.cutoff_hz"])


EFFECTS = (SourceFollowerPole(), ExtraPole(), SlewLimit(), LowerCutoff())
