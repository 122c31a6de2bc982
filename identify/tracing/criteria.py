"""Every threshold that decides something in an identification or a trace."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Criteria:
    """The thresholds of an identification and of a trace, as one value.

    Each field gives its unit and what set it. `benchmarks.trace` stands for the
    benchmark of synthetic rigs with hidden effects in `benchmarks/trace`: such a value
    was chosen on its development cases and is held by its verdicts. Tolerances of
    numerical methods (damping, pivots, step sizes) and the layout of replay windows
    decide nothing about a rig and are not among them.
    """

    # -- which effects are added --

    matters: float = 0.02
    """Smallest fall of a channel's validation RMS that counts, as a share of its noise.
    The resolution that is asked of a trace; `benchmarks.trace`."""
    bends: float = 0.005
    """Rise of a pressure's validation RMS that an effect which acts on the pressures
    may bring where the force is compared too, as a share of its noise: a force that
    lacks something else bends the pressures for it (seen: 0.014 and 0.018).
    `benchmarks.trace --more several`."""
    level: float = 0.01
    """Family-wise significance below which a candidate's score is taken as real, 1.
    Convention; its false alarms are counted by `benchmarks.trace`."""
    at_noise: float = 1.1
    """RMS error over the noise up to which a channel is at its noise, 1.
    `benchmarks.trace`."""
    notable: float = 1.05
    """RMS error over the noise from which a report says that a channel which is at its
    noise is not quite there, 1. Half way to `at_noise`."""
    alike_gains: float = 0.15
    """Difference of the gains of both pressure sensors over their sum, below which a
    report says that a supply looks like them, 1. Convention: a few of the standard
    deviations with which a supply that is off by 10 % comes out as both."""
    fair_share: float = 0.2
    """Share of a channel's excess over its noise (in squares) that an effect has to
    take away where it does not bring the channel to its noise, 1: less is parameters
    that compensate, not an explanation. `benchmarks.trace`."""
    beyond_chance: float = 3.0
    """Standard errors by which the validation error must fall, windows paired, or by
    which a channel that comes down to its noise stood above it, 1. Convention (three
    sigma); `benchmarks.trace`."""
    worse_by: float = 2.0
    """Standard errors by which an alternative's validation error must be larger to be
    distinguished from the effect that was added, 1. Convention (two sigma)."""
    worse_at_least: float = 1e-3
    """Share by which some channel's validation RMS must be larger, beside that, 1: a
    lag and a delay of a fraction of a tick differ by less in every window, alike."""
    promising: float = 0.02
    """Share of chi-square from which a candidate is refitted whatever the p-value of
    its score, 1: under a second missing effect the scores of the windows scatter, and
    the test is weak. `benchmarks.trace`."""
    smallest_gain: float = 0.5
    """Gain of chi-square from which a candidate is refitted, over that of a change
    that matters, 1. `benchmarks.trace`."""
    tries: int = 4
    """Candidates that are refitted in a round, count; up to twice as many where some
    spoil another channel. `benchmarks.trace`."""
    near_best: float = 0.9
    """Gain over the best candidate's from which more than `tries` are refitted, 1.
    `benchmarks.trace`."""
    far_starts: int = 2
    """Starts far from zero from which an effect is fitted, count: the deepest minima of
    its scan. Time against a wrong minimum; `benchmarks.trace --sizes`."""
    far_fits: int = 6
    """Such starts, of all effects, that are fitted on a few windows, count. As
    `far_starts`."""
    far_steps: int = 5
    """Steps of these fits, count: they rank the starts and need not end. As
    `far_starts`."""
    far_longer: int = 4
    """Such fits, the best of all, that are given more steps where several effects are
    sought at once, count: time."""
    balance_ticks: int = 8000
    """Ticks whose flow balances are fitted to look for starts, count: in windows
    spread over the logs: time against information."""
    much: float = 2.0
    """RMS of a pressure over its noise that the first effect has to leave for several
    to be tried together, 1: time. `benchmarks.recorded` (machine 06)."""
    together: int = 9
    """Effects that are tried together, count: time."""
    together_steps: int = 20
    """Steps of their fits, count: a counterbalance valve takes half of what the
    balances lack, but after 20. `benchmarks.recorded` (machine 06)."""
    wanted: float = 0.02
    """Share of what the flow balances lack that the next of them has to take away, 1:
    a dead band of 5 % takes 4 % where a lag and air are missing too
    (`benchmarks.machines`, machine 11)."""
    outdone: float = 5.0
    """Times what the best start leaves of the balances from which another candidate is
    not refitted once the best has helped, 1: time. `benchmarks.trace`."""
    plainly_needed: float = 10.0
    """Rise of chi-square that the sums predict without an effect that was added, over
    that of a change that matters, from which the fit is not tried without it, 1: time.
    `benchmarks.trace`."""
    plainly_lacks: float = 0.5
    """Share of what the flow balances lack without an effect that they lack with a
    rival still, from which that is not tried in its place, 1: time."""
    rival: float = 0.7
    """Gain from which a candidate is tried in the place of an effect that was added,
    over that effect's own gain there, 1: a score is linear, and misjudges that much."""
    rivals: int = 2
    """Such candidates that are refitted for each effect, count: time."""
    near_parallel: float = 0.9
    """Cosine of projected columns from which a candidate may be taken for an effect, 1:
    below, it leaves more than `fair_share` of what the effect explains (1 - 0.9^2)."""
    rounds: int = 4
    """Effects that each of the two stages may add, count. `benchmarks.trace`."""
    first_step: float = 0.5
    """Part of the step predicted by a score from which a refit starts, 1: the step is
    linear and tends to overshoot. `benchmarks.trace`."""
    power: float = 0.8
    """Power of the test from which an effect that was not seen is absent, 1.
    Convention (Cohen, Statistical Power Analysis, 1988)."""
    draws: int = 2000
    """Draws of the wild cluster bootstrap of the maximum statistic, count: resolves
    p-values of about `counted_above` (Cameron, Gelbach and Miller, 2008)."""
    tail: float = 0.01
    """Quantile of these draws that gives the number of independent tests, 1: 20 of
    2000 draws lie below it. Checked by the size of the test on synthetic scores."""
    counted_above: float = 0.02
    """Family-wise p-value above which it is counted among the draws, 1; below, it is
    extrapolated by the number of independent tests. As `tail`."""

    # -- fits --

    blind_starts: int = 4
    """Least number of starts where no pressure is measured, count: a single one often
    ends in a local minimum there. `benchmarks.trace`."""
    start_spread: float = 0.3
    """Half range of the starts about the declared values, relative. `benchmarks.trace`.
    """
    short_windows: int = 192
    """Windows on which effects are looked for where there are at least twice as many,
    count: time against information. All take part in the last fit;
    `benchmarks.recorded` (machines)."""
    start_windows: int = 32
    """Windows on which the starts are compared, count: time against information."""
    reweighted_above: float = 1.25
    """RMS misfit over the noise from which a channel is weighted by its misfit, 1: it
    would otherwise distort the parameters that the other channels determine.
    `benchmarks.trace`."""
    weights_settled: float = 0.1
    """Relative change of the channels' weights below which they are settled, 1.
    Convergence; `benchmarks.trace`."""
    weight_rounds: int = 3
    """Fits of all parameters until the weights are settled, at most, count."""
    blind_rounds: int = 8
    """The same where no pressure is measured, count: initial pressures then follow the
    fit step by step."""
    blind_progress: float = 0.99
    """Ratio of two rounds' force errors above which such a fit is settled, 1."""
    pressures_settled: float = 0.5
    """Median correction of the initial pressures, over the least noise, below which
    the fit of the pressures is settled, 1."""
    enough_at_first: float = 1e-4
    """Share of its cost that a step of the declared model's first fit to the pressures
    has to promise, 1: time. `benchmarks.recorded` (machine 01)."""
    enough_in_short: float = 1e-3
    """The same on some of the windows, from where all are then fitted, 1: time."""
    enough_in_search: float = 1e-3
    """The same of a fit to the pressures while effects are looked for, 1: it moves
    their errors by 5e-4, where `matters` is 2e-2. `benchmarks.machines`."""
    blind_corrections: int = 6
    """Gauss-Newton corrections of the initial pressures where none is measured, count.
    `benchmarks.trace`."""
    asymmetry: float = 3.0
    """Standard deviations by which k_cp and k_cn must differ to be kept apart from an
    offset k_0, 1. Convention (three sigma)."""
    tied: float = 1e-3
    """Standard deviation that holds k_cp and k_cn together where they are not, N."""
    force_agrees: float = 0.05
    """Difference of the force and of the one that stretches the rod, RMS over the
    noise, below which both agree, 1. Convergence: 0.1 % of the noise in squares."""
    force_rounds: int = 10
    """Rounds until both forces agree, at most, count."""

    # -- uncertainty --

    unidentifiable: float = 0.5
    """Standard deviation over a parameter's size from which it is unidentifiable, 1: a
    95 % interval then reaches zero."""
    unseen_direction: float = 1e-10
    """Eigenvalue of the scaled curvature below which a direction is not observed, 1:
    rounding of double precision, with a margin."""
    unseen_std: float = 1e3
    """Standard deviation given to such a direction, in units of the scales, 1."""
    hardly_shown: float = 1e-6
    """Root of a parameter's curvature, over the largest, below which the logs hardly
    show it, 1: what is left there is rounding."""
    seen_across: float = 1.0
    """Standard deviations of the noise by which what is compared moves, as a parameter
    crosses its range, from which the logs show it whatever they show of others, 1."""
    nearly_singular: float = 0.05
    """Smallest eigenvalue of the scaled curvature below which only a combination of
    parameters is identifiable, 1. `tests/identify`."""
    partner: float = 0.2
    """Component of that eigenvector from which a parameter is named in it, 1."""
    confidence: float = 0.95
    """Confidence of profile-likelihood intervals, 1. Convention."""
    profile_close: float = 0.03
    """Relative accuracy of such an interval's ends, 1."""
    profile_refits: int = 5
    """Refits an end may take, count."""

    # -- what is read of the logs --

    slowest_tick: float = 0.05
    """Seconds between rows up to which a command is replayed: a chamber settles in far
    less."""
    fewest_rows: int = 20
    """Rows that a stretch without gaps must exceed, count."""
    most_ticks: int = 80_000
    """Ticks that a fit or a check uses, count: more only cost time."""
    band_noise_u: float = 0.1
    """Share of acceleration that may be noise of the position where u drives, 1:
    only acceleration is filtered there. `benchmarks.trace`."""
    band_noise_pressures: float = 0.005
    """The same where pressures drive, 1: speed and acceleration are filtered.
    `benchmarks.recorded`."""
    band_noise_P: float = 0.001  # noqa: N815, as the channel P
    """The same where the drive force P drives, 1: force is compared in that band.
    `benchmarks.recorded`."""
    lowest_band: float = 20.0
    """Hz below which motion is always followed: friction reverses that fast.
    `benchmarks.recorded`."""
    rough_pressures: float = 0.25
    """Share of acceleration that is noise from which motion is not followed, where
    pressures drive, even below that, 1: the bristle follows the displacement itself,
    and viscous friction follows a rough speed worse than a smooth one.
    `benchmarks.measured`."""
    above_floor: float = 10.0
    """Power over the noise floor from which a position's spectrum is signal, 1."""
    flat_floor: float = 1.5
    """Ratio of a spectrum's middle to its last fifth up to which it is white, 1."""
    flat_end: float = 1.15
    """Ratio of a spectrum's last fifth but one to its last up to which its end is, 1: a
    random walk makes 1.23, white noise 1."""
    fewest_bins: int = 64
    """Frequencies of a spectrum from which a floor is looked for in tenths of its band,
    1: six in each."""
    flat_part: float = 1.35
    """The same of two tenths of the band from 0.6 on, 1: what falls with the third
    power of frequency or faster makes 1.4 or more."""
    steep_fall: float = 10.0
    """Ratio of a spectrum at 0.3 of its band to that at 0.8 from which a flat end is a
    floor that motion meets, 1: a random walk makes 4, the motion of a mass 50."""
    sensor_counts: float = 0.3
    """Share of a channel's noise that the noise of what drives must bring to be
    smoothed, 1: it adds 4 % to that noise. `benchmarks.trace`."""
    position_draws: int = 3
    """Times that the position's noise is drawn for what it brings, of which the largest
    counts: of one it hangs on few windows. A choice; `benchmarks.blind` has rigs whose
    noise one draw undercounts."""
    distorted: float = 4.0
    """Ratio by which a rig as declared may answer the position's noise more strongly
    than the fitted one, 1: either may be wrong. `benchmarks.trace`."""
    recounted: float = 1.5
    """Ratio by which the model that was found may raise a channel's noise, by what the
    position's brings there, 1: a first fit lacked effects, and may have been too soft.
    `benchmarks.machines` (seed 65)."""
    backward: float = 5.0
    """Multiples of the force's noise by which friction must drive the motion for x to
    be taken as reversed, 1."""
    backward_speed: float = 0.3
    """Standard deviations of the speed from which it counts as moving there, 1."""

    # -- runs through whole logs --

    good_skill: float = 0.9
    """Skill through whole logs below which longer runs are fitted, where something is
    unexplained, 1: what is explained has 0.99 and more. `benchmarks.recorded`
    (machines)."""
    longer_run: float = 1.0
    """Seconds of the runs that are fitted then, first."""
    longest_run: float = 3.0
    """Seconds of those that are fitted next: runs of 6 s take twice the time for as
    much skill. `benchmarks.recorded` (machines)."""

    # -- the residual --

    stands_in: float = 0.97
    """Share of the squared error above the noise below which effects under the verdict
    `unknown` are said to stand in, perhaps, for what is missing, 1. Effects that were
    named in the place of laws outside the vocabulary took up to 0.96 of it
    (`benchmarks.trace --more unnamed`)."""
    drifts: float = 1.3
    """RMS error of the force over its noise, in runs of 1 s and through whole logs, up
    to which one that is at its noise over windows is explained, 1. It was 1.20 at most
    where the answer is right, and 1.75 and 2.1 with other effects in the place of a
    leak (results.jsonl of `benchmarks.trace --cases 20` and `--more unnamed=16`)."""
    drift_draws: int = 4
    """Times that parameters are drawn to see how far runs move by what the logs leave
    open of them, count."""

    correlates: float = 0.08
    """Share of the residual variance that a signal must explain to be named, 1.
    `benchmarks.trace`."""
    quantiles: int = 16
    """Quantiles of a signal between which the residual's means are compared, count."""
    shuffles: int = 99
    """Permutations of a signal's windows that give the p-value, count: its least value
    is 0.01."""
    line: float = 12.0
    """Height of a spectral line over the spectrum around it to be named, 1; it must
    stand out at `level` too. `benchmarks.trace`."""
    line_share: float = 0.25
    """Share of the spectrum of joined windows, over the share that the motion has
    there, that a steady line must hold to be named, 1. A choice, not a study: the word
    decides nothing."""
    few_windows: float = 0.02
    """Share of the windows in which over half of an excess lies, from which down they
    are said, 1: a fiftieth of noise alone never holds as much. Tests."""
    slow_noise: float = 2.5
    """Times a noise that was estimated from row to row up to which what is left, and
    goes with nothing, is said to be perhaps noise of a sensor behind a low-pass filter,
    1. A choice, not a study: the words decide nothing."""
    late_leaves: float = 0.5
    """Share of what stands above the noise that bringing a position forward may leave
    for it to be called late, 1. `tests/identify/test_late.py`, on machines that lack
    other things."""
    credible: float = 2.0
    """Times the force's error, of the declared model or with effects that bring it to
    its noise, up to which a balance of force may leave one with an input mended for
    that input to be blamed, 1. A choice: a balance that leaves more knows less of the
    friction than the model."""
    needed: float = 0.1
    """Share of the fall of the validation error that a parameter's change must give
    back for the verdict to wait on that parameter, 1. `benchmarks.trace`."""
    loop_seconds: float = 20.0
    """Seconds of a log that are run again in closed loop, at most."""
    loop_settle: float = 0.5
    """Seconds of them that are not compared at first: the initial state is unknown."""

    @property
    def band_noise(self) -> Mapping[str, float]:
        """Share of acceleration that may be noise, by what drives the replay."""
        return {
            "u": self.band_noise_u,
            "pressures": self.band_noise_pressures,
            "P": self.band_noise_P,
            "x": self.band_noise_pressures,
        }
