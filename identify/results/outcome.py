"""What a run found, as plain data and as report.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from hydrojax.identify.checking.words import Finding
from hydrojax.identify.results.curve import FoundCurve
from hydrojax.identify.tracing.criteria import Criteria


@dataclass(frozen=True)
class Parameter:
    """One parameter as found; SI. `std` and `interval` are None where there is none.

    `free` is False for what the rig file holds or leaves at its default. `profile` is
    the 95 % interval by profile likelihood where it was asked for; an end is None where
    the range ends first.
    """

    value: float
    unit: str
    description: str
    start: float
    free: bool
    std: float | None = None
    interval: tuple[float, float] | None = None
    at_bound: bool = False
    identified: bool = True
    profile: tuple[float | None, float | None] | None = None


@dataclass(frozen=True)
class Errors:
    """Error of one channel with the declared model and with the final one, RMS, SI."""

    before: float
    after: float


@dataclass(frozen=True)
class Horizon:
    """RMS error of one channel over runs of one length, SI; None where a run does not
    stay finite.

    Attributes:
        before: of the declared model.
        after: of the final model.
        held: of the value measured as each run began.
        arx: of a linear ARX model of order 4 with the same inputs, fitted by least
            squares to the fitted logs and simulated.
    """

    before: float | None
    after: float | None
    held: float
    arx: float | None

    @property
    def skill(self) -> float | None:
        """1 - (after / held)^2: 1 is perfect, 0 no better than the held value."""
        if self.after is None or self.held == 0.0:
            return None
        return 1.0 - (self.after / self.held) ** 2


def skill_text(h: Horizon | None) -> str:
    """A skill to three decimals, or a dash where there is none."""
    return "–" if h is None or h.skill is None else f"{h.skill:.3f}"


@dataclass(frozen=True)
class ChannelErrors:
    """Error of one channel, RMS, SI: on the test logs where there are any, and then
    that on the validation logs is `validate`; else on the validation logs, or on the
    fitted ones where there are none of either.

    `horizons` are errors by length of the run: "0.25", "1", "5" (seconds), "free".
    """

    unit: str
    noise: float
    before: float
    after: float
    validate: Errors | None = None
    horizons: Mapping[str, Horizon] = field(default_factory=dict)

    @property
    def window(self) -> Horizon | None:
        """That of single windows, which `before` and `after` are of too."""
        return next(iter(self.horizons.values()), None)


@dataclass(frozen=True)
class FoundEffect:
    """An effect that was named; `parameters` by their own names; errors by channel, on
    the validation logs. `share` is the part that it takes of the excess over the noise,
    in squares, of all channels in units of their noise.
    """

    name: str
    parameters: dict[str, Parameter]
    p_value: float
    before: dict[str, float]
    after: dict[str, float]
    cannot_tell_from: tuple[str, ...]
    residual_axis: str
    share: float = 0.0


@dataclass(frozen=True)
class Candidate:
    """What became of a candidate; `share` is the part of the fit's chi-square that a
    linear step along it would remove.
    """

    name: str
    status: str
    p_value: float
    power: float
    share: float
    why: str


@dataclass(frozen=True)
class Dependence:
    """How far the residual correlates with a signal: the share of its variance, and
    the chance that signal and residual of unrelated windows would share as much.
    """

    signal: str
    share: float
    p_value: float


@dataclass(frozen=True)
class Stretch:
    """A stretch of a log, s since the log's time 0, and the share of a residual's
    excess in squares that lies in it.
    """

    log: str
    start: float
    end: float
    share: float


@dataclass(frozen=True)
class Unexplained:
    """What stays above the noise: channel, size (SI), what it follows, in words.

    `tests` are of every signal, the clearest first; `line` the frequency (Hz) at which
    it stands out, or None; `next` what to record to learn more; `where` the windows
    that hold over half of it, the largest first, if a few do; `beyond_windows` says
    that it shows in runs longer than a window only.
    """

    channel: str
    excess: float
    unit: str
    follows: str
    description: str
    tests: tuple[Dependence, ...] = ()
    line: float | None = None
    next: str = ""
    where: tuple[Stretch, ...] = ()
    beyond_windows: bool = False


@dataclass(frozen=True)
class Series:
    """Residuals of one validation log over its windows, for pictures; SI.

    Attributes:
        log: its name.
        t: s since the log began, with NaN rows between windows that do not adjoin.
        measured: by channel.
        before: residuals of the declared model, by channel.
        after: residuals of the final model, by channel.
        signals: by name, the quantities against which a residual may stand out (`v`,
            `x`, `P_a1 + P_a2`, `u`, ...).
    """

    log: str
    t: Float[np.ndarray, "rows"]
    measured: dict[str, Float[np.ndarray, "rows"]]
    before: dict[str, Float[np.ndarray, "rows"]]
    after: dict[str, Float[np.ndarray, "rows"]]
    signals: dict[str, Float[np.ndarray, "rows"]]


@dataclass(frozen=True)
class LoopCheck:
    """A measured closed-loop run beside the same run in the identified loop; SI.

    Attributes:
        log: its name.
        t: s since the run began.
        desired: force.
        measured: force.
        simulated: force.
        rms: of measured - simulated.
        tracking_measured: RMS of desired - measured.
        tracking_simulated: RMS of desired - simulated.
        warning: why the simulation is not valid, or empty.
    """

    log: str
    t: Float[np.ndarray, "rows"]
    desired: Float[np.ndarray, "rows"]
    measured: Float[np.ndarray, "rows"]
    simulated: Float[np.ndarray, "rows"]
    rms: float
    tracking_measured: float
    tracking_simulated: float
    warning: str


@dataclass(frozen=True)
class MotionValue:
    """A parameter that predicts the motion best, SI; `windows` is its value as found
    from pressures and force.
    """

    value: float
    windows: float
    unit: str


@dataclass(frozen=True)
class PredictedMotion:
    """What the logs hold in runs in which the drive moves the load, with nothing of
    their motion but where a run begins; SI.

    Attributes:
        channels: errors of the position `x`, and of what was measured besides;
            `before` and `after` over runs of 0.25 s. Where a run does not stay finite,
            or nothing has a mass, there is none.
        windows: RMS errors over whole logs with the parameters that were found from
            pressures and force, by channel; None where that is not finite.
        fitted_to: what `values` are best for: "runs" through whole logs, or "windows"
            where these predict the validation logs at least as well.
        values: the parameters that were free, by name.
        series: measured, and measured less predicted, through whole logs.
        rig_file: the rig file with these values.
    """

    channels: Mapping[str, ChannelErrors]
    windows: Mapping[str, float | None]
    fitted_to: str
    values: dict[str, MotionValue]
    series: tuple[Series, ...]
    rig_file: str


@dataclass(frozen=True)
class LongRuns:
    """Values for longer runs, of a model that loses its way through whole logs; SI.

    Attributes:
        seconds: of the runs that they were fitted to.
        channels: errors through whole logs by channel: `before` with the values found,
            `after` with these.
        rig_file: the rig file with these values.
    """

    seconds: float
    channels: Mapping[str, Horizon]
    rig_file: str


@dataclass(frozen=True)
class LogFile:
    """One log of a run.

    Attributes:
        name: of the file.
        use: "fit", "validate" or "test".
        rows: number of rows.
        seconds: length, s.
        sha256: of the file's content; "" for a log that is no file.
    """

    name: str
    use: str
    rows: int
    seconds: float
    sha256: str = ""


@dataclass(frozen=True)
class Covariance:
    """Covariance of the fitted parameters inside their ranges, by name; SI."""

    names: tuple[str, ...]
    matrix: Float[np.ndarray, "n n"]


@dataclass(frozen=True)
class Outcome:
    """All that `identify` or `trace` found.

    `verdict` is "nothing missing", "explained" or "unknown"; `sentence` says it.
    `limits` are sentences on what is at a range's end or not identified. `rig_file` is
    the rig file with the identified values and the effects found; `values` are
    all parameters by name, SI, as stored; `criteria` the thresholds that decided;
    `inputs` what looks wrong with rig file and logs. `validate_logs` are empty where
    none were given: errors are then those of the fitted logs. `files` are the logs;
    `curves` what was found beside the known effects, where it was asked for, and
    `beside` the fitted parameters with these in place; `motion`
    what a rig file predicts of it, which no verdict counts; `long_runs` values for
    longer runs, where those found have no skill through whole logs; `tolerated` the
    effects in the model that lie within the tolerance of a constant that is the same,
    which are not called missing.
    """

    command: str
    rig: str
    fit_logs: tuple[str, ...]
    validate_logs: tuple[str, ...]
    verdict: str
    sentence: str
    parameters: dict[str, Parameter]
    channels: dict[str, ChannelErrors]
    effects: tuple[FoundEffect, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    unexplained: tuple[Unexplained, ...] = ()
    limits: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    series: tuple[Series, ...] = ()
    loops: tuple[LoopCheck, ...] = ()
    covariance: Covariance | None = None
    rig_file: str = ""
    test_logs: tuple[str, ...] = ()
    values: dict[str, float] = field(default_factory=dict)
    criteria: Criteria = Criteria()
    inputs: tuple[Finding, ...] = ()
    files: tuple[LogFile, ...] = ()
    curves: tuple[FoundCurve, ...] = ()
    beside: Mapping[str, Parameter] = field(default_factory=dict)
    motion: PredictedMotion | None = None
    long_runs: LongRuns | None = None
    tolerated: tuple[str, ...] = ()

    @property
    def every_channel(self) -> dict[str, ChannelErrors]:
        """The channels that were compared, and the motion where it was predicted."""
        return self.channels | ({"x": self.motion.channels["x"]} if self.motion else {})

    @property
    def in_model(self) -> tuple[str, ...]:
        """The effects in the model that the rig file does not declare."""
        return (*(e.name for e in self.effects), *self.tolerated)

    @property
    def explained_share(self) -> float:
        """The part that all effects together take of the excess over the noise, in
        squares; 0 where there was no excess, or no effect.
        """
        ends = [(c.validate or c, c.noise) for c in self.channels.values()]
        excess = sum(excess_of(e.before, noise) for e, noise in ends)
        rest = sum(excess_of(e.after, noise) for e, noise in ends)
        if not excess or not self.effects:
            return 0.0
        return min(max(1.0 - rest / excess, 0.0), 1.0)


def excess_of(rms: float, noise: float) -> float:
    """The part of a mean square error that noise does not account for, over the
    noise's.
    """
    return max((rms / noise) ** 2 - 1.0, 0.0)
