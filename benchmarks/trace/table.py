"""From rows of results to Markdown: counts with denominators, and their intervals."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from statistics import median

from .measures import (
    POWERFUL,
    Row,
    covered,
    exact,
    matters,
    named,
    power,
    said,
    share,
    size_error,
    top_1,
    truth,
    wilson,
    within_alias,
    worst,
)


def report(rows: Sequence[Row], refits: Sequence[Row] = ()) -> str:
    """Everything as Markdown."""
    good = [r for r in rows if r.get("ok")]
    failed = [r for r in rows if not r.get("ok")]
    lines = [_headline(good, failed), "", _main(good), "", _by_effect(good)]
    if any("baselines" in r for r in good):
        lines += ["", _others(good, refits)]
    if failed:
        lines += ["", "| failed case | reason |", "|---|---|"]
        lines += [f"| {r['case']} | {r['reason']} |" for r in failed]
    return "\n".join(lines) + "\n"


def _of(rows: Sequence[Row], *kinds: str) -> list[Row]:
    return [r for r in rows if r["kind"] in kinds]


def _sized(rows: Sequence[Row], size: float) -> list[Row]:
    return [r for r in _of(rows, "effect") if set(r["sizes"].values()) == {size}]


def _headline(good: Sequence[Row], failed: Sequence[Row]) -> str:
    counts = Counter(r["kind"] for r in good)
    kinds = ", ".join(f"{n} {kind}" for kind, n in counts.items())
    return (
        f"{len(good)} cases ({kinds}); {len(failed)} failed. In brackets: Wilson's "
        "95 % interval."
    )


def _median(values: Iterable[float | None], form: str = "{:.3g}") -> str:
    given = [v for v in values if v is not None and math.isfinite(v)]
    return f"{form.format(median(given))} ({len(given)})" if given else "- (0)"


def _main(good: Sequence[Row]) -> str:
    whole, effects = _of(good, "nothing", "parameters"), _of(good, "effect")
    sizes = sorted({s for r in effects for s in r["sizes"].values()})
    strong = [r for r in effects if power(r) >= POWERFUL]
    out = [("something said though nothing is missing", share(whole, said))]
    for noise in sorted({r["noise"] for r in _of(good, "noise")}):
        rows = [r for r in _of(good, "noise") if r["noise"] == noise]
        out.append((f"the same, {noise} noise", share(rows, said)))
    whole_shift = [r for r in _of(good, "shift") if not r["sizes"]]
    out.append(("the same, other load and supply", share(whole_shift, said)))
    for s in sizes:
        out.append((f"effect of size {s:g} seen", share(_sized(good, s), said)))
    large = [r for r in effects if matters(r)]
    out.append(("effect seen where it matters (2 % of noise)", share(large, said)))
    for s in sizes:
        out.append((f"top-1, size {s:g}", share(_sized(good, s), top_1)))
    out += [
        ("top-1, all sizes", share(effects, top_1)),
        ("top-1 where it matters", share(large, top_1)),
        (f"top-1 where reported power >= {POWERFUL}", share(strong, top_1)),
        ("named or among `cannot_tell_from`", share(effects, within_alias)),
        ("the same where power is", share(strong, within_alias)),
        ("named exactly", share(effects, exact)),
        ("effect found under a shift", share(_shifted(good), within_alias)),
        ("largest of the literature: named first", share(_of(good, "large"), top_1)),
        ("the same: `explained`", share(_of(good, "large"), _explained)),
        ("pair: both named, nothing else", share(_of(good, "pair"), exact)),
        ("pair: at least one of both named", share(_of(good, "pair"), _one_of)),
        *_sets(good),
        ("outside the vocabulary: `unknown`", share(_of(good, "outside"), _unknown)),
        ("outside: and no effect named", share(_of(good, "outside"), _unnamed)),
        ("outside: seen at all", share(_of(good, "outside"), said)),
        ("size of the effect, median error", _median(map(size_error, effects))),
    ]
    for kind, title in (
        ("differential", "rod on one side"),
        ("coarse", "encoder of 17 bits"),
        ("later", "effects beside the mix"),
    ):
        hidden = [r for r in _of(good, kind) if r["sizes"]]
        felt = [r for r in hidden if matters(r)]
        plain = [r for r in _of(good, kind) if not r["sizes"]]
        out += [
            (f"{title}: something said though nothing is missing", share(plain, said)),
            (f"{title}: effect seen where it matters", share(felt, said)),
            (f"{title}: and named first", share(felt, top_1)),
            (f"{title}: or among its likes", share(felt, within_alias)),
            (f"{title}: named exactly", share(felt, exact)),
        ]
    out += _errors(good) + _coverage(good) + _times(good)
    lines = ["| | trace |", "|---|---|"]
    return "\n".join(lines + [f"| {name} | {value} |" for name, value in out])


def _sets(good: Sequence[Row]) -> list[tuple[str, str]]:
    """Of several effects at once, the sets that were named and their effects."""
    every = _of(good, "several")
    out = []
    for n in sorted({len(r["sizes"]) for r in every}):
        rows = [r for r in every if len(r["sizes"]) == n]
        out.append((f"{n} effects: all named, nothing else", share(rows, exact)))
        out.append((f"{n} effects: `explained`", share(rows, _explained)))
    each = [(r, n) for r in every for n in r["sizes"]]
    wrong = [(r, n) for r in every for n in named(r)]
    out.append(("several: of their effects named", share(each, _is_named)))
    out.append(("several: names that are false", share(wrong, _is_false)))
    return out if every else []


def _is_named(pair: tuple[Row, str]) -> bool:
    return pair[1] in named(pair[0])


def _is_false(pair: tuple[Row, str]) -> bool:
    return pair[1] not in pair[0]["sizes"]


def _shifted(rows: Sequence[Row]) -> list[Row]:
    return [r for r in _of(rows, "shift") if r["sizes"]]


def _one_of(row: Row) -> bool:
    return bool(set(named(row)) & set(row["sizes"]))


def _unknown(row: Row) -> bool:
    return row["verdict"] == "unknown"


def _explained(row: Row) -> bool:
    return row["verdict"] == "explained"


def _unnamed(row: Row) -> bool:
    return _unknown(row) and not row["named"]


def _errors(good: Sequence[Row]) -> list[tuple[str, str]]:
    out = []
    for title, rows in (
        ("effect", _of(good, "effect")),
        ("pair", _of(good, "pair")),
        ("outside", _of(good, "outside")),
        ("nothing", _of(good, "nothing", "parameters")),
    ):
        for key in ("before", "after"):
            value = _median(worst(r, key) for r in rows)
            out.append((f"worst channel / noise, median, {title}: {key}", value))
        true = [worst(r, r["oracle"]) for r in rows if r.get("oracle")]
        if true:
            value = _median(true)
            out.append((f"worst channel / noise, median, {title}: truth", value))
    return out


def _coverage(good: Sequence[Row]) -> list[tuple[str, str]]:
    right = [r for r in good if exact(r) and r["kind"] not in ("outside", "noise")]
    hits, given, total = covered(right)
    if not total:
        return []
    low, high = wilson(hits, given)
    value = f"{hits}/{given} = {hits / max(given, 1):.0%} [{low:.0%}, {high:.0%}]"
    title = "95 % intervals that hold the truth, where the structure was found"
    return [(title, f"{value}; {total - given} of {total} without one")]


def _times(good: Sequence[Row]) -> list[tuple[str, str]]:
    seconds = [r["seconds"] for r in good]
    return [
        ("seconds to trace, median", _median(s.get("run") for s in seconds)),
        (
            "seconds to compile, largest",
            f"{max([s.get('compile', 0) for s in seconds], default=0):.3g}",
        ),
    ]


def _by_effect(good: Sequence[Row]) -> str:
    """What every hidden effect was taken for, size by size."""
    lines = [
        "| truth | size | cases | power | before | after | named |",
        "|---|---|---|---|---|---|---|",
    ]
    groups: dict[tuple, list[Row]] = {}
    for r in good:
        sizes = ", ".join(f"{s:g}" for s in sorted(set(r["sizes"].values()))) or "-"
        what = " + ".join(r["sizes"]) or f"({r['kind']}, {r['noise']})"
        if r["kind"] == "shift":
            what = f"{' + '.join(r['sizes']) or 'nothing'} (shift)"
        groups.setdefault((r["kind"], what, sizes), []).append(r)
    order = sorted(groups, key=lambda g: (g[0], g[1], g[2]))
    for key in order:
        rows = groups[key]
        counts = Counter(
            (" + ".join(named(r)) or "-")
            + (f" ({r['verdict']})" if r["verdict"] == "unknown" else "")
            for r in rows
        )
        shown = "; ".join(
            f"{n} x {what}" if n > 1 else what for what, n in counts.items()
        )
        mean = median(power(r) for r in rows)
        lines.append(
            f"| {key[1]} | {key[2]} | {len(rows)} | {mean:.2f} "
            f"| {median(worst(r, 'before') for r in rows):.2f} "
            f"| {median(worst(r, 'after') for r in rows):.2f} | {shown} |"
        )
    return "\n".join(lines)


# -- the baselines --


def _others(good: Sequence[Row], refits: Sequence[Row]) -> str:
    known = {r["case"] for r in refits}
    ways = {
        "trace": [_as_other(r) for r in good],
        "raw correlation": _baseline(good, "correlation"),
        "whiteness, 99 % band": _baseline(good, "whiteness"),
        "sparse regression": _baseline(good, "sparse"),
        "trace, on the cases below": [_as_other(r) for r in good if r["case"] in known],
        "refit each, BIC": list(refits),
    }
    lines = [
        "| method | false alarms | effect seen | top-1 | seconds a case |",
        "|---|---|---|---|---|",
    ]
    for title, rows in ways.items():
        if not rows:
            continue
        whole, effects = _of(rows, "nothing", "parameters"), _of(rows, "effect")
        right = share(effects, lambda r: r["named"] == [truth(r)])
        lines.append(
            f"| {title} | {share(whole, lambda r: r['flag'])} "
            f"| {share(effects, lambda r: r['flag'])} | {right} "
            f"| {_median(r['seconds'] for r in rows)} |"
        )
    return "\n".join(lines)


def _as_other(row: Row) -> Row:
    """A trace's row in the shape of a baseline's."""
    seconds = float(row["seconds"].get("run", 0.0))
    return {**row, "flag": said(row), "named": named(row)[:1], "seconds": seconds}


def _baseline(good: Sequence[Row], key: str) -> list[Row]:
    """Rows as one of the cheap baselines has them."""
    rows = [r for r in good if "baselines" in r]
    return [{**r, "seconds": None, **r["baselines"][key]} for r in rows]
