# ruff: noqa: E501  (lines of the page)
"""The page of the parameters: the model in equations, and each parameter."""

from __future__ import annotations

from benchmarks.reference.markdown import doc, rows, table
from hydrojax.parameters import specs
from hydrojax.plant.chambers import Chambers
from hydrojax.plant.friction import Friction
from hydrojax.plant.valve import MeteringEdges

MODEL = """\
## The model in equations

Numbers in parentheses are the paper's. Signs: a positive `u` fills chamber 1, a positive `P`
pushes toward positive `v`, and chamber 1 shrinks as `x` grows. Pressures are gauge.

```text
flows          q_1 =  c_p1 u √(P_s − P_a1)   u > 0,    c_n1 u √(P_a1 − P_r)   u < 0   (12)
               q_2 = −c_n2 u √(P_a2 − P_r)   u > 0,   −c_p2 u √(P_s − P_a2)   u < 0   (13)
lengths        x_1 = l/2 + delta_1 − x,      x_2 = l/2 + delta_2 + x              (10)(11)
pressures      dP_a1/dt = beta/x_1 (q_1/A_1 + v)                                      (14)
               dP_a2/dt = beta/x_2 (q_2/A_2 − v)                                      (15)
drive force    P = A_2 P_a2 − A_1 P_a1                                                (16)

bristle        dz/dt = v − |v| z / z_ss                                                (4)
sliding        f_c = g k_c + k_0 − k_v v,    g = z / z_ss, within −1 and 1             (3)
                   k_c = k_cp  z > 0,  k_cn  z < 0;     k_v = k_vp  v > 0,  k_vn  v < 0
presliding     f_s = k_f F / (1 + delta |F|),    k_f = k_fp  F > 0,  k_fn  F < 0    (5)(6)
switch         L = 1 / (1 + (L_slope w)³),       dw/dt = L_rate (|v| − w)
friction       f_f = (1 − L) f_c + L f_s                                               (7)
output force   F = P − f_f                                                            (22)
```

`F` stands on both sides of (22): a quadratic of which one root has the sign of
`P − (1 − L) f_c`. A root of a negative drop is taken with its sign, so that flow may go back.
Below −101 kPa a chamber is not full: the volume that it lacks is filled first. Layouts:
`differential` has two areas, `pull-pull` one, `single` has `q_1 = 0` and `P_a1 = 0`, and
`driven-axis` takes `P` from the log and has friction alone.

Over one period of the controller the valve's command is held; the equations are stepped
within it, the bristle and `w` exactly. Effects add to flows, compliance, friction and force,
or change the command and the readings: [each with its law](effects.md).
"""
"""The model in equations, by the names of the parameters."""

USUAL = {
    "c_p1": ("(12)", "1e-9 to 1e-7"), "c_n1": ("(12)", "1e-9 to 1e-7"),
    "c_p2": ("(13)", "1e-9 to 1e-7"), "c_n2": ("(13)", "1e-9 to 1e-7"),
    "beta": ("(14)(15)", "3e8 to 1.7e9"),
    "delta_1": ("(10)", "0 to 0.06"), "delta_2": ("(11)", "0 to 0.06"),
    "k_cp": ("(3)", "2 to 10 % of the largest P"),
    "k_cn": ("(3)", "2 to 10 % of the largest P"),
    "k_0": ("(3)", "within a fifth of k_cp"),
    "k_vp": ("(3)", "-5e3 to 5e3"), "k_vn": ("(3)", "-5e3 to 5e3"),
    "k_fp": ("(5)", "0 to 1.5"), "k_fn": ("(5)", "0 to 1.5"),
    "z_ss": ("(4)", "1e-5 to 5e-4"), "delta": ("(6)", "about 1 / k_cp"),
    "L_slope": ("switch", "100 to 3e4"), "L_rate": ("switch", "5 to 50"),
}  # fmt: skip
"""Of each parameter of the base model: its equation, and its usual range, SI."""


def parameters_page() -> str:
    """Every parameter of the base model, and the model in equations."""
    parts = ["# Parameters\n", MODEL]
    groups = {"Valve": MeteringEdges, "Chambers": Chambers, "Friction": Friction}
    heads = ("symbol", "unit", "usual range", "limits", "in", "meaning")
    for title, kind in groups.items():
        parts += [f"## {title}\n", doc(kind).split("\n\n")[0] + "\n"]
        lines = (
            (row[0], row[1], USUAL[name][1], row[2], USUAL[name][0], row[4])
            for name, row in zip(specs(kind), rows(specs(kind)), strict=True)
        )
        parts.append(table(heads, lines))
    parts.append(
        "SI. `limits` are what rigs usually have: a thousand times beyond them, or below "
        "0 where they are not, is refused. `V` in a unit is the unit of the command: "
        "leave it out where `u` is a fraction of full opening; a valve constant is then "
        "about ten times as large. `hydrojax init` drafts a start and a range for each from "
        "your log.\n"
    )
    return "\n".join(parts)
