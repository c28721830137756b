"""What benchmarks and surveys of faults measured, as tables: from the files that they wrote."""

from __future__ import annotations

import json
import statistics
from collections import defaultdict

import speed_page
from page_parts import ROOT, of_json, percent, table


def certification() -> str:
    """What `benchmarks/gap_certification.py` found."""
    certified = of_json("docs/gap_certification.json")
    summary, runs = certified["summary"], certified["runs"]
    labels = {
        "nulls, named": "nothing planted: an effect is named",
        "nulls, anything but none": "nothing planted: any verdict but `none`",
        "left out, a neighbour named": "planted effect left out of the library: another one is named",
    }
    rows = [
        (
            labels.get(name, name),
            f"{entry['count']} of {entry['of']}",
            "–".join(percent(x) for x in entry["interval_95"]),
        )
        for name, entry in summary.items()
        if isinstance(entry, dict) and "count" in entry
    ]
    named, strengths = summary["named_exactly_of_tries"], summary["strengths_of_right_names"]
    factors = sorted({factor for tries in named.values() for factor in tries}, key=float, reverse=True)
    per_effect = []
    for name, tries in named.items():
        right = strengths.get(name, {}).get("1", {})
        covers = "{}\u00a0of\u00a0{}".format(*right["interval_covers"]) if right else ""
        errors = (percent(right["median_error"]), percent(right["largest_error"])) if right else ("", "")
        counts = ["{}\u00a0of\u00a0{}".format(*tries[factor]) if factor in tries else "" for factor in factors]
        per_effect.append((f"`{name}`", *counts, *errors, covers))
    total = [sum(tries["1"][k] for tries in named.values()) for k in (0, 1)]
    covered = [sum(e["interval_covers"][k] for by in strengths.values() for e in by.values()) for k in (0, 1)]
    confusion = [
        (cell, ", ".join(f"{verdict} ({count})" for verdict, count in verdicts.items()))
        for cell, verdicts in summary["confusion"].get("effect left out", {}).items()
    ]
    note = _of_earlier_versions(runs)
    heads = ("effect", *(f"× {factor}" for factor in factors), "median error", "largest error", "interval covers")
    return "\n".join(
        [
            f"Level α = {summary['alpha']}; {len(runs)} sessions.\n",
            table(("question", "count", "95 % interval"), rows),
            f"At typical strength {total[0]} of {total[1]} sessions end with exactly the planted effect named. "
            f"Of the strengths found, {covered[0]} of {covered[1]} intervals of nominally 95 % contain the truth."
            f"{note}\n",
            "**Named exactly, by planted strength in units of the typical one; errors of the strength found at × 1**\n",
            table(heads, per_effect),
            "**Verdict when the planted effect is left out of the library**\n",
            table(("planted", "verdicts (sessions)"), confusion),
        ]
    )  # fmt: skip


def described() -> str:
    """What `benchmarks/described_effects.py` found."""
    content = of_json("docs/described_effects.json")
    kinds = [(kind, *row.values()) for kind, row in content["summary"].items()]
    heads = ("sessions of", *next(iter(content["summary"].values())))
    effects: dict[tuple, list[dict]] = defaultdict(list)
    for run in content["runs"]:
        effects[run["kind"], run["effect"]].append(run)
    rows = []
    for (kind, effect), runs in effects.items():
        stages = [sum(bool(run[key]) for run in runs) for key in ("right_stage", "right_quantity")]
        closed = [run["closed"] for run in runs if run["described"] and run["closed"] is not None]
        shown = f"{sum(c >= 0.8 for c in closed)} of {len(closed)}" if closed else ""
        named = sum(bool(run["named"]) for run in runs)
        rows.append((kind, effect, len(runs), sum(bool(run["described"]) for run in runs), *stages, shown, named))
    heads_of_effects = (
        "", "planted", "sessions", "described", "right stage", "right quantity", "closed 0.8 or more, of those that "
        "show in counts", "an effect named or listed",
    )  # fmt: skip
    return "\n".join([table(heads, kinds), table(heads_of_effects, rows)])


def sensitivity() -> str:
    """What `benchmarks/gap_sensitivity.py` found: a row per criterion, halved and doubled."""
    content = of_json("docs/gap_sensitivity.json")
    summary = content["summary"]
    halves: dict[str, list[dict]] = defaultdict(list)
    for row in summary:
        halves[row["criterion"]].append(row)
    rows = []
    for name, pair in halves.items():
        cells = [f"{r['some_decision_changes']} / {r['searched']} / {r['verdict_changes']}" for r in pair]
        shares = [percent(r["share"]) if "share" in r else "≤ " + percent(r["share_at_most"]) for r in pair]
        rows.append((f"`{name}`", f"{pair[0]['value']:g}", *cells, " and ".join(shares)))
    heads = (
        "criterion", "value", "halved: decisions / searched / verdicts", "doubled: decisions / searched / verdicts",
        "verdicts changed",
    )  # fmt: skip
    return "\n".join(
        [
            f"{summary[0]['sessions']} sessions. *Decisions*: sessions in which some decision on the way would be "
            "different; *searched*: of these, searched again with the criterion changed; *verdicts*: of these, with "
            f"another verdict or name.{_of_earlier_versions(content['runs'])}\n",
            table(heads, rows),
        ]
    )


def combinations() -> str:
    """What `benchmarks/gap_combinations.py` found: outcomes by number of effects."""
    content = of_json("docs/gap_combinations.json")
    summary, runs = content["summary"], content["runs"]
    wanted = "all and only those planted"
    kinds = [wanted, *sorted({run["outcome"] for run in runs} - {wanted})]
    by_number = summary["by_number_of_effects"]
    counts = [(number, *(by_number[number].get(kind, "") for kind in kinds)) for number in by_number]
    return "\n".join(
        [
            _share(summary, wanted, "end with all and only the planted effects named") + "; "
            + _share(summary, "an effect that was not planted", "name or list one that was not planted") + ". "
            + "{} of {} strengths lie in their intervals.\n".format(*summary["intervals_hold"]),
            table(("effects planted", *kinds), counts),
        ]
    )  # fmt: skip


def _share(summary: dict, key: str, words: str) -> str:
    row = summary[key]
    return f"{row['count']} of {row['of']} sessions {words} ({'–'.join(percent(x, 0) for x in row['interval_95'])})"


def independent() -> str:
    """What `benchmarks/gap_independent.py` found: by what is missing."""
    content = of_json("docs/gap_independent.json")
    kinds = [
        (
            kind,
            f"{row['right']} of {row['sessions']}",
            " / ".join(percent(x, 2) for x in row["errors_median_and_largest"] or []),
            "{} of {}".format(*row["intervals_hold"]) if row["intervals_hold"][1] else "",
            "{} of {}".format(*row["closed_0.8"]) if row["closed_0.8"][1] else "",
            " / ".join(f"{x:.0f}" for x in row["cpu_seconds_median_and_largest"]),
        )
        for kind, row in content["summary"].items()
    ]
    heads = ("missing", "right", "error, median / largest", "intervals hold", "closed 0.8", "CPU s, median / largest")
    return table(heads, kinds) + "\n" + _of_earlier_versions(content["runs"]).strip() + "\n"


def bench_sessions() -> str:
    """What `benchmarks/bench_sessions.py` found."""
    found = of_json("benchmarks/bench_sessions.json")["summary"]
    circuit = [
        (f"`{name}`", "{} of {}".format(row["covered"], row["with_interval"]), percent(row["median_error"], 2),
         percent(row["largest_error"]),
         "" if row["within_target"] is None else f"{row['within_target']} of {row['reported']}")
        for name, row in found["parameters"].items()
    ]  # fmt: skip
    effects = [
        (f"`{name}`", *("{} of {}".format(*row[key]) for key in ("above_limit", "below_limit", "covered")),
         row["wrongly_named"])
        for name, row in found["effects"].items()
    ]  # fmt: skip
    faults = [(name, f"{row['found']} of {row['found'] + row['missed']}") for name, row in found["faults"].items()]
    status = ", ".join(f"{count} `{name}`" for name, count in found["status"].items())
    seconds = "{:.0f} s in the median, {:.0f} s at most".format(*found["cpu_seconds_median_and_largest"])
    doubts = ", ".join(found["doubted_without_cause"]) or "none"
    return "\n".join([
        f"{found['sessions']} sessions: {status}. CPU time {seconds}.\n",
        table(("parameter", "in its 95 % interval", "median error", "largest error", "within target"), circuit),
        table(("effect", "planted above its limit, named", "below, named", "strength in its interval",
               "named where absent"), effects),
        table(("wrong statement", "found"), faults),
        f"Statements doubted that are right: {doubts}. Nothing missing and `none`: {found['nulls'][0]} of "
        f"{found['nulls'][1]}. Described: {found['described']}.\n",
    ])  # fmt: skip


def _of_earlier_versions(runs: list[dict]) -> str:
    """A sentence about runs whose numbers are of an earlier version, or nothing."""
    earlier = sum(bool(run.get("earlier_code")) for run in runs)
    return f" {earlier} of the {len(runs)} runs used an earlier version (`earlier_code`)." if earlier else ""


def coverage() -> str:
    """What `benchmarks/interval_coverage.py` found."""
    summary = of_json("benchmarks/interval_coverage.json")["summary"]
    rows = [
        (f"`{name}`", f"{row['covered']} of {row['sessions']}", percent(row["share"]),
         "–".join(percent(x) for x in row["share_interval_95"]), f"{row['mean_error_sd']:+.2f}",
         f"{row['sd_error_sd']:.2f}")
        for name, row in summary.items()
    ]  # fmt: skip
    heads = ("parameter", "covered", "share", "95 % interval of the share", "mean of error/std", "sd of error/std")
    return table(heads, rows)


def pixel_light() -> str:
    """What `benchmarks/pixel_light.py` found."""
    summary = of_json("benchmarks/pixel_light.json")["summary"]
    parts = []
    for pixels, part in summary.items():
        rows = [
            (f"`{name}`", f"{row['covered']} of {row['sessions']}",
             "–".join(percent(x) for x in row["share_interval_95"]), f"{row['mean_error_sd']:+.2f}",
             f"{row['sd_error_sd']:.2f}")
            for name, row in part["parameters"].items()
        ]  # fmt: skip
        ended = ", ".join(f"{count} {status}" for status, count in part["statuses"].items())
        parts.append(
            f"{pixels} pixels, {part['sessions']} sessions ({ended}), {part['median_events']:.0f} events and "
            f"{part['median_cpu_s']:.1f} s of CPU each in the median.\n\n"
            + table(
                ("parameter", "covered", "95 % interval of the share", "mean of error/std", "sd of error/std"), rows
            )
        )
    return "\n\n".join(parts)


def round_trip() -> str:
    """What `benchmarks/round_trip.py` found."""
    summary = of_json("benchmarks/round_trip.json")["summary"]
    ways = list(summary)
    names = list(summary[ways[0]]["parameters"])

    def held(way: str, name: str) -> str:
        row = summary[way]["parameters"][name]
        low, high = row["expected_range"]
        side = f", {row['one_sided']} with an open side" if row["one_sided"] else ""
        return f"{row['held']} of {row['of']} ({low} to {high}){side}"

    def late(way: str, when: str) -> str:
        row = summary[way]["delay_error_us"][when]
        return f"{row['median']:.1f} µs, at most {row['largest']:.1f} µs"

    rows = [(f"`{name}`", *(held(way, name) for way in ways)) for name in names]
    rows += [(f"error of the delay after `{when}`", *(late(way, when) for way in ways)) for when in ("convert", "fit")]
    caption = "Sessions whose 95 % interval held the truth; in brackets what 99 % of exact intervals would show.\n\n"
    return caption + table(("parameter", *(f"`--align {way}`" for way in ways)), rows)


def ranks() -> str:
    """What `benchmarks/posterior_ranks.py` found."""
    summary = of_json("benchmarks/posterior_ranks.json")["summary"]
    rows = [
        (f"`{name}`", " ".join(map(str, row["counts"])), f"{row['p_chi2']:.3f}", f"{row['p_ks']:.3f}")
        for name, row in summary["parameters"].items()
    ]
    return (
        f"{summary['posteriors_converged']} of {summary['sessions']} posteriors converged. Smallest χ² p-value over "
        f"the parameters, adjusted by Holm's method: {summary['smallest_p_holm']:.2f}.\n\n"
        + table(("parameter", "ranks in ten bins", "p (χ²)", "p (Kolmogorov–Smirnov)"), rows)
    )


def reconstruction() -> str:
    """What `benchmarks/reconstruction.py` found, one table per experiment."""
    groups: dict[str, dict[tuple, list[dict]]] = defaultdict(lambda: defaultdict(list))
    on_gpu = []
    for run in of_json("docs/reconstruction.json"):
        if run["device"] == "cuda":
            on_gpu.append(run)
            continue
        groups[run["experiment"]][run["setting"], run["arm"], run["iterations"], run.get("degree") or 0].append(run)
    lines, own_tables = [], {"whole": _whole, "grid": _grid}
    for experiment, arms in groups.items():
        if experiment in own_tables:
            lines.append(own_tables[experiment](arms))
            continue
        rows = []
        for (setting, arm, iterations, degree), runs in sorted(arms.items(), key=lambda item: -item[0][3]):
            psnr = [run["psnr"] for run in runs]
            spread = f"{statistics.stdev(psnr):.2f}" if len(psnr) > 1 else ""
            seconds = statistics.mean(run["cpu_seconds"] for run in runs)
            ssim = statistics.mean(run["ssim"] for run in runs)
            mean = f"{statistics.mean(psnr):.2f}"
            peak = [f"{max(run['peak_gib'] for run in runs):.1f}"] if experiment == "memory" else []
            rows.append(
                (setting, arm, degree, iterations, len(runs), mean, spread, f"{ssim:.3f}", f"{seconds:.0f}", *peak)
            )
        heads = ("setting", "arm", "harmonics", "steps", "seeds", "PSNR [dB]", "sd", "SSIM", "CPU s")
        heads = (*heads, "peak GiB") if experiment == "memory" else heads
        lines += [f"## {experiment.capitalize()}\n", table(heads, rows)]
        if experiment == "bandwidth":
            lines.append(_gain(arms))
    return "\n".join([*lines, _on_gpu(on_gpu)] if on_gpu else lines)


def moving_plane() -> str:
    """What `benchmarks/moving_plane.py` found."""
    rows = [
        (f"{run['white_fa']:,g}", f"{run['events']:,}", *(f"{value:.2f}" for value in run["scores"]))
        for run in of_json("docs/moving_plane.json")
    ]
    return table(("photocurrent of white [fA]", "events", "as recorded", "pixel undone"), rows)


def _whole(arms: dict[tuple, list[dict]]) -> str:
    """Cameras with more than the data sets' pixel: PSNR with everything known, ignored, and found in the events."""
    rows = []
    for (setting, camera), by in sorted(_two_words(arms).items(), key=lambda item: item[0][0]):
        psnr = [
            f"{statistics.mean(run['psnr'] for run in by[which]):.2f}" if which in by else ""
            for which in ("known", "ignored", "found")
        ]
        named = sorted({name for run in by.get("found", []) for name in run["found"]})
        seconds = [
            f"{statistics.mean(r['cpu_seconds'] for r in by[w]):.0f}" if w in by else "" for w in ("known", "found")
        ]
        rows.append((setting, camera, *psnr, ", ".join(named) or ("none" if "found" in by else ""), *seconds))
    psnr_heads = ("known [dB]", "ignored [dB]", "found [dB]")
    heads = ("setting", "camera", *psnr_heads, "what was found", "CPU s, known", "CPU s, found")
    return "## More of the pixel than the data sets say\n\n" + table(heads, rows)


def _two_words(arms: dict[tuple, list[dict]]) -> dict[tuple[str, str], dict[str, list[dict]]]:
    """Runs by setting and what stands before the colon of their arm, and what stands after it."""
    by: dict[tuple[str, str], dict[str, list[dict]]] = defaultdict(dict)
    for (setting, arm, *_), runs in arms.items():
        before, _, after = arm.rpartition(": ")
        by[setting, before][after] = runs
    return by


def _grid(arms: dict[tuple, list[dict]]) -> str:
    """PSNR over speed and illuminance: with the pixel modelled, ignored, and the gain."""
    rows = []
    for (_, cell), by in _two_words(arms).items():
        on, off = (statistics.mean(run["psnr"] for run in by[mode]) for mode in ("on", "off"))
        rows.append((*cell.split(", "), f"{on:.2f}", f"{off:.2f}", f"{on - off:+.2f}"))
    heads = ("speed", "photocurrent of white", "on [dB]", "off [dB]", "gain [dB]")
    return "## Speed and illuminance\n\n" + table(heads, rows)


def _on_gpu(runs: list[dict]) -> str:
    """Trainings on a GPU, one row each."""
    rows = [
        (
            run["experiment"], run["setting"], run["arm"], run["seed"], run["iterations"], f"{run['psnr']:.2f}",
            f"{run['ssim']:.3f}", f"{run['cpu_seconds']:.0f}", f"{run['peak_gib']:.1f}",
        )
        for run in runs
    ]  # fmt: skip
    heads = ("experiment", "setting", "arm", "seed", "steps", "PSNR [dB]", "SSIM", "CPU s", "GiB on the GPU")
    return "## Trained on a GPU\n\n" + table(heads, rows)


def _gain(arms: dict[tuple, list[dict]]) -> str:
    """PSNR with the pixel model minus without, seed by seed."""
    rows = []
    for (setting, arm, iterations, degree), runs in arms.items():
        off = {run["seed"]: run["psnr"] for run in arms.get((setting, "off", iterations, degree), [])}
        if arm == "on" and off and degree:
            rows.append((setting, ", ".join(f"{r['psnr'] - off[r['seed']]:+.2f}" for r in runs if r["seed"] in off)))
    return "Gain of modelling the pixel, on minus off, seed by seed:\n\n" + table(("setting", "dB"), rows)


def export_comparison() -> str:
    """What `benchmarks/export_comparison.py` measured, one table per simulator."""
    content = of_json("docs/results/export_comparison.json")
    names = {"v2e": "v2e", "iebcs": "IEBCS", "dvs-voltmeter": "DVS-Voltmeter", "evlib": "ESIM of evlib 0.13.2"}
    lines = []
    for name, title in names.items():
        rows = []
        for run in content["runs"]:
            if run["simulator"] != name:
                continue
            theirs, ours = run["theirs"], run["ours"]
            cells = [f"{theirs[k]:.2f} / {ours[k]:.2f}" for k in ("on_steps", "off_steps", "on_sine", "off_sine")]
            late = [
                " / ".join("none" if side[k] is None else f"{side[k]:.3f}" for side in (theirs, ours))
                for k in ("latency_up_ms", "latency_down_ms")
            ]
            rows.append((run["circuit"], *cells, *late))
        heads = ("circuit", "ON, steps", "OFF, steps", "ON, sine", "OFF, sine", "first ON [ms]", "first OFF [ms]")
        lines += [f"## {title}\n", table(heads, rows)] if rows else []
    if content["filter"]:
        apart = content["filter"]["difference_ln"]
        lines.append(
            "The pixel filter of Deblur e-NeRF, given the exported calibration, differs from the trajectory of this "
            f"package by {apart:.1e} in ln after 400 samples of a sine.\n"
        )
    return "\n".join(lines)


def conform_results() -> str:
    """Tables that `pixelid conform` made of recordings of simulators."""
    lines = []
    for path in sorted((ROOT / "docs" / "results" / "conform").glob("*.json")):
        content = json.loads(path.read_text())
        lines += [f"## {content['title']}\n", content["about"] + "\n", content["sentence"] + "\n"]
        rows = [
            (row["stage"].replace("_", " "), f"`{row['effect']}`", row["verdict"].replace("_", " "), _strength(row),
             "" if row["evidence"]["heldout_gain_nats"] is None else f"{row['evidence']['heldout_gain_nats']:.1f}",
             row["evidence"]["why"])
            for row in content["rows"]
        ]  # fmt: skip
        heads = ("stage", "effect", "verdict", "strength (95 %)", "held-out gain [nats]", "why")
        lines.append(table(heads, rows))
    return "\n".join(lines)


def _strength(row: dict) -> str:
    """The strengths of a row of conform.json, or what would have shown."""
    limit = row["evidence"]["detection_limit"]
    if limit:
        return f"would have shown at {limit['parameter']} = {limit['value']:.3g}"
    strengths = []
    for name, each in row["parameters"].items():
        ends = each["interval_95"]
        limits = f" ({' to '.join('–' if x is None else f'{x:.4g}' for x in ends)})" if ends else ""
        strengths.append(f"{name} = {each['value']:.4g}{limits}")
    return "; ".join(strengths)


def faults() -> str:
    """What `tests/faults.py` saw: commands against faults, kills and interrupts."""
    content = of_json("docs/results/faults.json")
    kinds = list(dict.fromkeys(kind for survived in content["faults"].values() for kind in survived))
    rows = []
    for name, survived in content["faults"].items():
        cells = [
            f"{e['survived']} of {e['runs']}" if (e := survived.get(kind)) and e["runs"] else "–" for kind in kinds
        ]
        rows.append((f"`{name}`", *cells))
    text = table(("command", *(kind if " " in kind else f"{kind} fails" for kind in kinds)), rows)
    kills = [(f"`{name}`", e["kills"], e["equal"]) for name, e in content["kills"].items()]
    text += "\n" + table(("command", "kills", "next run equal"), kills) if kills else ""
    heads = ("command", "interrupts", "exit code 130 in two seconds", "slowest [s]")
    ended = [
        (f"`{name}`", e["interrupts"], e["in_two_seconds"], e["slowest_s"])
        for name, e in content.get("interrupts", {}).items()
    ]
    return text + ("\n" + table(heads, ended) if ended else "")


def speed() -> str:
    """What `benchmarks/speed.py` measured."""
    return speed_page.page(of_json("docs/speed.json"), table)


def fuzzing() -> str:
    """What `tests/fuzz.py` found, run after run."""
    heads = ("seed", "damaged files", "kinds of file", "answered wrongly", "kinds of wrong answer")
    runs = of_json("docs/results/fuzz.json")
    return table(heads, ((e["seed"], e["runs"], e["targets"], e["failures"], e["kinds"]) for e in runs))


def lowlight_latencies() -> str:
    """Dominant poles of the shipped sensors from their latencies (`benchmarks/latency_poles.py`)."""
    from pixelid.lowlight.table import LATENCY_HEADINGS, latency_rows

    lines = []
    for name, latency in of_json("benchmarks/latency_poles.json").items():
        lines += [f"### `{name}`\n", table(LATENCY_HEADINGS, latency_rows(latency))]
        lines += [f"- {sentence}" for sentence in latency["sentences"]]
    return "\n".join([*lines, ""])
