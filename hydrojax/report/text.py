"""How names, units and numbers are printed in reports and pictures."""

from __future__ import annotations

import math
import re

import numpy as np

from hydrojax.errors import one_line

_PREFIXES = {
    "Pa": {1e9: "G", 1e6: "M", 1e3: "k", 1.0: ""},
    "N": {1e6: "M", 1e3: "k", 1.0: ""},
    "V": {1.0: "", 1e-3: "m"},
    "m": {1.0: "", 1e-3: "m", 1e-6: "µ"},
    "s": {1.0: "", 1e-3: "m", 1e-6: "µ"},
    "rad": {1.0: "", 1e-3: "m"},
}
_GREEK = ("alpha", "beta", "delta", "eps", "omega", "psi", "sigma", "tau", "zeta")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def raised(exponent: str | int) -> str:
    """An exponent in raised figures."""
    return str(exponent).translate(_RAISED)


def pretty_unit(unit: str) -> str:
    """A unit as it is printed: `m^3/(s*Pa^0.5)` becomes `m³/(s·√Pa)`."""
    if unit in ("1", ""):
        return ""
    unit = re.sub(r"(\w+)\^0\.5", r"√\1", unit)
    unit = re.sub(r"\^(-?\d+)", lambda m: raised(m[1]), unit)
    return unit.replace("*", "·")


def engineering(size: float, unit: str) -> tuple[float, str]:
    """What one printed unit is in SI, and its name, for numbers about `size`.

    Only a unit that leads with a plain Pa, N, V, m, s or rad takes a prefix.
    """
    lead = re.match(r"(Pa|N|V|m|s|rad)(?![\w^])", unit)
    size = abs(size)
    if lead is None or not np.isfinite(size) or size == 0.0:
        return 1.0, pretty_unit(unit)
    # A hair below the next prefix, rounding would print 1000.
    fit = [f for f in _PREFIXES[lead[1]] if f <= size * 1.0005]
    factor = max(fit, default=min(_PREFIXES[lead[1]]))
    return factor, _PREFIXES[lead[1]][factor] + pretty_unit(unit)


def symbol(name: str) -> str:
    """A name as mathematics: `P_a1 + P_a2`, `abs(u)`, `u_rate`, `beta`."""
    name = re.sub(r"abs\((.*)\)", r"|\1|", name)

    def one(m: re.Match[str]) -> str:
        stem, sub = m[1], m[2] or ""
        if stem in _GREEK:
            stem = {"eps": r"\varepsilon"}.get(stem, rf"\{stem}")
        elif len(stem) > 1:
            stem = rf"\mathrm{{{stem}}}"
        if sub == "rate":
            return rf"$\dot{{{stem}}}$"
        return f"${stem}_{{\\mathrm{{{sub}}}}}$" if sub else f"${stem}$"

    return re.sub(r"([A-Za-z]+)(?:_(\w+))?", one, name).replace(" - ", " − ")


def signal_unit(name: str, command: str = "") -> str:
    """SI unit of a signal of a `Series`, by its name; `command` is that of u."""
    stem = re.sub(r"[^A-Za-z_].*", "", name.removeprefix("abs("))
    rate, stem = stem.endswith("_rate"), stem.removesuffix("_rate")
    units = {"x": "m", "z": "m", "v": "m/s", "a": "m/s^2", "psi": "rad", "t": "s"}
    units |= {"F": "N", "F_d": "N", "P": "Pa", "u": command}
    unit = units.get(stem, "Pa" if stem.startswith("P_") else "")
    return f"{unit or 1}/s" if rate else unit


def in_picture(name: str) -> str:
    """A name of a rig, a log or a label as it may stand in a picture.

    Matplotlib would take what stands between two dollar signs for mathematics.
    """
    return one_line(name, 80).replace("$", r"\$")


def words(name: str) -> str:
    """An effect's name as plain words."""
    return name.replace("_", " ")


def p_text(p: float) -> str:
    """A p-value as it is printed; below 1e-6 none is meant to its last power."""
    if not np.isfinite(p):
        return "–"
    if p < 1e-6:
        return "< 10⁻⁶"
    if p >= 0.001:
        return f"{p:.2g}"
    mantissa, exponent = f"{p:.0e}".split("e")
    return f"{mantissa} × 10{raised(int(exponent))}"


def p_equation(p: float) -> str:
    """A p-value behind the letter p: `= 0.02`, or `< 10⁻⁶`."""
    text = p_text(p)
    return text if text.startswith("<") else f"= {text}"


def quantity_text(
    value: float, unit: str, std: float | None = None, figures: int = 4
) -> str:
    """A number as an engineer writes it: `857.6 ± 1.2 MPa`.

    Two figures of the standard deviation say how many of the value are printed;
    without one, `figures` are.
    """
    if value is None or not math.isfinite(value):
        return "–"
    known = std is not None and math.isfinite(std) and std > 0
    spread = std if known and std is not None else 0.0
    size = max(abs(value), spread)
    factor, name = engineering(size, unit)
    power, shown = 0, float(f"{size / factor:.4g}")  # 0.00099999 is 0.001
    if shown and not 1e-3 <= shown < 1e5:
        power = math.floor(math.log10(shown))
        factor *= 10.0**power
    last = _last_figure(
        spread / factor if known else size / factor, 2 if known else figures
    )
    number = _fixed(value / factor, last)
    text = f"{number} ± {_fixed(spread / factor, last)}" if known else _bare(number)
    if power:
        text = f"({text})" if known else text
        text += f" × 10{raised(power)}"
    return f"{text} {name}".rstrip()


def _last_figure(size: float, figures: int) -> int:
    """Decimals at which `figures` figures of `size` are printed; may be negative."""
    if size == 0:
        return 0
    # By way of text, for what rounding carries over a power of ten.
    return figures - 1 - int(f"{size:.{figures - 1}e}".split("e")[1])


def _fixed(value: float, decimals: int) -> str:
    text = f"{round(value, decimals):.{max(decimals, 0)}f}"
    return text.replace("-", "−") if float(text) else text.lstrip("-")


def _bare(number: str) -> str:
    """A decimal without the zeros that say nothing."""
    return number.rstrip("0").rstrip(".") if "." in number else number
