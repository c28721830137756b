"""Simulation-based calibration of the emcee posterior (Talts et al. 2018, arXiv 1804.06788).

A hidden circuit is drawn from the prior (every free parameter of dvs128 log-normal about its nominal value), a short
session is simulated from it, fitted and sampled under that same prior.  The truth's rank among posterior draws is
then uniform, for every parameter, if simulator, likelihood and sampler agree.  Reported per parameter: χ² of the ranks
in ten bins, and Kolmogorov–Smirnov; over all, the smallest p by Holm.  Finished sessions are kept, a second call
continues.

    python benchmarks/posterior_ranks.py --sessions 200
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from interval_coverage import session, stimuli

from pixelid.fit import fit
from pixelid.model.model import Model
from pixelid.model.shipped import find_model
from pixelid.parameters.parameter import Prior
from pixelid.sample import sample

SPREAD = 0.2  # standard deviation of the prior on log parameters
SIDE = 2
LEVELS, DURATION_S = (10.0, 200.0), 0.12
DRAWS = 99  # posterior draws a truth is ranked among: ranks 0 … 99
EFFECTIVE = 500  # samples per parameter before draws are picked
BINS = 10


def prior_model() -> Model:
    """dvs128 with a log-normal prior on every free parameter."""
    model = find_model("dvs128")
    parameters = {
        name: replace(p, prior=Prior(p.to_coordinate(p.value), SPREAD)) if p.free else p
        for name, p in model.parameters.items()
    }
    return replace(model, parameters=parameters)


def one(seed: int) -> dict:
    """Rank of every free parameter's truth among the posterior's draws, from one session."""
    begun = time.perf_counter()
    model, rng = prior_model(), np.random.default_rng([seed, 11])
    moves = SPREAD * rng.standard_normal(len(model.free))
    truth = model.set({n: model.values[n] * float(np.exp(m)) for n, m in zip(model.free, moves, strict=True)})
    recordings = session(truth, seed, stimuli(seed, LEVELS, DURATION_S), SIDE)
    result = fit(recordings, model, starts=0, between="linear", seed=seed)
    posterior = sample(result, recordings, seed=seed, wanted=EFFECTIVE, max_steps=1500)
    draws = posterior.chain.reshape(-1, posterior.chain.shape[-1])
    picked = draws[rng.choice(len(draws), DRAWS, replace=False)]
    return {
        "seed": seed,
        "fit": result.status,
        "posterior": posterior.status,
        "events": result.events,
        "effective": float(posterior.convergence.effective.min()),
        "seconds": time.perf_counter() - begun,
        "ranks": {
            p.name: int((picked[:, i] < p.to_coordinate(truth.values[p.name])).sum())
            for i, p in enumerate(result.coordinates.parameters)
        },
    }


def summary(sessions: list[dict]) -> dict:
    """Per parameter: p of χ² and Kolmogorov–Smirnov, counts per bin;  "smallest_p_holm" over all parameters."""
    from scipy.stats import chisquare, kstest

    if not sessions:
        return {}
    table, p_values = {}, []
    for name in sessions[0]["ranks"]:
        ranks = np.array([s["ranks"][name] for s in sessions])
        counts = np.bincount(ranks * BINS // (DRAWS + 1), minlength=BINS)
        spread = np.random.default_rng(0).uniform(size=len(ranks))  # ranks are whole numbers, the test is not
        table[name] = {
            "counts": counts.tolist(),
            "p_chi2": float(chisquare(counts).pvalue),
            "p_ks": float(kstest((ranks + spread) / (DRAWS + 1), "uniform").pvalue),
        }
        p_values.append(table[name]["p_chi2"])
    return {
        "sessions": len(sessions),
        "posteriors_converged": sum(s["posterior"] == "converged" for s in sessions),
        "smallest_p_holm": float(min(1.0, min(p_values) * len(p_values))),
        "parameters": table,
    }


def run(count: int, path: Path) -> dict:
    """Sample sessions 0 … count − 1 that `path` does not hold yet; returns the summary."""
    done = json.loads(path.read_text())["sessions"] if path.exists() else []
    for seed in sorted(set(range(count)) - {s["seed"] for s in done}):
        done.append(one(seed))
        temporary = path.with_suffix(".tmp")
        temporary.write_text(json.dumps({"summary": summary(done), "sessions": done}))
        temporary.replace(path)
    return summary(done)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sessions", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path(__file__).with_name("posterior_ranks.json"))
    arguments = parser.parse_args()
    outcome = run(arguments.sessions, arguments.out)
    for name, row in outcome["parameters"].items():
        print(f"{name:26s} {row['counts']}  p(χ²) {row['p_chi2']:.3f}  p(KS) {row['p_ks']:.3f}")
    print(
        f"{outcome['sessions']} sessions, {outcome['posteriors_converged']} posteriors converged, "
        f"smallest p by Holm {outcome['smallest_p_holm']:.3f}"
    )


if __name__ == "__main__":
    main()
