"""Sampling as a step of a fit: draws, their files, and what the fit's JSON says about them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from pixelid.fit.result import FitResult
from pixelid.recordings.recording import Recording
from pixelid.sample.groups import save
from pixelid.sample.sample import sample
from pixelid.status import Status


def sampled(
    result: FitResult,
    recordings: Sequence[Recording],
    folder: Path,
    chain_file: Path,
    progress: Callable[[str, float], None] | None = None,
) -> FitResult:
    """The result with `details["posterior"]`, and posterior.nc, chain.npz and figures in `folder`.

    chain_file: where the chains live meanwhile; left behind by a kill, it is continued by the next run.
    A posterior that did not converge makes the result's status say so.
    """
    posterior = sample(result, recordings, seed=result.seed, chain_file=chain_file, progress=progress)
    said = save(posterior, result, recordings, folder)
    chain_file.replace(folder / "chain.npz")
    result = replace(result, details={**result.details, "posterior": said})
    if posterior.status is not Status.converged:
        advice = "; ".join(text for text in (result.advice, posterior.advice) if text)
        result = replace(result, status=Status.worst([result.status, posterior.status]), advice=advice)
    return result
