"""Reads cases back as their user would, and replays them with the truth.

`python -m benchmarks.blind.joints.check DIR`, the folder of `benchmarks.blind`.

For every log: pressures in bar and forces in N as written, and the RMS of measured -
replayed in units of the noise, the true plant restarted every 0.25 s from the measured
pressures. That start is as noisy as the measurement: 1.0 to 1.4 is perfect for a
pressure, and for F, which is A (P_a2 - P_a1), the ratio of the pressures' noise times A
to its own. Cases that lie are read as they are written, lie and all.
"""

import sys
import tomllib
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from .. import recording
from .make import SCALE, WINDOW, recorded
from .plant import FINE, Control, Plant, simulate
from .rigs import DT, STEP


def read_log(path):
    """Columns of a log in SI by signal name, {name: values}."""
    with open(path) as file:
        header = file.readline().strip().split(",")
    table = np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)
    names = [column.split(" ")[0] for column in header]
    scales = [SCALE[column.split("[")[1].rstrip("]")] for column in header]
    return {
        name: table[:, i] * scale
        for i, (name, scale) in enumerate(zip(names, scales, strict=True))
    }


def main():
    """Replay every case of a folder and print a line a log."""
    out = Path(sys.argv[1])
    for truth in recording.truths(out).values():
        if truth["case"].startswith("m"):
            continue  # a machine
        folder = out / recording.CASES / truth["case"]
        rig = tomllib.loads((folder / "rig.toml").read_text())
        plant = Plant(**truth["plant"])
        control = Control(**truth["control"])
        fields = {k: v for e in truth["effects"] for k, v in e["fields"].items()}
        logger = {k: v for k, v in fields.items() if k.startswith("logger.")}
        print(
            truth["case"],
            truth["kind"],
            rig["layout"],
            [e["name"] for e in truth["effects"]] or truth["lie"] or "-",
        )
        for path in sorted(folder.glob("*.csv")):
            log = read_log(path)
            t = log["time"]
            assert (
                all(np.isfinite(y).all() for y in log.values())
                and (np.diff(t) > 0.0).all()
            )
            rate = 1.0 / np.median(np.diff(t))
            x = (
                plant.radius * log["psi"]
                if "psi" in log
                else log["x"] - truth_x_mid(rig)
            )
            grid = np.arange(int(t[-1] / DT) + 2) * DT
            spline = CubicSpline(t, gaussian_filter1d(x, max(1e-3 * rate, 0.01)))
            knots = np.ascontiguousarray(
                CubicSpline(grid, spline(np.minimum(grid, t[-1]))).c
            )
            P_s = (
                gaussian_filter1d(log["P_s"], 0.02 * rate)
                if "P_s" in log
                else np.full(t.size, truth["P_s"])
            )
            P_1 = log.get("P_a1", np.zeros(t.size))
            hold = np.column_stack([P_1, log["P_a2"]])
            n_sub = FINE * max(int(round(1.0 / rate / STEP / FINE)), 1)
            fine = simulate(
                plant,
                control,
                False,
                1.0 / rate,
                n_sub,
                knots,
                np.interp(grid, t, P_s),
                DT,
                np.zeros(grid.size),
                log["u"].copy(),
                np.zeros((t.size, 3)),
                hold[0],
                hold,
                int(round(WINDOW * rate)),
            )
            clean = recorded(_Rate(int(round(rate))), fine, logger, path.stem)
            ratio = {
                name: round(
                    float(
                        np.sqrt(np.mean((log[name] - clean[:, i]) ** 2))
                        / truth["noise"][name]
                    ),
                    2,
                )
                for i, name in enumerate(("P_a1", "P_a2", "F"))
                if name in log
            }
            spans = {
                name: [
                    round(float(s), 1)
                    for s in np.percentile(log[name] / scale, [0, 5, 95, 100])
                ]
                for name, scale in (
                    ("P_a1", 1e5),
                    ("P_a2", 1e5),
                    ("P_s", 1e5),
                    ("F", 1.0),
                    ("u", 1.0),
                    ("x", 1e-3),
                )
                if name in log
            }
            crossings = int(np.sum(np.diff(np.sign(log["u"])) != 0))
            print(
                "   ",
                path.stem,
                t.size,
                f"{t[-1]:.1f} s",
                spans,
                "crossings of u",
                crossings,
                "replay",
                ratio,
            )


class _Rate:
    """The sampling rate alone, for `recorded`."""

    def __init__(self, rate):
        self.rate = rate


def truth_x_mid(rig):
    """Mid-stroke reading [m] that the rig file states."""
    return float(rig["geometry"].get("x_mid", "0 m").split()[0])


if __name__ == "__main__":
    main()
