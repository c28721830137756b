"""A posterior as ArviZ groups, and as posterior.nc.

posterior             every free parameter in its own unit, one chain per walker
physical              circuit values under the gauge, of evenly spaced draws
sample_stats          lp, the log posterior;  ensemble of each chain
log_likelihood        recording (given the thresholds' posterior), pixel (what leave-one-out leaves out)
posterior_predictive  ON and OFF events per recording, simulated at draws
observed_data         the same counts as recorded
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pixelid.errors import InputError
from pixelid.fit.result import FitResult
from pixelid.recordings.own_light import with_fine_light
from pixelid.recordings.recording import Recording
from pixelid.sample.drawn_groups import sampled_groups
from pixelid.sample.posterior import Posterior
from pixelid.stimuli.pixel_lights import in_a_row

PREDICTIVE_DRAWS = 10


def inference_data(
    posterior: Posterior,
    result: FitResult,
    recordings: Sequence[Recording],
    predictive_draws: int = PREDICTIVE_DRAWS,
    *,
    physical: dict[str, np.ndarray] | None = None,
):
    """The groups above as an `xarray.DataTree`, which ArviZ 1 reads and writes.

    Args:
        posterior: of `result`.
        result: the fit that was sampled.
        recordings: what it was fitted to.
        predictive_draws: how many draws are simulated; 0: none, and no group `posterior_predictive`.
        physical: circuit value → (draws,) under the gauge (`Posterior.physical`), for the group `physical`.
    """
    observed = counts(recordings)
    groups = {"observed_data": observed}
    if predictive_draws and result.observation == "event_times":
        drawn = predicted(posterior, result, recordings, predictive_draws)
        groups["posterior_predictive"] = {name: value[None] for name, value in drawn.items()}
    if physical is not None:
        groups["physical"] = {name: draws[None] for name, draws in physical.items()}
    return sampled_groups(posterior, groups, {key: ["recording_name"] for key in observed})


def counts(recordings: Sequence[Recording]) -> dict[str, np.ndarray]:
    """ON and OFF events per recording, (recordings,) each."""
    on = np.array([int((r.events.p == 1).sum()) for r in recordings])
    return {"on_events": on, "off_events": np.array([len(r.events) for r in recordings]) - on}


def predicted(posterior: Posterior, result: FitResult, recordings: Sequence[Recording], draws: int) -> dict:
    """ON and OFF events per recording, (draws, recordings), simulated at posterior draws with as many pixels."""
    from pixelid.simulate import simulate_row

    between = result.details.get("stimulus_between_samples", "linear")
    shown = []
    for r in recordings:
        light = with_fine_light(r, between).stimulus if r.stimulus is not None else None
        if light is not None:
            active = np.unique(r.events.pixel)
            shown.append((in_a_row(light, active), max(len(active), 1)))
    simulated: dict[str, list] = {"on_events": [], "off_events": []}
    for k, x in enumerate(posterior.thinned(draws)):
        model = posterior.coordinates.model_at(x)
        copies = [
            simulate_row(model, stimulus, pixels, seed=1000 * result.seed + len(shown) * k + i)
            for i, (stimulus, pixels) in enumerate(shown)
        ]
        for name, value in counts(copies).items():
            simulated[name].append(value)
    return {name: np.array(value) for name, value in simulated.items()}


def save(posterior: Posterior, result: FitResult, recordings: Sequence[Recording], folder: Path) -> dict:
    """Write posterior.nc, corner.svg and trace.svg into `folder`; returns what fit.json says about the posterior."""
    from pixelid.sample.figures import write_figures

    physical = None
    beside = ("recordings", "nuisances", "versions", "inputs_sha256")  # fit.json has them already
    summary = {name: value for name, value in posterior.as_dict().items() if name not in beside}
    try:
        physical = posterior.physical(result.model)
    except InputError as error:
        summary["physical"], summary["why_no_physical"] = None, str(error)
    else:
        summary["physical"] = {
            name: {"mean": float(v.mean()), "interval_95": np.quantile(v, [0.025, 0.975]).tolist()}
            for name, v in physical.items()
        }
    data = inference_data(posterior, result, recordings, physical=physical)
    # by way of memory: HDF5 ends the process where it meets a full disk
    (folder / "posterior.nc").write_bytes(data.to_netcdf(engine="h5netcdf"))
    write_figures(posterior, folder)
    return summary
