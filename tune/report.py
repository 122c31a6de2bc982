"""A tuning on disk: tune.json, the rig file, pictures, and one self-contained page."""

from __future__ import annotations

import json
from pathlib import Path

from matplotlib.figure import Figure

from hydrojax.report import page
from hydrojax.report.files import digest, write_all
from hydrojax.tune.display import (
    bode_figure,
    ends,
    front_figure,
    limit,
    limits_figure,
    metrics_table,
    sentence,
    show,
)
from hydrojax.tune.tuning import Tuning


def tuning_pictures(t: Tuning) -> dict[str, tuple[Figure, str, str]]:
    """Figures with their alternative text and caption, by the name of their file."""
    out = {
        "tune_bode": (
            bode_figure(t), f"Bode plot before and after. {sentence(t)}",
            "Output force over desired force. Lines: the rig itself; shades: the "
            "ensemble's stable plants; dashed: where it leaves 1 dB.",
        )
    }  # fmt: skip
    if t.optimum.seen.size:
        out["tune_front"] = (
            front_figure(t), "Band against tracking, peak and noise.",
            "All stable gains that the descents looked at; above the line a limit is "
            "kept.",
        )  # fmt: skip
    if t.relaxed:
        out["tune_limits"] = (
            limits_figure(t), f"Bandwidth with each limit taken away. {limit(t)}",
            "The loop tuned again without one of its limits at a time.",
        )  # fmt: skip
    return out


def write(t: Tuning, out: Path) -> None:
    """Write tune.json, rig.toml, the pictures and report.html into a folder."""
    shown = []
    for name, (figure, alt, caption) in tuning_pictures(t).items():
        shown.append(page.Picture(name, page.as_png(figure, 110), alt, caption))
    files = {f"{p.name}.png": p.png for p in shown}
    files["rig.toml"] = t.rig.text.encode()
    record = t.json() | {"rig_toml_sha256": digest(files["rig.toml"])}
    text = json.dumps(record, indent=1, allow_nan=False)
    files["tune.json"] = (text + "\n").encode()
    said = page.page(
        Path(__file__).parent / "report.html",
        (show,),
        t=t,
        rows=metrics_table(t),
        pictures=shown,
        sentence=sentence(t),
        limit=limit(t),
        ends=ends(t),
    )
    files["report.html"] = said.encode()
    write_all(out, files)
