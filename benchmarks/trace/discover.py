"""`python -m benchmarks.trace.discover FOLDER`: curves for effects that are not known.

Three tables: effects outside the vocabulary (traced with all that is known first),
effects of the vocabulary that are withheld (only the declared model is fitted first),
and rigs that lack nothing, for which no curve may be offered. Truths are those of this
benchmark's own plant.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from .cases import LOGS, CaseSpec, write_cases
from .catalogue import OUTSIDE, UNNAMED
from .score import append, read_results
from .truths import laws

Row = dict[str, Any]

WITHHELD = (
    "stribeck",
    "viscous_friction",
    "pressure_friction",
    "position_friction",
    "friction_drift",
    "payload_inertia",
    "gravity_load",
    "external_leakage",
    "internal_leakage",
    "entrained_air",
    "valve_bias",
    "valve_deadband",
)
"""Effects that are a curve over one signal at one place."""

SIZES = (1.0, 3.0)
"""Sizes at which effects are hidden, in turn."""


def plan(outside: int, withheld: int, nothing: int) -> list[CaseSpec]:
    """So many cases of each kind."""
    both = [(n, s) for s in SIZES[::-1] for n in (*UNNAMED, *OUTSIDE)]
    known = [(n, s) for s in SIZES[::-1] for n in WITHHELD]
    return [
        *(CaseSpec(f"outside-{n}-{s:g}", "outside", {n: s}) for n, s in both[:outside]),
        *(
            CaseSpec(f"withheld-{n}-{s:g}", "withheld", {n: s})
            for n, s in known[:withheld]
        ),
        *(CaseSpec(f"nothing-{i}", "nothing") for i in range(nothing)),
    ]


def run(folder: Path, kind: str, traced: bool) -> Row:
    """One case: fit or trace, then the curves, beside the truth."""
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case
    from hydrojax.identify.checking.mended import mended_case
    from hydrojax.identify.discovery.discover import searched

    truth = json.loads((folder / "truth.json").read_text())
    fit, check = [folder / name for name in LOGS[:2]], [folder / LOGS[2]]
    began = time.process_time()
    case = open_case(folder / "rig.toml", fit, check)
    first = api.trace_case(case) if traced else api.identify(case, starts=1)
    if traced:
        case, _ = mended_case(case, first.inputs)
    spent = [time.process_time() - began]
    end, outcome = searched(case, first)
    spent.append(time.process_time() - began - spent[0])
    state = end.state
    after = state.check.rms(state.check.errors_at(state.point.values))
    seen = np.isfinite(state.noise)
    return {
        "kind": kind,
        "sizes": truth["sizes"],
        "verdict": first.verdict,
        "named": [e.name for e in first.effects],
        "before": max(c.after / c.noise for c in first.channels.values()),
        "after": float(np.max((after / state.noise)[seen])),
        "curves": [
            {
                "name": c.name,
                "p_value": c.p_value,
                "law": c.law,
                "share": c.share,
                "alike": c.alike,
            }
            | banded(end, c, truth)
            for c in outcome.curves
        ],
        "parameters": intervals(outcome, truth["rig"]),
        "seconds": spent,
    }


def banded(end: Any, found: Any, truth: Mapping[str, Any]) -> dict[str, float]:
    """A curve against the truth, of both only what is the curve's own; none where the
    truth is no such curve.

    Returns:
        `inside`, the share of the samples at which the truth lies in the 95 % band;
        and over the truth's largest value at these: `half` the band's mean width, and
        the RMS error, `off`.
    """
    from hydrojax.effects.splines import bspline
    from hydrojax.identify.discovery.smooth import covariance

    of = [law for name, e in truth["effects"].items()
          for term, law in laws(name, e, truth["rig"]).items()
          if term == found.name]  # fmt: skip
    if not of:
        return {}
    curve = next(c for c in end.curves if c.laid.term.name == found.name)
    knots, size = np.asarray(curve.laid.effect.knots), curve.laid.term.size
    _, part = covariance(end.columns[found.name], curve.smooth)
    s = np.quantile(found.rug, np.linspace(0.01, 0.99, 200))
    B = np.asarray(bspline(s, knots))
    c = np.linalg.pinv(B, rcond=1e-6) @ of[0](s) / size
    want = of[0](s) - size * B @ (c - part @ c)
    y, std = (np.interp(s, found.s, of) for of in (found.y, found.std))
    error, half, most = y - want, 1.96 * std, max(float(np.max(np.abs(want))), 1e-300)
    return {
        "inside": float(np.mean(np.abs(error) < half)),
        "half": float(np.mean(half)) / most,
        "off": float(np.sqrt(np.mean(error**2))) / most,
    }


def intervals(outcome: Any, rig: Mapping[str, float]) -> dict[str, float]:
    """How many standard deviations each of the rig's parameters lies off its truth, as
    reported: with the curves in place, where there are any. Without those that are said
    not to be identified.
    """
    found = outcome.beside or outcome.parameters
    return {
        n: abs(found[n].value - v) / found[n].std
        for n, v in rig.items()
        if n in found and found[n].identified and found[n].std is not None
    }


def _told(rows: Sequence[Row]) -> str:
    """How many parameters lie in their intervals."""
    z = np.array([v for r in rows for v in r["parameters"].values()])
    return f"{np.sum(z < 1.96)} of {len(z)}"


def report(rows: Sequence[Row]) -> str:
    """The tables, as Markdown."""
    out = []
    for kind in ("outside", "withheld", "nothing"):
        own = [r for r in rows if r["kind"] == kind and "after" in r]
        if not own:
            continue
        out += [
            f"\n## {kind}: {len(own)} cases\n",
            "| case | verdict | named | error/noise | with curves | curves | in band |"
            " parameters in 95 % | CPU s |",
            "|---|---|---|---|---|---|---|---|---|",
        ]
        for r in own:
            curves = "; ".join(
                f"{c['name']} ({c['law']})" if c["law"] else c["name"]
                for c in r["curves"]
            )
            bands = "; ".join(
                f"{c['inside']:.0%} (± {c['half']:.0%}, off {c['off']:.0%})"
                if "inside" in c
                else "–"
                for c in r["curves"]
            )
            z = np.array(list(r["parameters"].values()))
            out.append(
                f"| {r['case']} | {r['verdict']} | {', '.join(r['named']) or '–'} | "
                f"{r['before']:.2f} | {r['after']:.2f} | {curves or '–'} | "
                f"{bands or '–'} | {np.sum(z < 1.96)}/{len(z)} | "
                f"{' + '.join(f'{s:.0f}' for s in r['seconds'])} |"
            )
        told = [c["inside"] for r in own for c in r["curves"] if "inside" in c]
        explained = [r for r in own if r["after"] <= 1.1]
        out += [
            "",
            f"Offered a curve: {sum(bool(r['curves']) for r in own)} of {len(own)}. "
            f"Error up to 1.1 × noise: {sum(r['after'] <= 1.1 for r in own)}. "
            f"Verdict `explained`: {sum(r['verdict'] == 'explained' for r in own)}. "
            + (
                f"Truth in the band at {np.mean(told):.0%} of the samples, worst "
                f"{min(told):.0%} ({len(told)} curves). "
                if told
                else ""
            )
            + f"Parameters in their 95 % interval: {_told(own)}, {_told(explained)} "
            "where the error comes so far.",
        ]
    return "\n".join(out) + "\n"


def main(
    folder: Annotated[Path, typer.Argument(help="of cases and results")],
    outside: Annotated[int, typer.Option(help="effects outside the vocabulary")] = 106,
    withheld: Annotated[int, typer.Option(help="effects withheld from it")] = 24,
    nothing: Annotated[int, typer.Option(help="rigs that lack nothing")] = 8,
    fitted: Annotated[
        bool,
        typer.Option(help="fit the declared model alone before effects outside"),
    ] = False,
    only: Annotated[
        list[str] | None,
        typer.Option(help="run only this case (repeat the option)"),
    ] = None,
) -> None:
    """Look for curves on rigs with known truths; a killed run goes on where it was."""
    from hydrojax.jax_setup import set_up_jax, user_cache

    set_up_jax(user_cache())
    specs = plan(outside, withheld, nothing)
    if missing := sorted({*(only or ())} - {s.name for s in specs}):
        raise typer.BadParameter(f"no such case: {missing[0]}", param_hint="--only")
    specs = [s for s in specs if not only or s.name in only]
    results = folder / "discover.jsonl"
    known = {row["case"] for row in read_results(results)} if results.exists() else ()
    new = [s for s in specs if not (folder / s.name / "truth.json").exists()]
    if new:
        write_cases(new, folder)
    for spec in specs:
        if spec.name in known:
            continue
        print(spec.name, file=sys.stderr)
        try:
            row = run(
                folder / spec.name, spec.kind, spec.kind == "outside" and not fitted
            )
        except Exception as error:  # one bad case must not stop the others
            row = {"kind": spec.kind, "failed": f"{type(error).__name__}: {error}"}
        append(results, {"case": spec.name} | row)
    wanted = {s.name for s in specs}
    print(report([r for r in read_results(results) if r["case"] in wanted]))


if __name__ == "__main__":
    typer.run(main)
