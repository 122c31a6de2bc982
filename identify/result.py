"""The result of an identification or a trace: tables, model and predictions."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from hydrojax.identify.case import Case, LogSource, read
from hydrojax.identify.discovery.catalogue import keep
from hydrojax.identify.estimation.problem import Problem
from hydrojax.identify.preparation.noise import CHANNELS
from hydrojax.identify.report.figures import every_parameter, judged
from hydrojax.identify.report.write import plot, result_html, write_report
from hydrojax.identify.results.curve import FoundCurve
from hydrojax.identify.results.outcome import FoundEffect, Outcome, Parameter
from hydrojax.parameters import get, parameter_specs, put
from hydrojax.plant.rig import Rig
from hydrojax.report.text import p_equation
from hydrojax.rigfile.build import build_rig
from hydrojax.rigfile.schema import RigFile

if TYPE_CHECKING:
    import plotly.graph_objects


@dataclass(frozen=True, repr=False)
class Result:
    """What `fit` or `trace` found.

    Attributes:
        outcome: all of it as plain data, which report.json holds.
        case: the rig and the logs that it was found with.
    """

    outcome: Outcome
    case: Case

    @property
    def verdict(self) -> str:
        """One of "nothing missing", "explained" and "unknown"."""
        return self.outcome.verdict

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """The effects that the model lacked, in the order in which they were found."""
        return self.outcome.effects

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """One row a parameter, by name; an effect's are `effect.parameter`.

        Columns: `value`, `std` (NaN where none is given), `low` and `high` (95 %
        interval), `unit` (of these four, SI), `identified`, `free` (whether it was
        fitted), `at_bound` (whether it hit a limit of its range).
        """
        return _frame(every_parameter(self.outcome))

    @cached_property
    def beside(self) -> pd.DataFrame:
        """As `parameters`, those that were fitted, with the curves in place; see
        `hydrojax.discover`. A curve and the parameters share what both can follow: the
        intervals count it. No rows where there is no curve.
        """
        return _frame(self.outcome.beside)

    @cached_property
    def channels(self) -> pd.DataFrame:
        """One row a compared channel, and `x` where it was predicted: errors are RMS,
        SI.

        Columns: `unit`, `noise` (standard deviation), `before` (with the declared
        model), `after` (with the final one), `ratio` (`after` over `noise`), `held` (of
        the value measured as each window began) and `skill`, 1 - (after / held)^2. They
        are of the test logs where there are any, with `validate_before` and
        `validate_after` beside them; else of the validation logs.
        """
        rows = {}
        for name, c in self.outcome.every_channel.items():
            rows[name] = {
                "unit": c.unit,
                "noise": c.noise,
                "before": c.before,
                "after": c.after,
                "ratio": c.after / c.noise,
            }
            if c.window:
                rows[name] |= {"held": c.window.held, "skill": c.window.skill}
            if c.validate is not None:
                rows[name]["validate_before"] = c.validate.before
                rows[name]["validate_after"] = c.validate.after
        return pd.DataFrame.from_dict(rows, orient="index").rename_axis("channel")

    @cached_property
    def horizons(self) -> pd.DataFrame:
        """Errors of longer runs: one row a channel and length of the run, RMS, SI.

        Columns: `before`, `after`, `held`, `arx` (a linear ARX model with the same
        inputs) and `skill`; NaN where a run does not stay finite. "free" runs through
        whole logs from their first window's pressures.
        """
        rows = {
            (name, length): {**vars(h), "skill": h.skill}
            for name, c in self.outcome.every_channel.items()
            for length, h in c.horizons.items()
        }
        frame = pd.DataFrame.from_dict(rows, orient="index", dtype=float)
        frame.index = pd.MultiIndex.from_tuples(rows, names=("channel", "run"))
        return frame

    @cached_property
    def long_rig(self) -> RigFile | None:
        """The rig file with values for longer runs; None where whole logs are
        predicted with skill, or nothing is unexplained.
        """
        long = self.outcome.long_runs
        return self.case.spec.with_text(long.rig_file) if long else None

    @cached_property
    def motion_rig(self) -> RigFile | None:
        """The rig file whose values predict the motion best; None where [load] has no
        `predicts`, or nothing has a mass.
        """
        motion = self.outcome.motion
        return self.case.spec.with_text(motion.rig_file) if motion else None

    @cached_property
    def rig(self) -> RigFile:
        """The rig file with the found values, and with the effects found."""
        return self.case.spec.with_text(self.outcome.rig_file)

    @cached_property
    def model(self) -> Rig:
        """The identified rig: a pytree, exactly as it was fitted."""
        rig = build_rig(self.case.spec, self.outcome.in_model)
        names = tuple(parameter_specs(rig))
        own = np.asarray(get(rig, names)).tolist()
        found = self.outcome.values
        at = [found.get(n, v) for n, v in zip(names, own, strict=True)]
        return put(rig, names, np.array(at))

    def predict(self, log: LogSource) -> pd.DataFrame:
        """Replay a log in the identified rig, in windows as the fit does.

        Args:
            log: a log of the same signals, from anywhere.

        Returns:
            One row a compared tick: `time` (s since the log began), then for each
            channel its prediction under its name and `NAME_measured`, SI. The first
            second of a log, and what does not fill a window, is not in it.

        Raises:
            InputError: see `open_case`.
        """
        data = self.case.preparation.data([read(log, self.case.spec)])
        problem = Problem.of(self.model, {}, data, self.case.criteria)
        values = np.asarray(problem.model.values)
        left = problem.residuals_at(values)
        measured = np.asarray(data.windows.measured)
        t = np.asarray(data.windows.t)[:, -measured.shape[1] :]
        out = {"time": t.ravel()}
        for c, name in enumerate(CHANNELS):
            if np.isfinite(data.noise[c]):
                out[name] = (measured - left)[..., c].ravel()
                out[f"{name}_measured"] = measured[..., c].ravel()
        return pd.DataFrame(out)

    @property
    def curves(self) -> tuple[FoundCurve, ...]:
        """What no known effect explains, as curves; see `hydrojax.discover`."""
        return self.outcome.curves

    def summary(self) -> str:
        """The verdict, the channels, the effects and the fitted parameters as text."""
        o = self.outcome
        title = f"hydrojax {o.command}: {o.rig}"
        logs = {"fit": o.fit_logs, "validation": o.validate_logs, "test": o.test_logs}
        used = [f"{kind}: {', '.join(names)}" for kind, names in logs.items() if names]
        fitted = self.parameters.loc[lambda rows: rows["free"]].drop(columns="free")
        found = [
            f"{e.name}: p {p_equation(e.p_value)}"
            + (f", not distinguishable from {', '.join(e.cannot_tell_from)}"
               if e.cannot_tell_from else "")
            for e in o.effects
        ]  # fmt: skip
        beside = [
            f"{c.name}: {100 * c.share:.0f} % of the excess, p "
            f"{p_equation(c.p_value)}, {c.law or 'no formula does as well'}"
            for c in o.curves
        ]
        says = [f.says for f in o.inputs[1:]]
        parts = [
            [title],
            [f"verdict: {o.verdict}", o.sentence, *used],
            [f"RMS errors on the {judged(o)} logs", _table(self.channels)],
            ["effects", *found] if found else [],
            ["curves beside the known effects", *beside] if beside else [],
            [_table(fitted)],
            ["with the curves in place", _table(self.beside.drop(columns="free"))]
            if o.beside
            else [],
            [f"- {line}" for line in (*says, *o.limits, *o.notes)],
        ]
        width = max(len(line) for line in parts[5][0].splitlines())
        rule = "\n" + "-" * width + "\n"
        return rule.join(_wrapped(part, width) for part in parts if part) + "\n"

    def plot(self, picture: str | None = None) -> Figure:
        """The most telling picture, or one of those of the report by its name.

        Raises:
            InputError: no such picture, or nothing to show in it.
        """
        return plot(self.outcome, picture)

    def explore(self) -> plotly.graph_objects.Figure:
        """Measured against model over time, to zoom into, in a notebook: see `plot`.

        A menu has every channel of every validation log. It needs plotly
        (`hydrojax[notebook]`).

        Raises:
            InputError: plotly is not installed, or there is no residual to show.
        """
        from hydrojax.identify.report.interactive import explore

        return explore(self.outcome)

    def save(self, folder: str | Path, command_line: str = "") -> None:
        """Write report.json, report.html, its figures and rig.toml into a folder.

        Args:
            folder: is made where there is none.
            command_line: by which the result came about, for the report.

        Raises:
            OSError: it cannot be written.
        """
        write_report(self.outcome, Path(folder), command_line)

    def keep(self, catalogue: str | Path) -> Path | None:
        """Add the curves that this trace names to a folder of effects, so that the next
        trace searches them: `load_effects(catalogue)`, or `trace --catalogue`.

        Args:
            catalogue: is made where there is none; what is in it stays as it is.

        Returns:
            The file that holds them, each under its name behind the rig's; None where
            the trace names none.

        Raises:
            InputError: the folder cannot be written to.
        """
        named = {e.name for e in self.outcome.effects}
        own = [c for c in self.outcome.curves if c.name in named]
        return keep(Path(catalogue), self.outcome.rig, own) if own else None

    def __repr__(self) -> str:
        o = self.outcome
        found = ", ".join(e.name for e in o.effects)
        effects = f", effects: {found}" if found else ""
        fitted = sum(p.free for p in every_parameter(o).values())
        return f"<{o.command} of {o.rig!r}: {o.verdict}{effects}, {fitted} parameters>"

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return result_html(self.outcome)


def _frame(parameters: Mapping[str, Parameter]) -> pd.DataFrame:
    """One row a parameter, by name."""
    none = (np.nan, np.nan)
    rows = {
        name: {
            "value": p.value,
            "std": np.nan if p.std is None else p.std,
            "low": (p.interval or none)[0],
            "high": (p.interval or none)[1],
            "unit": p.unit,
            "identified": p.identified,
            "free": p.free,
            "at_bound": p.at_bound,
        }
        for name, p in parameters.items()
    }
    return pd.DataFrame.from_dict(rows, orient="index").rename_axis("parameter")


def _wrapped(lines: list[str], width: int) -> str:
    """Lines of text under each other, none past `width`; tables as they are."""
    return "\n".join(
        text if "\n" in text else textwrap.fill(text, width) for text in lines
    )


def _table(frame: pd.DataFrame) -> str:
    """A table as text, five figures a number."""
    return frame.to_string(float_format=lambda v: f"{v:.5g}", na_rep="-")
