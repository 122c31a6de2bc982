"""Gains tuned for rigs that were found from logs, in the plant that recorded the logs.

    python -m benchmarks.tuned --cases 20 --out FOLDER

Cases are of `benchmarks.trace`: by turns nothing is missing, and one effect as large as
the literature has it. Each is traced, the rig that was found is tuned with the trace's
uncertainty, and the gains before and after run in the recording plant itself, with what
it hides, its piston led by a stiff servo along the motion; the law is the package's
own. A run that was killed goes on where it was.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import gains
from benchmarks.trace import cases
from benchmarks.trace.catalogue import NAMED
from benchmarks.trace.excitation import TICK
from hydrojax.jax_setup import LOOPS, set_up_jax, user_cache
from hydrojax.report.record import read_report
from hydrojax.tune import api, trials, verification

AGREES = 0.1
"""Relative difference up to which a promised band is a measured one."""
WORSE = 1.05
"""Error relative to that before from which gains track worse."""

Row = dict[str, Any]


def specs(count: int) -> list[cases.CaseSpec]:
    """The first cases, both kinds by turns."""
    half = -(-count // 2)
    made = cases.plan(0, {"nothing": half, "large": half}, list(NAMED))
    return [s for pair in zip(made[:half], made[half:], strict=True) for s in pair][
        :count
    ]


def tuned(spec: cases.CaseSpec, folder: Path) -> Row:
    """One case: traced, tuned, and run in the plant that recorded it."""
    place, found_at = folder / spec.name, folder / spec.name / "found"
    if not (found_at / "report.json").exists():
        # In a process of its own: fits and loops want JAX set up differently.
        fit, last = [str(place / log) for log in cases.LOGS[:2]], cases.LOGS[2]
        logs = [*fit, "--validate", str(place / last), "--out", str(found_at)]
        command = [
            sys.executable,
            "-m",
            "hydrojax.cli",
            "trace",
            str(place / "rig.toml"),
        ]
        subprocess.run([*command, *logs], capture_output=True)
    found = read_report(found_at)
    planned = api.plan_tuning(found_at / "rig.toml", findings=found_at)
    made = api.tune_gains(found_at / "rig.toml", findings=found_at)
    o, proposal = planned.objective, made.proposal
    lane = cases.lanes_of(spec)[0][0]
    count = len(o.trials.names)
    tries = (proposal.before, proposal.after)
    rows = [o.rows(t.gains, (0.0,)) for t in tries]
    both = gains.Rows(
        *(
            np.repeat(np.stack([a[0], b[0]]), count, axis=0)
            for a, b in zip(*rows, strict=True)
        )
    )
    which = np.tile(np.arange(count), 2)
    F = gains.simulate(o, both, which, [lane] * len(which))
    F = np.moveaxis(F.reshape(2, count, -1), 0, 1)  # [trials, before and after, N]
    _, _, follows = gains.bands(o, F)
    swings = [trials.oscillation(o.trials, k, F[k], TICK) for k in range(count)]
    noise = [verification.stability(o, t.gains)[2][0] for t in tries]
    wide = trials.SHARE * o.trials.amplitude[:, None]
    wide = np.maximum(wide, trials.NOISES * np.array(noise))
    errors = {
        name: trials.rms_error(o.trials, k, F[k])
        for name, k in (("locked", trials.FORCE_LOCKED), ("moving", trials.MOVING))
    }
    return {
        "case": spec.name,
        "verdict": found.verdict,
        "named": [e.name for e in found.effects],
        "proposed": proposal.found,
        "obstacles": list(proposal.obstacles),
        "gains": made.gains,
        "promised": [float(t.follows_to[0]) for t in tries],
        "worst": [float(t.follows_to.min()) for t in tries],
        "measured": follows.tolist(),
        "oscillates": np.any(np.array(swings) > wide, axis=0).tolist(),
        "swings": np.max(np.array(swings) / wide, axis=0).tolist(),
        **{name: e.tolist() for name, e in errors.items()},
    }


def table(rows: list[Row]) -> str:
    """All cases, and how many promises were kept."""
    head = ("case", "found", "proposed", "promised", "worst", "measured")
    lines = [" | ".join(("", *head, "locked, N", "moving, N", "oscillates", ""))]
    lines.append("|---" * 9 + "|")
    for r in rows:
        pair = {n: " to ".join(f"{v:.3g}" for v in r[n]) for n in PAIRS}
        cells = (
            r["case"],
            " + ".join(r["named"]) or r["verdict"],
            "yes" if r["proposed"] else "no",
            *(pair[n] for n in PAIRS),
            " to ".join("yes" if o else "no" for o in r["oscillates"]),
        )
        lines.append(" | ".join(("", *cells, "")).strip())
    new = [r for r in rows if r["proposed"]]
    wide = [r for r in new if r["promised"][1] > 0]
    off = [abs(r["measured"][1] / r["promised"][1] - 1) for r in wide]
    worse = [r for r in new for n in ("locked", "moving") if r[n][1] > WORSE * r[n][0]]
    lines += [
        "",
        f"{len(new)} of {len(rows)} got new gains; of these "
        f"{sum(r['oscillates'][1] for r in new)} oscillate in the other plant "
        f"({sum(r['oscillates'][0] for r in rows)} of all did before), "
        f"{len(wide)} are promised a band, which agrees within {AGREES:.0%} for "
        f"{sum(o <= AGREES for o in off)} "
        f"(largest difference {max(off, default=0.0):.0%}), and "
        f"{len({r['case'] for r in worse})} track worse than before.",
    ]
    return "\n".join(lines)


PAIRS = ("promised", "worst", "measured", "locked", "moving")


def main() -> None:
    """Record, trace, tune and run the cases; print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--out", type=Path, default=Path("tuned-benchmark"))
    given = parser.parse_args()
    set_up_jax(user_cache(), LOOPS)
    wanted = specs(given.cases)
    missing = [s for s in wanted if not (given.out / s.name / "truth.json").exists()]
    if missing:
        cases.write_cases(missing, given.out)
    rows = []
    for spec in wanted:
        path = given.out / spec.name / "tuned.json"
        if not path.exists():
            with np.errstate(all="ignore"):
                row = tuned(spec, given.out)
            path.write_text(json.dumps(row, indent=1) + "\n")
            print(f"{spec.name}: {'new gains' if row['proposed'] else 'none'}")
        rows.append(json.loads(path.read_text()))
    print(table(rows))


if __name__ == "__main__":
    main()
