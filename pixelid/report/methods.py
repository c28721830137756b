"""What a paper says of a calibration: a paragraph with its numbers, and the references as BibTeX."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from pixelid.report.format import counted, percent
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
    """The paragraph, for LaTeX and everything else; numbers as they stand on the page.

    Args:
        result: calibration.json.
        estimated: the pixel's free parameters.
        added: names of the effects that the start model lacked.
    """
    used = sum(bool(row["used"]) for row in result["recordings"])
    version = result.get("versions", {}).get("pixelid", "")
    parts = [
        f"We identified the circuit of the event camera's pixel with pixelid {version} \\cite{{pixelid}} from "
        f"{counted(used, 'recording')} ({counted(result['events'], 'event')} of {counted(result['pixels'], 'pixel')}) "
        "under measured light.",
        f"The parameters of the model {result['base']} \\cite{{low2024deblur}} were estimated by maximum likelihood of "
        "the event times, together with the levels and zeros of the light and the clocks of the recordings.",
    ]
    if added:
        names = " and ".join(", ".join(added).rsplit(", ", 1))
        parts.append(f"A search on pixels set aside added what this model lacks: {names}.")
    elif result["recommended_next"]:  # which only a search gives
        parts.append("A search for missing effects on pixels set aside added none.")
    known = [q for q in estimated if q.identified]
    if known:
        parts.append(f"Estimates with 95 % intervals are {'; '.join(_with_interval(q) for q in known)}.")
    unknown = [q.label for q in estimated if not q.identified]
    if unknown:
        parts.append(f"Not identified: {', '.join(unknown)}.")
    held_out = result.get("held_out")
    if held_out:
        alarms = len(held_out["significant_tests"])
        verdict = f"{counted(alarms, 'residual test')} failed" if alarms else "no residual test failed"
        share = percent(held_out["background_fraction"])
        pixels = counted(held_out["pixels"], "further pixel")
        parts.append(f"On {pixels}, {share} of the events were unexplained, and {verdict}.")
    return " ".join(parts)


def _with_interval(q: Quantity) -> str:
    unit = f" {q.unit}" if q.unit else ""
    known = f" ({q.interval.replace(' … ', ' to ')})" if q.interval != "–" else ""
    return f"{q.label} {q.value}{known}{unit}"
