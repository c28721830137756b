"""Round trip: from a camera's file and a light trace, each on a clock of its own, to the fitted circuit.

Each session has its own hidden circuit (every free parameter of dvs128 drawn log-normally about its nominal value) and
9 pixels that see 4 lights at 4 levels.  What a camera and a photodiode would have left is written without pixelid: the
events as AEDAT4 by the library faery, in whole microseconds of a clock that shows 1.6e9 s and some at the light's
first sample and runs 50 ppm fast or slow, with a trigger edge there (every second session: another one at the light's
last sample); the light as CSV in seconds of the photodiode's clock.  The public commands read it:

    pixelid convert camera.aedat4 recording.h5 --stimulus light.csv --align auto | trigger
    pixelid fit recordings --model dvs128 --between linear

Target: 95 % intervals of every parameter, delay and drift included, hold the truth as often as they say, and delays are
within 20 µs.  Finished sessions are kept, a second call continues.

    python benchmarks/round_trip.py --sessions 30
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
from faery.extension import aedat
from interval_coverage import hidden_circuit

from pixelid.cli.main import main as pixelid
from pixelid.model.model import Model
from pixelid.recordings import open_recording
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.shapes import chirp, steps
from pixelid.stimuli.stimulus import Stimulus

WAYS = ("auto", "trigger")
SIDE = 3
DURATION_S, SAMPLE_S = 0.6, 5e-5
# Random steps: radiance (fA), how long each is held (s).  Bright and fast enough for the poles of a few kHz: under
# dimmer light alone a delay of the clock is not told from the source follower's.
STEPS = ((40.0, 0.010), (600.0, 0.006), (3000.0, 0.006))
PPM = 50.0  # by which the camera's clock is off, either way
EPOCH_NS = 1_600_000_000 * 10**9
CUT_NS = 500  # stamps cut to whole microseconds are half of one early, those of triggers as well
CLOSE_S = 2e-5  # that a delay must be within


def lights(seed: int) -> dict[str, Stimulus]:
    """A chirp and three courses of random steps, a level each."""
    shown = {"chirp_300": chirp(300.0, modulation=0.6, stop_hz=400.0, duration_s=DURATION_S, dt=SAMPLE_S)}
    for k, (level, hold_s) in enumerate(STEPS):
        shown[f"steps_{level:g}"] = steps(
            level, 1.2, hold_s, edge_s=1e-4, duration_s=DURATION_S, dt=SAMPLE_S, seed=3 * seed + k
        )
    return shown


def clock_ns(seconds: np.ndarray, offset_ns: int, ppm: float) -> np.ndarray:
    """(n,) what a camera's clock shows, in nanoseconds cut to whole microseconds."""
    return (offset_ns + np.floor(1e9 * (1.0 + 1e-6 * ppm) * np.asarray(seconds)).astype(np.int64)) // 1000 * 1000


def write_camera(path: Path, recording: Recording, edges_s: list[float], offset_ns: int, ppm: float) -> None:
    """Write events and trigger edges as AEDAT4, on the camera's own clock."""

    def text(value: str):
        return aedat.DescriptionAttribute(attribute_type="string", value=value)

    def stream(number: int, kind: str, size: dict[str, int]):
        where = f"/mainloop/Recorder/outInfo/{number}/"
        sides = {key: aedat.DescriptionAttribute(attribute_type="int", value=value) for key, value in size.items()}
        about = aedat.DescriptionNode(
            name="info", path=f"{where}info/", attributes={"source": text("round trip"), **sides}, nodes=[]
        )
        named = {"compression": text("NONE"), "originalOutputName": text(kind), "typeIdentifier": text(kind)}
        return aedat.DescriptionNode(name=str(number), path=where, attributes=named, nodes=[about])

    events = recording.events
    packet = np.zeros(len(events), [("t", "<u8"), ("x", "<u2"), ("y", "<u2"), ("on", "?")])
    packet["t"] = clock_ns(events.t * 1e-9, offset_ns, ppm) // 1000
    packet["x"], packet["y"], packet["on"] = events.x, events.y, events.p == 1
    edges = np.zeros(len(edges_s), [("t", "<u8"), ("source", "u1")])
    edges["t"], edges["source"] = clock_ns(np.array(edges_s), offset_ns, ppm) // 1000, 1
    streams = [stream(0, "EVTS", {"sizeX": events.width, "sizeY": events.height}), stream(1, "TRIG", {})]
    described = aedat.DescriptionNode(name="outInfo", path="/mainloop/Recorder/outInfo/", attributes={}, nodes=streams)
    with aedat.Encoder(path=path, description=[described], compression=None) as encoder:
        encoder.write(0, packet)
        encoder.write(1, edges)


def write_light(path: Path, light: Stimulus, start_s: float) -> None:
    """Write the light as CSV, on a clock that shows `start_s` at its first sample."""
    rows = (f"{t + start_s:.9f},{radiance:.12g}" for t, radiance in zip(light.t, light.radiance, strict=True))
    path.write_text("t_s,radiance\n" + "\n".join(rows) + "\n")


def seen_by(truth: Model, light: Stimulus, pixels: np.ndarray, seed: int) -> Recording:
    """A recording of pixels whose thresholds are those of `truth` times factors (SIDE², 2), ON and OFF."""
    plain = truth.without_effect("threshold_mismatch")
    own = [
        plain.set({name: truth.values[name] * factor for name, factor in pair.items()})
        for pair in ({"on_threshold": on, "off_threshold": off} for on, off in pixels.tolist())
    ]
    singles = [simulate(pixel, light, seed=seed + k).events for k, pixel in enumerate(own)]
    t, p = (np.concatenate([getattr(events, name) for events in singles]) for name in "tp")
    index = np.repeat(np.arange(len(singles)), [len(events) for events in singles])
    order = np.argsort(t, kind="stable")
    together = singles[0].from_columns(t[order], index[order] % SIDE, index[order] // SIDE, p[order], SIDE, SIDE)
    return Recording(together, light)


def one(seed: int, folder: Path) -> dict:
    """Truth, estimate and interval of every parameter of one session, by each way of alignment."""
    truth, rng = hidden_circuit(seed), np.random.default_rng([seed, 2])
    factors = 1.0 + truth.values["threshold_mismatch.sigma"] * rng.normal(size=(SIDE * SIDE, 2))
    clocks = {}
    for name, light in lights(seed).items():
        recording = seen_by(truth, light, factors, int(rng.integers(2**30)))
        offset_ns = EPOCH_NS + int(rng.integers(10**12))
        ppm = PPM * float(rng.choice([-1.0, 1.0]))
        edges = [0.0] if seed % 2 else [0.0, float(light.t[-1])]
        write_camera(folder / f"{name}.aedat4", recording, edges, offset_ns, ppm)
        write_light(folder / f"{name}.csv", light, float(rng.uniform(0.0, 100.0)))
        clocks[name] = light, offset_ns, ppm
    return {"seed": seed, "ways": {way: _fitted(folder, truth, clocks, way, seed) for way in WAYS}}


def _fitted(folder: Path, truth: Model, clocks: dict, way: str, seed: int) -> dict:
    begun, session = time.perf_counter(), folder / way
    session.mkdir()
    for name in clocks:
        camera, light, out = (str(folder / f"{name}{end}") for end in (".aedat4", ".csv", ""))
        code = pixelid(["convert", camera, str(session / f"{name}.h5"), "--stimulus", light, "--align", way, "--quiet"])
        if code != 0:
            return {"status": f"convert {name} ended with {code}"}
    out = folder / f"fit_{way}"
    words = ["fit", str(session), "--model", "dvs128", "--between", "linear", "--seed", str(seed), "--quiet"]
    pixelid([*words, "--out", str(out)])
    fit = json.loads((out / "fit.json").read_text())
    wanted = {name: truth.values[name] for name in truth.free}
    converted = {}
    for name, (light, offset_ns, ppm) in clocks.items():
        told = fit["alignment"][name]
        delay_s, drift_s = _left(open_recording(session / f"{name}.h5"), light, offset_ns, ppm, told["at_s"])
        wanted |= {f"alignment.delay_s[{name}]": delay_s, f"alignment.drift_s[{name}]": drift_s}
        converted[name] = {"delay_s": delay_s, "rate_ppm": told["clock_rate_ppm"], "true_ppm": ppm}
    return {
        "status": fit["status"],
        "advice": fit["advice"],
        "events": fit["events"],
        "seconds": time.perf_counter() - begun,
        "left_by_convert": converted,
        "parameters": {
            name: {**{key: fit["parameters"][name][key] for key in ("value", "std", "interval_95")}, "truth": value}
            for name, value in wanted.items()
        },
    }


def _left(recording: Recording, light: Stimulus, offset_ns: int, ppm: float, at_s: float) -> tuple[float, float]:
    """(delay at `at_s`, drift over the light) that the alignment of a recording has left, seconds.

    The camera shows offset + (1 + ppm) τ at the light's time τ, cut to a microsecond; where the alignment put that τ is
    read off the samples' times in the recording, whose zero is a whole number of microseconds from the camera's.
    """
    assert recording.stimulus is not None
    begun_s = (offset_ns - CUT_NS - recording.attributes["alignment"]["zero_ns"]) * 1e-9

    def late(t: float) -> float:
        moment = (t - begun_s) / (1.0 + 1e-6 * ppm)
        share = (moment - light.t[0]) / light.duration_s
        return t - float(recording.stimulus.t[0] + share * recording.stimulus.duration_s)

    first, last = (float(recording.stimulus.t[k]) for k in (0, -1))
    return late(at_s), late(last) - late(first)


def summary(sessions: list[dict]) -> dict:
    """By way: per parameter the intervals that hold the truth, of how many; delays, before and after the fit."""
    from scipy.stats import binom

    table: dict = {}
    for way in WAYS:
        done = [s["ways"][way] for s in sessions if "parameters" in s["ways"].get(way, {})]
        by_name: dict[str, list[tuple]] = {}
        for session in done:
            for name, row in session["parameters"].items():
                low, high = row["interval_95"] or (None, None)
                held = (low is None or low <= row["truth"]) and (high is None or row["truth"] <= high)
                error = (row["value"] - row["truth"]) / row["std"] if row["std"] else np.nan
                by_name.setdefault(name.partition("[")[0], []).append((held, low is None or high is None, error))
        before, after = (
            [abs(value) for session in done for value in part(session)] for part in (_left_by_convert, _left_by_fit)
        )
        table[way] = {
            "sessions": len(done),
            "failed": len(sessions) - len(done),
            "statuses": {status: sum(s["status"] == status for s in done) for status in {s["status"] for s in done}},
            "parameters": {
                name: {
                    "held": sum(held for held, _, _ in rows),
                    "of": len(rows),
                    "one_sided": sum(open_side for _, open_side, _ in rows),
                    "expected_range": [int(binom.ppf(q, len(rows), 0.95)) for q in (0.005, 0.995)],
                    "sd_error_sd": float(np.sqrt(np.nanmean([error**2 for _, _, error in rows]))),
                }
                for name, rows in by_name.items()
            },
            "delay_error_us": {
                when: {"median": 1e6 * float(np.median(part)), "largest": 1e6 * max(part), "within": 1e6 * CLOSE_S,
                       "share": float(np.mean(np.array(part) < CLOSE_S))}
                for when, part in (("convert", before), ("fit", after)) if part
            },
        }  # fmt: skip
    return table


def _left_by_convert(session: dict) -> list[float]:
    return [clock["delay_s"] for clock in session["left_by_convert"].values()]


def _left_by_fit(session: dict) -> list[float]:
    rows = [row for name, row in session["parameters"].items() if name.startswith("alignment.delay_s")]
    return [row["value"] - row["truth"] for row in rows]


def run(count: int, path: Path, first: int = 0) -> dict:
    """Do sessions first … first + count − 1 that `path` does not hold yet; returns the summary."""
    done = json.loads(path.read_text())["sessions"] if path.exists() else []
    for seed in sorted(set(range(first, first + count)) - {s["seed"] for s in done}):
        with tempfile.TemporaryDirectory() as folder:
            done.append(one(seed, Path(folder)))
        done.sort(key=lambda s: s["seed"])
        temporary = path.with_suffix(".tmp")
        temporary.write_text(json.dumps({"summary": summary(done), "sessions": done}))
        temporary.replace(path)
        print(seed, {way: result["status"] for way, result in done[-1]["ways"].items()}, flush=True)
    return summary(done)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=30)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("round_trip.json"))
    arguments = parser.parse_args()
    for way, part in run(arguments.sessions, arguments.out, arguments.first).items():
        print(f"--align {way}: {part['sessions']} sessions, {part['failed']} failed, {part['statuses']}")
        for name, row in part["parameters"].items():
            low, high = row["expected_range"]
            print(
                f"  {name:26s} {row['held']}/{row['of']} (95 % intervals: {low} to {high}), "
                f"{row['one_sided']} with an open side, errors {row['sd_error_sd']:.2f} sd"
            )
        for when, row in part["delay_error_us"].items():
            print(
                f"  delay after {when}: median {row['median']:.1f} µs, largest {row['largest']:.1f} µs, "
                f"{100 * row['share']:.0f} % within {row['within']:.0f} µs"
            )


if __name__ == "__main__":
    main()
