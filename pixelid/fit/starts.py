"""Where a fit starts: the model's own values, made feasible for the data, and random starts around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pixelid.fit.own_values import in_event_times
from pixelid.likelihood.event_times import EventTimes
from pixelid.likelihood.pooled_rate import PooledRate, binned, delay_name
from pixelid.model.model import Model
from pixelid.recordings.recording import Recording
from pixelid.stimuli.stimulus import Stimulus

SILENCE = "dead_time_without_reset.s"
LOST, SCATTER, THRESHOLDS = "lost_events.fraction", "threshold_sigma", ("on_threshold", "off_threshold")


def feasible(model: Model, likelihood: EventTimes) -> Model:
    """The model with dead time below the observed intervals and thresholds that match the levels it predicts.

    Thresholds start at the median level at the events, threshold noise at its spread; fixed parameters stay.  A silence
    starts where intervals recur, or where it is if that explains the events better: its end is too sharp to climb to.
    What has its own value in each recording starts where it suits each best.
    """
    model = in_event_times(model, likelihood)
    changes: dict[str, float] = {}
    if "refractory_s" in model.free:
        parameter = model.parameter("refractory_s")
        changes["refractory_s"] = min(parameter.value, longest_dead_time(model, likelihood))
        model = model.set(changes)
    if SILENCE in model.free:
        model = _with_silence(model, likelihood)
    terms = likelihood.terms(model.circuit())
    told = ~terms.at_once
    on, off = (likelihood.sign > 0) & told, (likelihood.sign < 0) & told
    levels = {}
    for name, chosen in (("on_threshold", on), ("off_threshold", off)):
        parameter = model.parameter(name)
        levels[name] = parameter.value
        if chosen.any() and parameter.free:
            median = float(np.median(terms.z[chosen]))
            levels[name] = float(np.clip(median, 0.1 * parameter.value, 10.0 * parameter.value))
    expected = np.where(likelihood.sign > 0, levels["on_threshold"], levels["off_threshold"])
    relative = np.abs(terms.z / expected - 1.0)[told]
    if "threshold_sigma" in model.free and told.any():
        levels["threshold_sigma"] = float(np.clip(1.48 * np.median(relative), 0.02, 0.5))
    return model.set({name: model.parameter(name).within(levels[name]) for name in levels if name in model.free})


def narrower(model: Model, likelihood: EventTimes) -> Model | None:
    """Where lost events leave the thresholds scattered far more than most levels say: restarted from those.

    Any two events may have had a lost one between them if thresholds scatter by half: an optimum of its own, which the
    search does not leave, tens of thousands of nats below the other.
    """
    if LOST not in model.free or SCATTER not in model.free:
        return None
    by_levels = feasible(model, likelihood).values
    wider = 2.0  # times what most levels show; at the true optimum 1, at the other 5 or more
    if model.values[SCATTER] < wider * by_levels[SCATTER]:
        return None
    return model.set({name: by_levels[name] for name in (*THRESHOLDS, SCATTER) if name in model.free})


def _with_silence(model: Model, likelihood: EventTimes) -> Model:
    parameter = model.parameter(SILENCE)
    waits = [parameter.within(wait) for wait in likelihood.commonest_intervals_s()]
    starts = [model, *(model.set({SILENCE: wait}) for wait in waits)]
    return max(starts, key=lambda start: likelihood.log_likelihood(start.circuit()))


def longest_dead_time(model: Model, likelihood: EventTimes) -> float:
    """The longest dead time in seconds to start a fit at, within the parameter's bounds: below nearly all intervals."""
    parameter = model.parameter("refractory_s")
    return parameter.within(0.9 * likelihood.shortest_intervals_s(1e-3))


def random_starts(start: np.ndarray, count: int, rng: np.random.Generator, spread: float = 0.5) -> list[np.ndarray]:
    """`start` moved by independent uniform factors e^±spread, `count` times."""
    return [start + rng.uniform(-spread, spread, len(start)) for _ in range(count)]


def upright(recording: Recording) -> Recording:
    """The recording with its light upside down where that is of unit "shape" and ON events come where it falls.

    Which of two unknown levels is the brighter, the polarity of events says: by the delay at which ON less OFF events
    follow the steps of the light best, of either sign.
    """
    light = recording.stimulus
    if not isinstance(light, Stimulus) or light.unit != "shape" or not light.full_field:
        return recording
    latest_s, lag_s = 2e-3, 1e-4  # of a delay either way, and its steps
    counts = binned(recording, lag_s, np.inf)
    held = light.radiance[np.maximum(np.searchsorted(light.t, counts.edges, side="right") - 1, 0)]
    steps, excess = np.diff(held), counts.on - counts.off
    lags = range(-round(latest_s / lag_s), round(latest_s / lag_s) + 1)
    follows = max((float(excess @ np.roll(steps, lag)) for lag in lags), key=abs)
    if follows >= 0:
        return recording
    turned = light.radiance.max() + light.radiance.min() - light.radiance
    return replace(recording, stimulus=replace(light, radiance=turned))


def align(likelihood: PooledRate, model: Model, values: dict[str, float]) -> dict[str, float]:
    """The delays of the recordings, and for light of unknown level its scale, that suit the counts best.

    A delay that is off by more than an edge's width, or a bandwidth that is off by decades, has no useful gradient:
    both are searched on a grid (±2 ms; four decades of radiance scale, which moves α and γ together), by the share of
    the counts' variance that the rises and falls of the amplifier output explain.
    """
    unknown_light = "stimulus.offset" in values and model.photoreceptor == "second_order"
    best: tuple[float, dict[str, float]] = (-1.0, {})
    for scale in np.logspace(0, 4, 9) if unknown_light else (1.0,):
        trial = dict(values)
        if unknown_light:
            trial |= {name: values[name] * float(scale) for name in ("alpha", "gamma")}
        circuit = model.circuit(trial)
        delays, score = {}, 0.0
        for i, counts in enumerate(likelihood.counts):
            name = delay_name(likelihood.recordings, i)
            scores = {}
            for delay in np.arange(-2e-3, 2.01e-3, 1e-4):
                change = np.diff(likelihood.output(i, circuit, {**trial, name: float(delay)}))
                scores[float(delay)] = _explained(counts.on, change) + _explained(counts.off, -change)
            delays[name] = max(scores, key=scores.__getitem__)
            score += scores[delays[name]]
        if score > best[0]:
            best = score, {**delays, **{name: trial[name] for name in ("alpha", "gamma") if unknown_light}}
    return best[1]


def _explained(counts: np.ndarray, change: np.ndarray) -> float:
    """Squared correlation of counts with the positive part of a change."""
    rise = np.maximum(change, 0.0)
    if rise.std() == 0 or counts.std() == 0:
        return 0.0
    return float(np.corrcoef(counts, rise)[0, 1]) ** 2


def match_counts(
    likelihood: PooledRate, model: Model, values: dict[str, float], pixels: float | None = None
) -> dict[str, float]:
    """The number of pixels and the OFF threshold that make expected ON and OFF counts equal the observed ones.

    By the fluid limit, thinned by the dead time.  pixels: where known; then both thresholds.
    """
    circuit = model.circuit(values)
    width = likelihood.counts[0].edges[1] - likelihood.counts[0].edges[0]
    changes = [np.diff(likelihood.output(i, circuit, values)) for i in range(len(likelihood.counts))]
    change = np.concatenate(changes)
    on = max(sum(c.on.sum() for c in likelihood.counts), 1.0)
    off = max(sum(c.off.sum() for c in likelihood.counts), 1.0)

    def per_pixel(change: np.ndarray, threshold: float) -> float:
        events = np.maximum(change, 0.0) / threshold
        return max(float(np.sum(events / (1.0 + events * circuit.refractory / width))), 1e-12)

    def threshold(name: str, change: np.ndarray, wanted: float) -> float:
        parameter = model.parameter(name)
        trials = parameter.value * np.logspace(-1.5, 1.5, 121)
        misses = [abs(np.log(per_pixel(change, trial) / wanted)) for trial in trials]
        return parameter.within(float(trials[int(np.argmin(misses))]))

    start = {}
    if pixels is None:
        pixels = on / per_pixel(change, values["on_threshold"])
    elif "on_threshold" in model.free:
        start["on_threshold"] = threshold("on_threshold", change, on / pixels)
    if "off_threshold" in model.free:
        start["off_threshold"] = threshold("off_threshold", -change, off / pixels)
    return {"pooled.pixels": float(pixels), **start}
