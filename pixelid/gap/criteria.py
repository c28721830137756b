"""Every number that decides a verdict, in one place; `benchmarks/gap_sensitivity.py` halves and doubles each.

What follows from another number is not here but derived where it is used: thresholds of p-values from alpha, standard
errors from the pixels, the number of nats that a name needs from the χ² mixture of the gain under no effect
(`attribute/significance.py`).  Numbers that only steer a computation (steps, tolerances, replicates) are constants of
that routine.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from pixelid.errors import InputError


@dataclass(frozen=True)
class Criteria:
    """What a search for the gap judges by.

    Raises InputError for a number that is not positive.

    Detection
        min_cell_events: Of a cell of the residual maps, whose score is judged as normal: it is a sum of this many
            clipped residuals at least.
        min_cell_share_unfitted: Of a cell's variance that must be left when the fitted parameters are projected out;
            the projection is first order, and below a tenth its own error is as large as what it leaves.
        max_unexplained_fraction: Events that the background explains better than any threshold.  A true model leaves
            10⁻⁵ or fewer (`likelihood/event_times.py`); ten times that is allowed.
        max_unexplained_fraction_jittered: The same at imputed times behind a jitter, where some events cannot be
            placed.  Chosen on simulated jitters up to half the dead time.
        max_p_unexplained: Poisson chance from which an excess of such events counts.  Not alpha: the law of rare
            misfits is not known so far out, so only what no law could excuse is to count.
    Attribution
        min_lead_nats: A likelihood ratio of e⁵ = 150, "very strong" (Kass & Raftery 1995, JASA 90, 773): by which the
            leading effect must lead (with unseen pixels that favour it counted in), an effect that later ones explain
            away may still gain, a better optimum must be better, and an effect that would show less is called unseen.
        min_lead_standard_errors: By which a gain on pixels that no fit has seen must exceed zero, or a rival's (paired
            over pixels).  It is a second lock behind the p-value, not a test of its own.
        min_relative_strength: Of an effect's typical strength: what is a hundredth of it, an error of the stimulus or
            of another stage's model imitates.  A choice.
        min_relative_strength_flicker: The same of mains flicker, a modulation of 0.25 %: any periodic error of the
            stimulus passes for it.  A choice.
    A flexible alternative to the leading effect
        min_share_beside_alternative: Of its gain that an effect must keep where a flexible term gains more than it
            does: more than the alternative takes away.
        max_alternative_gain_ratio: Of the alternative's held-out gain to the effect's, from which an effect that keeps
            less ends the search: whatever is missing, it is a neighbour at best.
    A description of what no effect explains
        min_description_share: Of the flexible term's gain on unseen pixels that a description must gain there, its
            penalty paid: a description that explains less than what localises the remainder is of something else.
    Times behind a readout
        max_wait_service_times: Window of nine events in ten behind a queue, beyond which a recording has lost its
            times.  Chosen on simulated queues.
        max_unexplained_share_of_recording: Of its events at imputed times, beyond which they count as lost, and
            of those at exact times, beyond which the model lacks something.  Chosen on simulated queues: a hundred
            times what a true model leaves at true times.
        min_lost_share_at_exact_times: Of the fitted fraction of lost events, by which events that did not wait in a
            queue must be fewer: beside true losses, some of what drawn times leave is misplaced.  A choice.
        min_lost_fraction_at_drawn_times: Of events, behind a jitter or a coarse tick: sessions that lose none showed
            0.0003 to 0.0033 there (six, jitters of 1.5 dead times).
        min_stamps_gain_nats: Of a limit of the slew or a pole more on stamps, with all times summed over that they can
            stand for.  Models that differed by a pole that was not there differed by up to 14 nats (behind queues,
            where none is asked for).  A limit that was there gained 5,447.
        max_jitter_divergence_nats: Relative entropy per event between the imputed displacements of a recording's
            polarity and the one normal that a jitter is: 0.1 is a shift by 0.45 or a spread by 1.33.
    Shot noise
        min_shot_noise_gain_nats: By which simulated replicates with it must come nearer than those without: 1.4
            standard deviations of the distance between replicates of one model (√(n/2) of n = 400 cells: 14 nats).
            Also the error of how much nearer replicates with one effect more come (of a difference of two distances),
            and so what an effect must gain for that to show, and shot noise by its filter for being another's rival.
        max_share_left_by_shot_noise: Of the distance without it that may remain.
        sufficient_p_shot_noise: Of what it alone leaves, from which on it takes the place of all that was named before.
        artefact_error_share: Of the root of what effects gain under shot noise in sessions that lack them, by which
            another session's differs: what the approximation leaves changes with how well the density is known (5 %)
            and with what is missing.  Roots of gains above 20 nats were up to 23 % larger in ten of eleven sessions,
            30 to 52 % in one, its density found 10 % too low.
        replicate_error_share: Of what shot noise explains by which replicates at the best density are off themselves.
        unexplained_overdispersion: Variance of the number of unexplained events over Poisson's: pixels share
            thresholds, so they come in groups.
        min_alternation_score: Scores of the product of successive residuals, of either sign, from which shot noise is
            tried before a second effect is.
    Confirmation
        min_closed_fraction: Of the free-run gap: effects that surely close less are withdrawn.
        complete_closed_fraction: Of the free-run gap: less is not closed, whatever the maps say.
        min_visible_gap_sd: By which the gap must exceed its floor, for a closed fraction to mean anything (95 %).
        min_hidden_cosine: Between an effect and what the free parameters can do, from which it may hide behind them:
            0.9 leaves a fifth of its information.
    """

    min_cell_events: int = 30
    min_cell_share_unfitted: float = 0.1
    max_unexplained_fraction: float = 1e-4
    max_unexplained_fraction_jittered: float = 5e-3
    max_p_unexplained: float = 1e-9
    min_lead_nats: float = 5.0
    min_lead_standard_errors: float = 1.0
    min_relative_strength: float = 0.01
    min_relative_strength_flicker: float = 0.05
    min_share_beside_alternative: float = 0.5
    max_alternative_gain_ratio: float = 4.0
    min_description_share: float = 1.0
    max_wait_service_times: float = 200.0
    max_unexplained_share_of_recording: float = 0.01
    min_lost_share_at_exact_times: float = 0.5
    min_lost_fraction_at_drawn_times: float = 0.01
    min_stamps_gain_nats: float = 20.0
    max_jitter_divergence_nats: float = 0.1
    min_shot_noise_gain_nats: float = 20.0
    max_share_left_by_shot_noise: float = 0.3
    sufficient_p_shot_noise: float = 0.05
    artefact_error_share: float = 0.3
    replicate_error_share: float = 0.05
    unexplained_overdispersion: float = 2.0
    min_alternation_score: float = 5.0
    min_closed_fraction: float = 0.1
    complete_closed_fraction: float = 0.75
    min_visible_gap_sd: float = 2.0
    min_hidden_cosine: float = 0.9

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not value > 0:
                raise InputError(f"criteria: {field.name}: expected a positive number, found {value}")
