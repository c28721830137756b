"""What a paper says of a result: a paragraph with its numbers, and the references as BibTeX."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pixelid.report.format import chance, counted, percent
from pixelid.report.quantities import Quantity

BIBTEX = """@software{{pixelid,
  title   = {{pixelid: identification of event-camera pixel circuits}},
  author  = {{{{pixelid developers}}}},
  version = {{{version}}}
}}
@inproceedings{{low2024deblur,
  title     = {{Deblur e-NeRF: NeRF from Motion-Blurred Events under High-speed or Low-light Conditions}},
  author    = {{Low, Weng Fei and Lee, Gim Hee}},
  booktitle = {{European Conference on Computer Vision (ECCV)}},
  year      = {{2024}}
}}"""


def bibtex(result: dict[str, Any]) -> str:
    """The software and the paper whose pixel model it implements."""
    return BIBTEX.format(version=result.get("versions", {}).get("pixelid", ""))


def methods(result: dict[str, Any], estimated: Sequence[Quantity], added: Sequence[str]) -> str:
    """The paragraph of a calibration, for LaTeX and everything else; numbers as they stand on the page.

    Args:
        result: calibration.json.
        estimated: the pixel's free parameters.
        added: names of the effects that the start model lacked.
    """
    used = sum(bool(row["used"]) for row in result["recordings"])
    with_bench = ", together with the levels and zeros of the light and the clocks of the recordings"
    parts = [_data_and_model(result, used, result["base"], with_bench)]
    if added:
        parts.append(f"A search on pixels set aside added what this model lacks: {_and(added)}.")
    elif result["recommended_next"]:  # which only a search gives
        parts.append("A search for missing effects on pixels set aside added none.")
    parts += _estimates(estimated)
    held_out = result.get("held_out")
    if held_out:
        alarms = len(held_out["significant_tests"])
        verdict = f"{counted(alarms, 'residual test')} failed" if alarms else "no residual test failed"
        share = percent(held_out["background_fraction"])
        pixels = counted(held_out["pixels"], "further pixel")
        parts.append(f"On {pixels}, {share} of the events were unexplained, and {verdict}.")
    return " ".join(parts)


def methods_of_fit(result: dict[str, Any], estimated: Sequence[Quantity]) -> str:
    """The paragraph of a fit."""
    return " ".join(
        [_data_and_model(result, len(result["recordings"]), str(result["model"]), ""), *_estimates(estimated)]
    )


def methods_of_search(result: dict[str, Any], base: str, added: Sequence[str]) -> str:
    """The paragraph of a search for what a model lacks.

    Args:
        result: gap.json.
        base: name of the model.
        added: what was named, with its strength.
    """
    version = result.get("versions", {}).get("pixelid", "")
    found = f"The search named {_and(added)}" if added else "The search named none"
    return (
        f"We searched the recordings for effects that the pixel model {base} \\cite{{low2024deblur}} lacks with "
        f"pixelid {version} \\cite{{pixelid}}. {found} (family-wise error rate {result['alpha']:g}, gains judged on "
        f"pixels that no fit had seen; global p-value {chance(result['global_p'])})."
    )


def _data_and_model(result: dict[str, Any], recordings: int, model: str, together_with: str) -> str:
    version = result.get("versions", {}).get("pixelid", "")
    return (
        f"We identified the circuit of the event camera's pixel with pixelid {version} \\cite{{pixelid}} from "
        f"{counted(recordings, 'recording')} ({counted(result['events'], 'event')} of "
        f"{counted(result['pixels'], 'pixel')}) under measured light. "
        f"The parameters of the model {model} \\cite{{low2024deblur}} were estimated by maximum likelihood of "
        f"the event times{together_with}."
    )


def _estimates(estimated: Sequence[Quantity]) -> list[str]:
    """Sentences with the values that are identified, and the names of those that are not."""
    known = [_with_interval(q) for q in estimated if q.identified]
    unknown = [q.label for q in estimated if not q.identified]
    parts = [f"Estimates with 95 % intervals are {'; '.join(known)}."] if known else []
    return parts + ([f"Not identified: {', '.join(unknown)}."] if unknown else [])


def _and(names: Sequence[str]) -> str:
    return " and ".join(", ".join(names).rsplit(", ", 1))


def _with_interval(q: Quantity) -> str:
    unit = f" {q.unit}" if q.unit else ""
    known = f" ({q.interval.replace(' … ', ' to ')})" if q.interval != "–" else ""
    return f"{q.label} {q.value}{known}{unit}"
