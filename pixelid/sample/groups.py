"""A posterior as ArviZ groups, and as posterior.nc.

posterior             every free parameter in its own unit, one chain per walker;  physical.* under the gauge
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
from pixelid.recordings.recording import Recording
from pixelid.sample.library import arviz
from pixelid.sample.posterior import Posterior
from pixelid.stimuli.resample import resampled

PREDICTIVE_DRAWS = 10


def inference_data(
    posterior: Posterior, result: FitResult, recordings: Sequence[Recording], predictive_draws: int = PREDICTIVE_DRAWS
):
    """An `arviz.InferenceData` with the groups above; nothing is simulated when `predictive_draws` is 0."""
    ensembles, steps, walkers, _ = posterior.chain.shape
    chains = ensembles * walkers

    def by_chain(a: np.ndarray) -> np.ndarray:
        return np.swapaxes(a, 1, 2).reshape(chains, steps, *a.shape[3:])

    pieces = by_chain(posterior.pieces)
    names = [r.name for r in recordings]
    r = len(names)
    likelihood = {"recording": pieces[..., :r]}
    dims = {"recording": ["recording_name"], "pixel": ["pixel_unit"]}
    coords: dict = {"recording_name": _distinct(names)}
    if pieces.shape[-1] > r + 1:
        likelihood["pixel"] = pieces[..., r + 1 :]
        coords["pixel_unit"] = np.arange(pieces.shape[-1] - r - 1)
    observed = counts(recordings)
    groups = {
        "posterior": posterior.values(),
        "sample_stats": {
            "lp": by_chain(posterior.log_prob),
            "ensemble": np.repeat(np.arange(ensembles), walkers)[:, None].repeat(steps, axis=1),
        },
        "log_likelihood": likelihood,
        "observed_data": observed,
    }
    for variable in observed:
        dims[variable] = ["recording_name"]
    if predictive_draws and result.observation == "event_times":
        drawn = predicted(posterior, result, recordings, predictive_draws)
        groups["posterior_predictive"] = {name: value[None] for name, value in drawn.items()}
    attributes = {"status": str(posterior.status), "model": result.model.name, "seed": int(posterior.details.get("seed", 0))}
    return arviz().from_dict(**groups, coords=coords, dims=dims, attrs=attributes)


def _distinct(names: list[str]) -> list[str]:
    return [name if names.count(name) == 1 else f"{name} #{i}" for i, name in enumerate(names)]


def counts(recordings: Sequence[Recording]) -> dict[str, np.ndarray]:
    """ON and OFF events per recording, (recordings,) each."""
    on = np.array([int((r.events.p == 1).sum()) for r in recordings])
    return {"on_events": on, "off_events": np.array([len(r.events) for r in recordings]) - on}


def predicted(posterior: Posterior, result: FitResult, recordings: Sequence[Recording], draws: int) -> dict:
    """ON and OFF events per recording, (draws, recordings), simulated at posterior draws with as many pixels."""
    from pixelid.simulate import simulate

    between = result.details.get("stimulus_between_samples", "linear")
    shown = [
        (resampled(r.stimulus, between), max(len(np.unique(r.events.pixel)), 1))
        for r in recordings
        if r.stimulus is not None
    ]
    found: dict[str, list] = {"on_events": [], "off_events": []}
    for k, x in enumerate(posterior.thinned(draws)):
        model = posterior.coordinates.model_at(x)
        copies = [
            simulate(model, stimulus, width=pixels, height=1, seed=1000 * result.seed + len(shown) * k + i)
            for i, (stimulus, pixels) in enumerate(shown)
        ]
        for name, value in counts(copies).items():
            found[name].append(value)
    return {name: np.array(value) for name, value in found.items()}


def save(posterior: Posterior, result: FitResult, recordings: Sequence[Recording], folder: Path) -> dict:
    """Write posterior.nc, corner.png and trace.png into `folder`; returns what fit.json says about the posterior."""
    from pixelid.sample.figures import write_corner, write_trace

    data = inference_data(posterior, result, recordings)
    said = posterior.as_dict()
    try:
        physical = posterior.physical(result.model)
    except InputError as error:
        said["physical"], said["why_no_physical"] = None, str(error)
    else:
        data.add_groups({"physical": _dataset(physical)}, warn_on_custom_groups=False)
        said["physical"] = {
            name: {"mean": float(v.mean()), "interval_95": np.quantile(v, [0.025, 0.975]).tolist()}
            for name, v in physical.items()
        }
    data.to_netcdf(str(folder / "posterior.nc"))
    write_corner(posterior, folder / "corner.png")
    write_trace(posterior, folder / "trace.png")
    return said


def _dataset(values: dict[str, np.ndarray]):
    import xarray

    return xarray.Dataset({name: (("chain", "draw"), value[None]) for name, value in values.items()})
