"""Trace the recorded and the measured logs of a folder, and print what was found.

Run as `python -m benchmarks.recorded DATA [NAME...]`, where DATA holds one folder a
rig, each with `rig.toml`, `fit*` and `validate*`. For a folder `emps` the published
parameters of that benchmark are replayed beside ours, in the same windows and band.
"""

from __future__ import annotations

import resource
import sys
import time
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from hydrojax.jax_setup import set_up_jax, user_cache

PUBLISHED = {
    "payload_inertia.m": 95.1089,
    "viscous_friction.b": 203.5034,
    "k_cp": 20.3935,
    "k_cn": 20.3935,
    "k_0": -3.1648,
}
"""EMPS, least squares: A. Janot, M. Gautier, M. Brunot, Data Set and Reference Models
of EMPS, Workshop on Nonlinear System Identification Benchmarks, 2019. SI."""


def main(data: str, *names: str) -> None:
    """Trace each rig folder under `data`, or those named."""
    set_up_jax(user_cache())
    from hydrojax.identify import api
    from hydrojax.identify.case import open_case

    folders = [f for f in sorted(Path(data).iterdir()) if (f / "rig.toml").exists()]
    table = Table(
        "rig", "verdict", "effects", "before / noise", "after / noise",
        "free run, skill", "s",
    )  # fmt: skip
    console = Console(width=150)
    for folder in folders:
        if names and folder.name not in names:
            continue
        began = time.perf_counter()
        logs = sorted(folder.glob("fit*"))
        others = sorted(folder.glob("validate*"))
        case = open_case(folder / "rig.toml", logs, others)
        outcome = api.trace_case(case)
        channels = outcome.channels.items()
        table.add_row(
            folder.name,
            outcome.verdict,
            "\n".join(_said(e) for e in outcome.effects),
            "\n".join(
                f"{n} {c.before / c.noise:.2f} ({c.before:.4g} {c.unit})"
                for n, c in channels
            ),
            "\n".join(
                f"{n} {c.after / c.noise:.3f} ({c.after:.4g} {c.unit})"
                for n, c in channels
            ),
            "\n".join(
                f"{n} {_free_run(c.horizons.get('free'), c.unit)}" for n, c in channels
            ),
            f"{time.perf_counter() - began:.0f}",
        )
        named = ", ".join(e.name for e in outcome.effects) or "nothing"
        console.print(f"{folder.name}: {outcome.verdict}, named {named}")
        if folder.name == "emps":
            _against_published(case, outcome, console)
    console.print(table)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    console.print(f"peak memory {peak:.2f} GiB")


def _free_run(run, unit: str) -> str:
    """Error and skill of the run through whole logs."""
    if run is None or run.after is None:
        return "-"
    skill = "-" if run.skill is None else f"{run.skill:.4f}"
    return f"{run.after:.4g} {unit}, {skill}"


def _said(effect) -> str:
    found = ", ".join(f"{n}={p.value:.4g}" for n, p in effect.parameters.items())
    return f"{effect.name}: {found}"


def _against_published(case, outcome, console: Console) -> None:
    """Print our parameters beside the published ones, and both residuals.

    Theirs twice: with friction by the sign of v, as published (a bristle of 0.1 um and
    no presliding), and with the bristle and the switch of this model.
    """
    from hydrojax.identify import api

    _, check, _, _ = api._problems(case, ["payload_inertia"])
    names = check.model.names
    values = check.initial_values()
    for name, value in PUBLISHED.items():
        values[names.index(name)] = value
    theirs = []
    for z_ss, L_slope in ((1e-7, 1e6), (outcome.parameters["z_ss"].value, 300.0)):
        values[names.index("z_ss")] = z_ss
        values[names.index("L_slope")] = L_slope
        theirs.append(check.rms(check.errors_at(values))[2])
    found = {n: p.value for n, p in outcome.parameters.items()}
    found |= {
        f"{e.name}.{n}": p.value
        for e in outcome.effects
        for n, p in e.parameters.items()
    }
    table = Table("EMPS", "published", "found", "difference")
    for name, value in PUBLISHED.items():
        own = found.get(name, np.nan)
        table.add_row(
            name, f"{value:.4f}", f"{own:.4f}", f"{100 * (own / value - 1):+.2f} %"
        )
    ours = outcome.channels["F"].after
    table.add_row("validate, published model, N", f"{theirs[0]:.3f}", f"{ours:.3f}", "")
    table.add_row(
        "validate, with our bristle, N", f"{theirs[1]:.3f}", f"{ours:.3f}", ""
    )
    console.print(table)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("python -m benchmarks.recorded DATA [NAME...]")
    main(*sys.argv[1:])
