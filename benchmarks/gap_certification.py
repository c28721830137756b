"""Certify the search for the gap on simulated sessions: false naming, confusion, what goes by another name.

    python benchmarks/gap_certification.py --nulls 200 --repeats 3 --out docs/gap_certification.json [--workers N]

Sessions are small (9 pixels × 6 short recordings), a quarter of what the practice cases have and less.  Null sessions
hold nothing the model lacks.  Each effect of the library is planted at graded strengths up to its typical one (or the
base model lacks it), and looked for with the whole library and with itself left out of it: then only `none`, `unknown`
or `ambiguous` is right.  What is named rightly is also compared with what was planted.  Results are added line by
line, so a run can be interrupted and continued; `--workers` runs on Dask.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
from decisions import noted_decisions, plain
from scipy.stats import beta

from pixelid.cluster import Where, connected
from pixelid.gap.gap import gap
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.recordings.recording import Recording
from pixelid.simulate import simulate
from pixelid.stimuli.resample import resampled
from pixelid.stimuli.shapes import chirp, constant, slow, steps

SIDE = 3
STRENGTHS = {  # effect → parameters at its typical strength; graded by the factors below
    "dark_current": {"radiance": 4.0},
    "mains_flicker": {"modulation": 0.05},
    "extra_pole": {"cutoff_hz": 1500.0},
    "slew_limit": {"rise_per_s": 3000.0, "fall_per_s": 3000.0},
    "lower_cutoff": {"cutoff_hz": 0.5},
    "leak": {"rate_hz": 0.5},
    "parasitic_photocurrent": {"rate_hz_per_radiance": 3e-3},
    "threshold_drift": {"per_s": 0.05},
    "timestamp_jitter": {"sigma_s": 5e-5},
    "readout_latency": {"service_s": 1e-5},
    "timestamp_quantisation": {"tick_s": 1e-4},
    "hot_pixels": {"rate_hz": 100.0, "count": 1},
    "shot_noise": {"density": 3.2e-4},
    "bandwidth_floor": {"radiance": 20.0},
    "polarity_memory": {"strength": 0.05},
    "linear_log": {"knee": 20.0},
    "lost_events": {"fraction": 0.05},
    "dead_time_without_reset": {"s": 2e-3},
}
WITHHELD = ("source_follower_pole", "differencing_pole", "threshold_mismatch", "refractory_period")  # from the base
# Whose seeds come after those of the others, which keep theirs.
NEWER = ("bandwidth_floor", "polarity_memory", "linear_log", "lost_events", "dead_time_without_reset")
WEAKER = {"extra_pole", "slew_limit"}  # by a larger number: their factors divide
FACTORS = (0.1, 0.3, 1.0)
GRADED = 4  # repeats at the weaker strengths
ALPHA = 0.01


def camera(seed: int) -> Model:
    """The shipped pixel with filters, thresholds and dead time of its own."""
    rng = np.random.default_rng(seed)
    model = find_model("dvs128")
    filters = ("alpha", "beta", "sf_cutoff_hz", "diff_cutoff_hz")
    values = {name: model.values[name] * float(np.exp(rng.uniform(-0.3, 0.3))) for name in filters}
    values |= {name: float(rng.uniform(0.17, 0.24)) for name in ("on_threshold", "off_threshold")}
    values |= {
        "threshold_sigma": 0.02,
        "threshold_mismatch.sigma": 0.035,
        "refractory_s": float(rng.uniform(1e-4, 3e-4)),
    }
    return model.set(values)


def session(model: Model, seed: int) -> list[Recording]:
    """Six short recordings of one small sensor; the light is smooth, the stimulus its samples."""
    lights = {"constant_24": constant(24.0), "slow_24": slow(24.0, seed=seed + 1)}
    for k, (level, stop) in enumerate(((24.0, 200.0), (400.0, 400.0))):
        lights[f"chirp_{level:g}"] = chirp(level, stop_hz=stop)
        lights[f"steps_{level:g}"] = steps(level, seed=seed + 2 * k)
    recordings = []
    for i, (name, light) in enumerate(lights.items()):
        r = simulate(model, resampled(light, "smooth"), width=SIDE, height=SIDE, seed=1000 * seed + i, sensor_seed=seed)
        recordings.append(
            replace(r, stimulus=light, condition=name, attributes={}, events=replace(r.events, tick_ns=1))
        )
    return recordings


def planted(effect: str, factor: float, model: Model) -> tuple[Model, Model]:
    """(a camera with an effect at so much of its typical strength, or with it anyway;  the base that lacks it)."""
    base = find_model("dvs128")
    if effect in WITHHELD:
        return model, base.without_effect(effect)
    if not effect:
        return model, base
    scale = 1.0 / factor if effect in WEAKER else factor
    values = {name: value if name == "count" else value * scale for name, value in STRENGTHS[effect].items()}
    return model.with_effect(effect, values), base


def first_seeds() -> dict[str, int]:
    """effect → seed of its first session; no two effects share their noise."""
    effects = sorted({*STRENGTHS, *WITHHELD} - set(NEWER))
    return {effect: 5000 + 100 * k for k, effect in enumerate((*effects, *NEWER))}


def run(job: dict) -> dict:
    """One search: job {"effect", "factor", "seed", "left_out"} and what it reports.

    strengths: parameter → [planted, found, 95 % interval or null] of the effect where it was named
    decided_by: [criterion, factor] of the changes of a criterion after which some decision would be another
    """
    effect = job["effect"]
    model, base = planted(effect, job["factor"], camera(job["seed"]))
    left_out = (effect,) if job["left_out"] else ()
    began = time.perf_counter()
    recordings = session(model, job["seed"])
    with noted_decisions() as (criteria, noted):
        report = gap(
            recordings,
            base,
            alpha=ALPHA,
            seed=job["seed"],
            leave_out=left_out,
            criteria=criteria,
            recommend=False,
        )
    decided_by = sorted(map(list, noted))
    return {
        **job,
        "verdict": report.verdict,
        "named": [named.name for named in report.effects],
        "p": plain(report.global_p),
        "remaining_p": plain(report.details["remaining_p"]),
        "closed": report.free_run.closed if report.free_run else None,
        "strengths": {
            name: [model.values[name], *estimate]
            for named in report.effects
            if named.name == effect
            for name, estimate in named.parameters.items()
            if name in model.values
        },
        "decided_by": decided_by,
        "seconds": time.perf_counter() - began,
    }


def jobs(nulls: int, repeats: int) -> list[dict]:
    """Nulls; every effect at its typical strength and, half as often, left out of the library; then weaker."""
    plan = [{"effect": "", "factor": 0.0, "seed": 1000 + i, "left_out": False} for i in range(nulls)]
    effects = (*(e for e in STRENGTHS if e != "slew_limit"), *WITHHELD, "slew_limit")  # the slowest last
    first = first_seeds()
    for left_out, some in ((False, range(repeats)), (True, range(0, repeats, 2))):
        for i in some:
            plan += [{"effect": e, "factor": 1.0, "seed": first[e] + i, "left_out": left_out} for e in effects]
    for i in range(min(repeats, GRADED)):
        for effect in STRENGTHS:
            for factor in FACTORS[:-1]:
                plan.append({"effect": effect, "factor": factor, "seed": first[effect] + i, "left_out": False})
    return plan


def summary(rows: list[dict]) -> dict:
    """Counts: false naming with its 95 % interval (Clopper–Pearson), confusion matrices, power per strength."""
    nulls = [r for r in rows if not r["effect"]]
    confusion: dict[str, dict] = {"whole library": {}, "effect left out": {}}
    power: dict[str, dict] = defaultdict(dict)
    for row in rows:
        if not row["effect"]:
            continue
        said = row["verdict"] + (": " + "+".join(row["named"]) if row["named"] else "")
        key = f"{row['effect']} x{row['factor']:g}"
        table = confusion["effect left out" if row["left_out"] else "whole library"].setdefault(key, defaultdict(int))
        table[said] += 1
        if not row["left_out"]:
            hits, tries = power[row["effect"]].get(f"{row['factor']:g}", (0, 0))
            right = row["verdict"] == "named" and row["named"] == [row["effect"]]
            power[row["effect"]][f"{row['factor']:g}"] = (hits + right, tries + 1)
    left_out = [r for r in rows if r["left_out"]]
    return {
        "alpha": ALPHA,
        "nulls, named": rate(sum(r["verdict"] == "named" for r in nulls), len(nulls)),
        "nulls, anything but none": rate(sum(r["verdict"] != "none" for r in nulls), len(nulls)),
        "left out, a neighbour named": rate(sum(r["verdict"] == "named" for r in left_out), len(left_out)),
        "named_exactly_of_tries": power,
        "strengths_of_right_names": _strengths(rows),
        "confusion": confusion,
    }


def _strengths(rows: list[dict]) -> dict:
    """effect → {factor: largest and median relative error of its first parameter, intervals that cover it}."""
    strengths: dict[str, dict] = defaultdict(dict)
    for effect, factor in sorted({(r["effect"], r["factor"]) for r in rows if r.get("strengths")}):
        mine = [r for r in rows if (r["effect"], r["factor"]) == (effect, factor) and r.get("strengths")]
        first = [next(iter(r["strengths"].values())) for r in mine if said(r) == SAID[0]]
        errors = [abs(value / planted - 1.0) for planted, value, _ in first]
        ranges = [(planted, interval) for planted, _, interval in first if interval and None not in interval]
        if first:
            strengths[effect][f"{factor:g}"] = {
                "median_error": round(float(np.median(errors)), 4),
                "largest_error": round(max(errors), 4),
                "interval_covers": [sum(low <= planted <= high for planted, (low, high) in ranges), len(ranges)],
            }
    return strengths


def rate(count: int, of: int) -> dict:
    """A share as a count, with its 95 % interval (Clopper–Pearson)."""
    low = float(beta.ppf(0.025, count, of - count + 1)) if count else 0.0
    high = float(beta.ppf(0.975, count + 1, of - count)) if count < of else 1.0
    return {"count": count, "of": of, "interval_95": [low, high]}


SAID = ("right name", "with others", "other name", "ambiguous", "unknown", "none")


def said(row: dict) -> str:
    """One of `SAID`."""
    if row["verdict"] != "named":
        return row["verdict"]
    if row["named"] == [row["effect"]]:
        return SAID[0]
    return SAID[1] if row["effect"] in row["named"] else SAID[2]


def draw(rows: list[dict], path: Path) -> None:
    """What was said of what: planted effects by strength, in the library and left out of it."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(13, 8), layout="constrained")
    for axis, left_out in zip(axes, (False, True), strict=True):
        mine = [r for r in rows if r["left_out"] == left_out]
        keys = sorted({(r["effect"] or "(nothing)", r["factor"]) for r in mine})
        table = np.zeros((len(keys), len(SAID)))
        for r in mine:
            table[keys.index((r["effect"] or "(nothing)", r["factor"])), SAID.index(said(r))] += 1
        share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
        axis.imshow(share, cmap="Greens", vmin=0, vmax=1, aspect="auto")
        for i, j in zip(*np.nonzero(table), strict=True):
            colour = "white" if share[i, j] > 0.5 else "black"
            axis.text(j, i, f"{table[i, j]:.0f}", ha="center", va="center", fontsize=8, color=colour)
        axis.set_xticks(range(len(SAID)), SAID, rotation=30, ha="right", fontsize=8)
        axis.set_yticks(range(len(keys)), [f"{e} × {f:g}" if f else e for e, f in keys], fontsize=7)
        axis.set_title("left out of the library" if left_out else "in the library", fontsize=9)
    figure.savefig(path, dpi=80)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nulls", type=int, default=200)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("gap_certification.json"))
    parser.add_argument("--workers", type=int, default=0, help="Dask workers; 0: here")
    parser.add_argument("--figure", type=Path, help="draw the confusion matrix of what --out holds, run nothing")
    parser.add_argument("--only", nargs="*", default=[], help="effects to plant (no nulls)")
    parser.add_argument("--minutes", type=float, default=1e9, help="stop after so long; run again to go on")
    options = parser.parse_args()
    rows = json.loads(options.out.read_text())["runs"] if options.out.exists() else []
    done = {(r["effect"], r["factor"], r["seed"], r["left_out"]) for r in rows}
    if options.figure:
        draw(rows, options.figure)
        return
    plan = [j for j in jobs(options.nulls, options.repeats) if tuple(j.values()) not in done]
    plan = [j for j in plan if not options.only or j["effect"] in options.only]
    until = time.monotonic() + 60.0 * options.minutes

    def keep(row: dict) -> None:
        rows.append(row)
        options.out.write_text(json.dumps({"summary": summary(rows), "runs": rows}, indent=1, default=float) + "\n")
        print(
            row["effect"] or "null",
            row["factor"],
            "->",
            row["verdict"],
            row["named"],
            f"{row['seconds']:.0f} s",
            flush=True,
        )

    if options.workers:
        from distributed import as_completed

        with connected(Where(workers=options.workers)) as client:
            for _, row in as_completed(client.map(run, plan, pure=False), with_results=True):
                keep(row)
        return
    for job in plan:
        if time.monotonic() > until:
            break
        keep(run(job))


if __name__ == "__main__":
    main()
