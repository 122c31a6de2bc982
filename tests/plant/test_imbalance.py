"""What a tick's flow balance lacks, against integrals of signals in closed form."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

from hydrojax.effects import EFFECTS, FlowEffect
from hydrojax.plant.imbalance import imbalance
from hydrojax.plant.replay import openings
from hydrojax.plant.rig import add
from tests.conftest import CUT, GEOMETRY, REFERENCE, Wave

P_1 = Wave(6e6, np.array([4e5, 2e5]), np.array([60.0, 140.0]), np.array([0.3, 1.0]))
P_2 = Wave(7e6, np.array([3e5, 2e5]), np.array([75.0, 110.0]), np.array([2.0, 0.1]))
LEAK = 4e-12


def windows(drive):
    """The drive and its windows under pressures in closed form, the valve shut."""
    w = drive.windows
    motion = drive.motion._replace(u=jnp.zeros_like(drive.motion.u))
    return motion, w._replace(
        P_a1=jnp.asarray(P_1(w.t)), P_a2=jnp.asarray(P_2(w.t)), u=jnp.zeros_like(w.u)
    )


class Wearing(FlowEffect):
    """A leak across the piston that grows from none by LEAK a second."""

    name = "wearing"
    residual_axis = "t"

    def flow(self, at):
        cross = LEAK * at.t * (at.P_a1 - at.P_a2)
        return -cross, cross


@pytest.mark.parametrize(
    ("effect", "leak"),
    [
        (EFFECTS["internal_leakage"](c_il=0.0), lambda t: 0.0),
        (EFFECTS["internal_leakage"](c_il=LEAK), lambda t: LEAK),
        (Wearing(), lambda t: LEAK * t),
    ],
    ids=["none", "leaks", "wears"],
)
def test_it_is_the_displacement_at_which_the_balance_would_hold(
    rig, drive, effect, leak
):
    made = drive(substeps=2, jitter=0.2)
    motion, w = windows(made)
    own = add(rig, [effect])
    got = np.array(imbalance(own, motion, w))
    half = GEOMETRY["chamber_length"] / 2
    t, area = np.asarray(w.t), GEOMETRY["area"]
    for i, (s, _) in enumerate(CUT):
        x = made.waves[s]["x"]

        def lacks(t, chamber, x=x):
            sign = 1 if chamber == 0 else -1
            P, offset = (P_1, "delta_1") if chamber == 0 else (P_2, "delta_2")
            length = half + REFERENCE[offset] - sign * x(t)
            stored = length * P(t, 1) / REFERENCE["beta"]
            lost = leak(t) * (P_1(t) - P_2(t)) / area
            return sign * stored - x(t, 1) + lost

        for k in (3, 17, 41):
            for chamber in (0, 1):
                want = quad(lacks, t[i, k], t[i, k + 1], (chamber,))[0]
                # The midpoint rule's own error at these frequencies.
                assert got[chamber, i, k] == pytest.approx(want, rel=2e-3, abs=2e-9)


def test_a_rod_that_gives_moves_the_piston(rig, drive):
    """As if the encoder had seen the piston's own motion: x + F / k."""
    (motion, w), give = windows(drive(substeps=2)), 2e-7
    F = 800.0 * np.sin(40.0 * np.asarray(w.t))
    parts = np.linspace(0.0, 1.0, w.x_fine.shape[-1])
    within = F[:, :-1, None] + parts * np.diff(F, axis=1)[..., None]
    own = add(rig, [EFFECTS["rod_compliance"](give=give)])
    got = np.array(imbalance(own, motion, w._replace(F=jnp.asarray(F))))
    moved = w._replace(x_fine=w.x_fine + give * within)
    want = np.array(imbalance(rig, motion, moved))
    # The encoder's displacement is what the balance is short of.
    assert np.allclose(got, want, rtol=1e-9, atol=1e-15)
    assert np.max(np.abs(got - np.array(imbalance(rig, motion, w)))) > 1e-7


def test_the_openings_are_those_of_the_command(rig, drive):
    """A dead band and a delay of two ticks, by hand."""
    motion = drive().motion
    own = add(
        rig,
        [
            EFFECTS["valve_delay"](tau_u=2e-3),
            EFFECTS["valve_deadband"](u_dbp=0.1, u_dbn=0.2),
        ],
    )
    up, down = map(np.asarray, openings(own, motion))
    late = np.pad(motion.u, ((0, 0), (2, 0)), mode="edge")[:, : up.shape[1]]
    assert np.allclose(up, np.maximum(late - 0.1, 0), atol=1e-12)
    assert np.allclose(down, np.maximum(-late - 0.2, 0), atol=1e-12)
