"""All of the paper's experiments at once, as numbers beside the paper's words."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hydrojax.control import theory
from hydrojax.paper.experiments import (
    descent,
    response,
    supply_of_tracking,
    tracking,
    within,
)
from hydrojax.paper.readings import try_readings
from hydrojax.paper.records import Experiments

PAPER_SAYS: Mapping[str, str] = {
    "fig2": "(a) and (b) do not differ significantly, (b) is better than (c), and (d) "
    "does not track at all",
    "fig3": "the more is adapted, the better: (a), (b), (c), and far behind (d)",
    "fig4": "the same order, and worse than Fig. 3",
    "fig5": "20 Hz within 1 dB, by white noise and by sines added to it",
}
"""What the paper says of each figure, in our words; it prints no numbers but 20 Hz."""


def experiments(progress: Callable[[str], None] = lambda _: None) -> Experiments:
    """All of the paper's experiments; `progress` is called at each stage."""
    progress("Figs. 2 to 4: tracking")
    tracks, ablation = tracking()
    progress("Fig. 5: white noise and sines")
    shown = response()
    progress("Lyapunov function (31)")
    falls = descent()
    progress("supply condition (42)")
    supply = supply_of_tracking()
    progress("other readings of the paper")
    return Experiments(tracks, ablation, shown, falls, supply, try_readings())


def _listed(values: np.ndarray) -> list[float | None]:
    """Numbers for JSON: None where there is none."""
    return [float(v) if np.isfinite(v) else None for v in values]


def paper_json(found: Experiments) -> dict[str, Any]:
    """The content of paper.json: N, Hz, dB, Pa."""
    r = found.response
    rms = {
        figure: {case: track.rms for case, track in cases.items()}
        for figure, cases in found.tracks.items()
    }
    slow = found.descent[min(found.descent)]
    rises = {rate: theory.largest_rise(d.W) for rate, d in found.descent.items()}
    return {
        **rms,
        "fig5": {
            "within_1dB_to_Hz_noise": within(r.noise_hertz, r.noise_dB),
            "within_1dB_to_Hz_sines": within(r.hertz, r.sines_dB),
            "within_1dB_to_Hz_sines_alone": within(r.hertz, r.alone_dB),
            "frequency_Hz": r.hertz.tolist(),
            "gain_dB_noise": _listed(r.at(r.noise_dB)),
            "gain_dB_sines": r.sines_dB.tolist(),
            "gain_dB_sines_alone": r.alone_dB.tolist(),
            "coherence": _listed(r.at(r.coherence)),
            "within_1dB_to_Hz_noise_by_bounds_of_k_f": r.by_bounds,
        },
        "lyapunov": {
            "largest_rise": rises[min(rises)],
            "rate_Hz": list(rises),
            "largest_rise_at_rate": list(rises.values()),
            "largest_fall_of_tracking_part": theory.largest_fall(slow.tracking)
            / slow.W[0],
        },
        "supply": {
            "least_P_s_Pa": found.supply.minimum,
            "condition_42_Pa": found.supply.condition,
        },
        "readings": {name: e._asdict() for name, e in found.readings.items()},
        "ablation": {"full_law_rms_N": rms["fig3"]["a"], "rms_N": found.ablation.rms},
    }


def lines(content: Mapping[str, Any]) -> list[str]:
    """What paper.json says beside the tables, as text."""
    fig5, supply = content["fig5"], content["supply"]
    fall, ablation = content["lyapunov"], content["ablation"]
    tracking = fall["largest_fall_of_tracking_part"]
    by_bounds = fig5["within_1dB_to_Hz_noise_by_bounds_of_k_f"]
    return [
        f"fig5: within 1 dB to {fig5['within_1dB_to_Hz_noise']:.1f} Hz by noise, "
        f"{fig5['within_1dB_to_Hz_sines']:.1f} Hz by sines; the paper: "
        f"{PAPER_SAYS['fig5']}. It prints no bounds of k_f, on which this depends:",
        *(f"  bounds {name}: {edge(hertz)} by noise" for name, hertz in
          by_bounds.items()),
        f"W (31) rises by at most {fall['largest_rise']:.2g} of its start, while the "
        f"part that tracking makes falls by {tracking:.2g}",
        f"minimum supply {supply['least_P_s_Pa'] / 1e6:.2f} MPa; (42) requires "
        f"{supply['condition_42_Pa'] / 1e6:.1f} MPa",
        f"without friction model {ablation['rms_N']:.3g} N, full law "
        f"{ablation['full_law_rms_N']:.3g} N",
    ]  # fmt: skip


def edge(hertz: float) -> str:
    """Up to where a response stays within 1 dB, in words."""
    return f"to {hertz:.1f} Hz" if hertz else "nowhere"
