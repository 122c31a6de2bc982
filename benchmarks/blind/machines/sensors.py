"""From the plant's record to the channels of a log: lag, filter, skew, bias, noise and
resolution.
"""

import numpy as np
from scipy.signal import bilinear, lfilter, lfilter_zi

DEFAULT = {
    "bias_1": 0.0,
    "bias_2": 0.0,
    "tau_P": 0.0,
    "filter_omega": np.inf,
    "filter_zeta": 0.8,
    "filter_channels": (),
    "skew_channel": "",
    "skew_tau": 0.0,
}


def low_pass(y, rate, numerator, denominator):
    """Pass y (rate in Hz) through an analogue filter, started at rest in y[0]."""
    b, a = bilinear(numerator, denominator, rate)
    return lfilter(b, a, y, zi=lfilter_zi(b, a) * y[0])[0]


def channels(record, record_rate, every, sensor):
    """Noise-free logged channels (x, P_a1, P_a2, P_s, F) at each `every`-th row of a
    record (record_rate in Hz).
    """
    sensor = {**DEFAULT, **sensor}
    raw = {
        "x": record[:, 3],
        "P_a1": record[:, 0],
        "P_a2": record[:, 1],
        "P_s": record[:, 2],
        "F": record[:, 6],
    }
    t = np.arange(len(record)) / record_rate
    logged = {}
    for name, y in raw.items():
        if name in ("P_a1", "P_a2") and sensor["tau_P"] > 0:
            y = low_pass(y, record_rate, [1.0], [sensor["tau_P"], 1.0])
        if name in sensor["filter_channels"]:
            w = sensor["filter_omega"]
            y = low_pass(
                y, record_rate, [w * w], [1.0, 2 * sensor["filter_zeta"] * w, w * w]
            )
        if name == sensor["skew_channel"]:
            y = np.interp(t + sensor["skew_tau"], t, y)
        y = y[::every]
        logged[name] = y + {"P_a1": sensor["bias_1"], "P_a2": sensor["bias_2"]}.get(
            name, 0.0
        )
    return logged


def measured(logged, noise, resolution, rng):
    """Add white noise (standard deviation per channel) and round to each channel's
    resolution.
    """
    values = {}
    for name, y in logged.items():
        y = y + noise[name] * rng.standard_normal(y.size)
        values[name] = np.round(y / resolution[name]) * resolution[name]
    return values
