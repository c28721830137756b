"""The hypothesis at imputed event times: of several draws of them, the one that leaves least."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from pixelid.fit.maximise import maximise, maximise_with_restarts
from pixelid.gap.attribute.candidates import canonical
from pixelid.gap.detect.covariates import Factor
from pixelid.gap.detect.diagnostics import diagnose
from pixelid.gap.detect.pixels import gather_evidence
from pixelid.gap.imputation.blurred import draw_once_more
from pixelid.gap.imputation.impute import JITTER, Imputation, impute_again
from pixelid.gap.options import Context
from pixelid.gap.split import Split
from pixelid.gap.state import Hypothesis
from pixelid.model.model import Model


@dataclass(frozen=True)
class Setting:
    """What stays the same between draws.

    Attributes:
        split: Of the pixels.
        model: The base as shipped, with the effects read off timestamps.
        start: That with every effect named.
        between: How the light runs between samples.
        like: Cells that the maps shall have.
    """

    split: Split
    model: Model
    start: Model
    between: str
    like: Sequence[Factor] = ()


def at_imputed_times(
    imputation: Imputation, model: Model, setting: Setting, context: Context
) -> tuple[Imputation, Hypothesis]:
    """The hypothesis at times drawn under a model: of several draws, the one that shows least.

    What is missing shows in all of them; what shows in some is imputation noise.
    """
    scatter = imputation.scatter
    judged = []
    # What is missing shows in each of three; eight rounds apart they are independent
    draws_judged, rounds_between = 3, 8
    for turn in range(draws_judged):
        if turn and imputation.draws_paths(model):
            if judged[-1].seen.p >= context.options.alpha_each:
                break  # another draw can only show less
            imputation = draw_once_more(imputation, model)
        elif turn:
            imputation, model = impute_again(imputation, model, rounds_between, cache=context.cache)
        judged.append(_at_these(imputation, model, setting, scatter, context))
    return imputation, max(judged, key=lambda hypothesis: hypothesis.seen.p)


def _at_these(imputation: Imputation, model: Model, setting: Setting, scatter, context: Context) -> Hypothesis:
    """The hypothesis with the times drawn last, and the model they were drawn under fitted to them."""
    seed, criteria, start = context.options.seed, context.options.criteria, setting.start
    recordings = imputation.recordings
    evidence = gather_evidence(recordings, setting.split, setting.model, setting.between, seed)
    values = {name: model.values[name] for name in start.free if name in model.values}
    fit = maximise_with_restarts(
        evidence.training,
        replace(start.set(values), nuisances=model.nuisances),
        start,
        tolerance=0.01,
        max_steps=40,
        cache=context.cache,
    )
    ordered = canonical(fit.model, setting.model)
    if ordered is not fit.model:
        fit = maximise(evidence.training, ordered, tolerance=0.01, max_steps=40, cache=context.cache)
    jitter = (imputation.sigma_s, imputation.error) if imputation.effect == JITTER else None
    # events that imputation cannot place stay behind a jitter; behind a queue or a tick they do not count
    allowed = criteria.max_unexplained_fraction_jittered if jitter is not None else None
    seen = diagnose(evidence.training, fit, criteria, seed, background_fraction=allowed, like=setting.like)
    return Hypothesis(recordings, evidence, fit, seen, start, None, jitter, scatter)
