"""The paper's experiments on the reference rig: Figs. 2 to 5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy import signal

from hydrojax.control import theory
from hydrojax.control.loop import Loop, Scenario, run
from hydrojax.control.simulation import Trajectory, hold, make_scenario, simulate_loop
from hydrojax.control.waveforms import band_noise, sinusoidal_path
from hydrojax.paper.records import (
    Descent,
    Response,
    Track,
    reference,
)
from hydrojax.rigfile.build import build_loop
from hydrojax.rigfile.schema import RigFile

SECONDS, STEADY = 20.0, 4.0
"""Length of the runs of Figs. 2 to 4, and where their steady part begins, s."""

FORCE, FORCE_HZ = 300.0, 0.5
"""The desired force of Figs. 2 to 4: amplitude, N, and frequency, Hz."""

SPEED, PERIOD = 0.03, 3.0
"""The motion meanwhile: peak speed (the paper's 3 cm/s), m/s, and period, s."""

NOISE_RMS, NOISE_BAND, SINE = 200.0, 50.0, 100.0
"""The excitation of Fig. 5: noise, N RMS up to Hz, and each sine's amplitude, N."""

NOISE_SHOWN = 0.8 * NOISE_BAND
"""Up to where the response to noise is shown, Hz."""

HERTZ = (
    *(1, 2, 3, 4, 5, 6, 8, 10, 12, 14, 16, 18, 20, 22, 24, 26, 28, 30, 35, 40),
    *(50, 65, 80, 100, 130, 160, 200),
)
"""Where single sines are tried in Fig. 5."""

Gains = Mapping[str, object]

FIXED: Gains = {"c_1": 0, "c_2": 0}
NONE: Gains = {"k_cp": 0, "k_cn": 0}
FIGURES: Mapping[str, Mapping[str, Gains]] = {
    "fig2": {
        "a": {"rho_a": 700},
        "b": {"rho_a": 7},
        "c": {"rho_a": 0, "A_a": 10},
        "d": {"A_a": 0},
    },
    "fig3": {"a": {}, "b": {"c_1": 1, "c_2": 1}, "c": FIXED, "d": NONE},
    "fig4": {
        "a": {"k_0": 0},
        "b": {"k_0": 0, "c_1": 1, "c_2": 1},
        "c": {"k_0": 0, **FIXED},
        "d": {"k_0": 0, **NONE},
    },
}
"""The cases: what each changes in [controller]."""

ABLATION: Gains = {
    "k_p": 0, "k_f": 3.6, "k_1": 0, "rho_a": 0, "A_a": 10,
    "k_cp": 0, "k_cn": 0, "k_0": 0, "k_vp": 0, "k_vn": 0, "k_fp": 0, "k_fn": 0,
}  # fmt: skip
"""Velocity feedforward and force error alone, at the same sum of gains: what is left of
the law without its friction model."""


BOUNDS: Mapping[str, Gains] = {
    "0.3 to 1.1, as shipped": {},
    "0.5 to 0.9": {"k_fp": [0.5, 0.9], "k_fn": [0.5, 0.9]},
    "held at the rig's own": {"k_fp": 0.7, "k_fn": 0.65, "c_6": 0, "c_7": 0},
    "0 to 1.5": {"k_fp": [0, 1.5], "k_fn": [0, 1.5]},
}
"""Bounds of k_fp and k_fn, which the paper does not print: Fig. 5 hangs on them."""


def stack(trees: list[Any]) -> Any:
    """Loops or scenarios side by side, on a first axis."""
    return jax.tree.map(lambda *a: jnp.stack(a), *trees)


@eqx.filter_jit
def runs(
    loops: Loop, scenarios: Any, keep: tuple[str, ...]
) -> Float[Array, "lanes n kept"]:
    """Signals of runs side by side: loops and scenarios have a first axis of lanes."""
    return jax.vmap(lambda loop, scenario: run(loop, scenario, keep))(loops, scenarios)


def _repeat(tree: Any, count: int) -> Any:
    return jax.tree.map(lambda a: jnp.repeat(a[None], count, axis=0), tree)


def scenario_of(
    spec: RigFile,
    F_d: Float[np.ndarray, "n"],
    path: Trajectory,
    h: float,
    seed: int | None = None,
) -> Scenario:
    """A scenario under the rig file's supply."""
    P_s, P_r = spec.supply["P_s"], spec.supply["P_r"]
    return make_scenario(F_d, path, h, P_s, P_r, seed=seed)


def tracking() -> tuple[dict[str, dict[str, Track]], Track]:
    """Figs. 2 to 4, and the ablation beside Fig. 3 (a)."""
    spec, rig = reference()
    h = 1e-3
    t = np.arange(round(SECONDS / h)) * h
    F_d = FORCE * np.sin(2 * np.pi * FORCE_HZ * t)
    scenario = scenario_of(spec, F_d, sinusoidal_path(SPEED, PERIOD), h, seed=0)
    cases = [(f, c, g) for f, own in FIGURES.items() for c, g in own.items()]
    cases.append(("ablation", "", ABLATION))
    loops = stack([build_loop(spec, rig, gains) for *_, gains in cases])
    out = np.asarray(runs(loops, _repeat(scenario, len(cases)), ("true_F", "P_d", "P")))
    tracks: dict[str, dict[str, Track]] = {}
    for (figure, case, _), table in zip(cases, out, strict=True):
        F, P_d, P = table.T
        desired, actual = (P_d, P) if figure == "fig2" else (F_d, F)
        off = (desired - actual)[t >= STEADY]
        track = Track(t, desired, actual, float(np.sqrt(np.mean(off**2))))
        tracks.setdefault(figure, {})[case] = track
    return tracks, tracks.pop("ablation")[""]


def response(seconds: float = 60.0) -> Response:
    """Fig. 5: the joint locked, white noise, and sines one by one.

    As in the paper each sine is added to the noise, so that the adapted parameters are
    those of the noise; sines alone leave them elsewhere.
    """
    spec, rig = reference()
    bounded = [build_loop(spec, rig, gains) for gains in BOUNDS.values()]
    loop = bounded[0]
    h = float(loop.h)
    rng = np.random.default_rng(5)

    def scenario(F_d: np.ndarray, seed: int) -> Scenario:
        return scenario_of(spec, F_d, hold(), h, seed)

    n = round(seconds / h)
    settled = slice(round(STEADY / h), None)
    F_d = band_noise(rng, n, h, NOISE_RMS, NOISE_BAND)
    same = _repeat(scenario(F_d, 50), len(bounded))
    F = np.asarray(runs(stack(bounded), same, ("F",)))[..., 0]
    welch: dict[str, Any] = {"fs": 1 / h, "nperseg": round(1 / h)}
    asked, came = F_d[settled], F[0, settled]
    hertz, cross = signal.csd(asked, F[:, settled], **welch)
    gains = np.abs(cross / signal.welch(asked, **welch)[1])
    coherence = signal.coherence(asked, came, **welch)[1]
    keep = (hertz >= HERTZ[0]) & (hertz <= NOISE_SHOWN)
    dBs = 20 * np.log10(gains[:, keep])

    n = round((STEADY + 12.0) / h)
    t = np.arange(n) * h
    scenarios, wanted = [], []
    for below in (NOISE_RMS, 0.0):
        for i, f in enumerate(HERTZ):
            size = SINE if below else np.sqrt(2) * NOISE_RMS
            noise = band_noise(rng, n, h, below, NOISE_BAND) if below else 0.0
            wanted.append(noise + size * np.sin(2 * np.pi * f * t))
            scenarios.append(scenario(wanted[-1], 100 + i))
    loops = _repeat(loop, len(scenarios))
    F = np.asarray(runs(loops, stack(scenarios), ("F",)))[..., 0]
    dB = [
        _gain_dB(x[settled], y[settled], f, t[settled])
        for x, y, f in zip(wanted, F, 2 * HERTZ, strict=True)
    ]
    count = len(HERTZ)
    return Response(
        hertz=np.array(HERTZ, float),
        sines_dB=np.array(dB[:count]),
        alone_dB=np.array(dB[count:]),
        noise_hertz=hertz[keep],
        noise_dB=dBs[0],
        coherence=coherence[keep],
        by_bounds={
            name: within(hertz[keep], dB) for name, dB in zip(BOUNDS, dBs, strict=True)
        },
    )


def _gain_dB(asked: np.ndarray, came: np.ndarray, f: float, t: np.ndarray) -> float:
    """Gain from `asked` to `came` at one frequency, Hz, under a Hann window."""
    line = np.exp(-2j * np.pi * f * t)
    line *= signal.get_window("hann", t.size, fftbins=False)
    return float(20 * np.log10(abs(came @ line / (asked @ line))))


def within(
    hertz: Float[np.ndarray, "n"], dB: Float[np.ndarray, "n"], most: float = 1.0
) -> float:
    """The frequency up to which |dB| stays within `most`, Hz, between points by line.

    0 if the first point is outside, the last frequency if none is.
    """
    out = np.flatnonzero(np.abs(dB) > most)
    if not out.size:
        return float(hertz[-1])
    i = int(out[0])
    if i == 0:
        return 0.0
    a, b, most = dB[i - 1], dB[i], np.copysign(most, dB[i])
    return float(hertz[i - 1] + (most - a) / (b - a) * (hertz[i] - hertz[i - 1]))


def descent(
    rates: tuple[float, ...] = (1000.0, 2000.0, 4000.0),
) -> dict[float, Descent]:
    """W along a run at a matched plant without noise, by sampling rate in Hz.

    Matched: no spool, no computing delay, no encoder step, bounds that hold the truth.
    """
    spec, _ = reference()
    spec = replace(spec, effects={}, sensors={})
    out = {}
    for rate in rates:
        loop = build_loop(spec, None, {"rate": rate, "resolution": 0})
        h = float(loop.h)
        t = np.arange(round(6.0 / h)) * h
        F_d = FORCE * np.sin(2 * np.pi * FORCE_HZ * t)
        scenario = scenario_of(spec, F_d, sinusoidal_path(SPEED, PERIOD), h)
        done = simulate_loop(loop, scenario)
        W, bound = theory.lyapunov(loop, done), theory.lyapunov_bound(loop, done)
        out[rate] = Descent(t, W, bound, theory.tracking_part(loop, done))
    return out


def supply_of_tracking() -> theory.Supply:
    """The supply condition (42) on the run of Fig. 3 (a)."""
    spec, rig = reference()
    loop = build_loop(spec, rig)
    h = float(loop.h)
    t = np.arange(round(8.0 / h)) * h
    F_d = FORCE * np.sin(2 * np.pi * FORCE_HZ * t)
    scenario = scenario_of(spec, F_d, sinusoidal_path(SPEED, PERIOD), h, seed=0)
    return theory.supply(loop, scenario, simulate_loop(loop, scenario))
