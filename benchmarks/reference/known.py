# ruff: noqa: E501  (texts of the pages)
"""What is known of each effect beside its declaration: sizes, and how to tell it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

FOLDER = Path(__file__).parents[2] / "docs/reference/effects"
MEASURED = FOLDER / "signatures.json"
"""What `benchmarks.reference.signatures` measured."""


class Known(NamedTuple):
    """What is known of an effect beside its declaration.

    Attributes:
        at: strengths and shape of the picture, SI.
        usual: size on real rigs.
        tell: what separates it from its look-alikes.
    """

    at: Mapping[str, float]
    usual: str
    tell: str


KNOWN: dict[str, Known] = {
    "valve_delay": Known(
        {"tau_u": 2e-3},
        "half a sample to two samples of the controller, 0.5 to 2 ms at 1 kHz; with a fieldbus between, up to 20 ms",
        "Its phase grows without end with frequency; that of a spool bends toward 180 degrees. Excite beyond the spool's natural frequency, and log faster than the delay.",
    ),
    "valve_hysteresis": Known(
        {"u_h": 0.1},
        "under 0.5 % of full command on a servo valve, 3 to 6 % on a proportional valve without spool feedback",
        "It does not depend on frequency: a slow triangle through zero shows the same loop as a fast one, where a lag or delay shows none. Dither removes it.",
    ),
    "valve_rate_limit": Known(
        {"slew": 1 / 50},
        "full stroke in 5 to 10 ms on a servo valve, 30 to 100 ms on a proportional valve",
        "It depends on amplitude: the same frequency at a third of the amplitude shows nothing, where a lag or delay shows the same phase.",
    ),
    "valve_lag": Known(
        {"tau": 1 / (2 * np.pi * 80)},
        "60 to 250 Hz on servo valves, 10 to 60 Hz on proportional valves; damping ratio 0.5 to 1",
        "Its phase bends toward 180 degrees and its gain falls, those of a delay do not. Excite beyond its natural frequency; slow logs do not show it.",
    ),
    "valve_bias": Known(
        {"u_0": 0.1},
        "up to 2 % of full command; drifts with temperature and supply pressure",
        "It pushes the same way whatever the sign of the command. Leakage does so too, but in proportion to the load pressure: hold several loads with the joint at rest.",
    ),
    "valve_deadband": Known(
        {"u_dbp": 0.15, "u_dbn": 0.15},
        "0 to 3 % of full command on servo valves, 5 to 20 % on proportional valves",
        "Flow is missing by the same amount at every command beyond it: look at commands of one sign and then of the other. A bias does not turn its sign with the command.",
    ),
    "flow_curve": Known(
        {"k": 0.3},
        "none on servo valves; most proportional spools with notches have one, with an exponent of 1.5 to 3",
        "It needs commands from small to full. Where only small ones are logged it is a smaller valve constant; a supply loss depends on flow and not on the command itself.",
    ),
    "return_overlap": Known(
        {"o_n1": 0.05, "o_n2": 0.05},
        "within a few per cent of the stroke on servo valves; on mobile valves up to the whole dead band, and with edges open at centre where a counterbalance valve must close",
        "The supply's edges stay as they are: what is missing grows with the pressure of the chamber that empties. Look at small commands under several loads.",
    ),
    "orifice_transition": Known(
        {"dP_t2": (0.8e6) ** 2},
        "laminar below 0.01 to 0.3 MPa, more in cold oil",
        "It shows only where the drop over an edge is small: load the cylinder until a chamber comes near the supply or the return.",
    ),
    "underlap": Known(
        {"u_ul": 0.1},
        "up to 3 % of full command; the flow at rest is then up to 4 % of the rated flow",
        "It pulls both chambers to the middle between supply and return, and vanishes at large commands; leakage does neither.",
    ),
    "counterbalance": Known(
        {"k_1": 9e14, "k_2": 9e14, "P_set": 15e6},
        "set to 1.3 times the largest load pressure, pilot ratio 3 to 10",
        "Outflow is throttled, inflow is free: compare lowering with raising at one speed. It depends on the other line's pressure.",
    ),
    "supply_line_drop": Known(
        {"k_s": 4e14},
        "0.05 to 0.5 MPa at rated flow",
        "It grows with the square of the flow and acts only on the chamber that is being filled. Log the supply pressure at the valve, and it is gone.",
    ),
    "port_relief": Known(
        {"g_1": 2e-13, "g_2": 2e-13, "P_set1": 7.5e6, "P_set2": 7.5e6},
        "opens at 15 to 35 MPa; 1e-11 to 1e-9 m³/(s·Pa) above",
        "It acts above its setting only, where a leak acts from zero. A log that never reaches the setting shows none of it.",
    ),
    "return_line_drop": Known(
        {"k_r": 4e14},
        "0.2 to 1 MPa at rated flow",
        "It grows with the square of the flow and acts only on the chamber that drains. Log the return pressure at the valve, and it is gone.",
    ),
    "pressure_compensation": Known(
        {"s": 0.5},
        "margin 0.4 to 1.5 MPa; 1 where the flow does not depend on the load at all",
        "Move at one command against different loads, or at different supply pressures: an orifice changes its flow with the root of the drop, a compensated valve does not.",
    ),
    "internal_leakage": Known(
        {"c_il": 2e-12},
        "a good seal below 1e-14 m³/(s·Pa), a worn one 1e-13 to 1e-11",
        "Hold a load with the valve closed: the chambers' pressures approach each other. With leakage to the outside both fall.",
    ),
    "external_leakage": Known(
        {"c_el": 1e-12},
        "below 1e-14 m³/(s·Pa) on a good rod seal, up to 1e-12 on a worn one",
        "Hold a load with the valve closed: both pressures fall. With leakage between the chambers they approach each other; underlap stops at half the supply pressure.",
    ),
    "dead_volume": Known(
        {"V_01": 2e-5, "V_02": 2e-5},
        "5 to 100 cm³ with the valve on the cylinder, litres with hoses",
        "Near the ends of the stroke it weighs more than in the middle, a bulk modulus weighs the same: log at several positions. An assembly offset (delta_1, delta_2) is the same thing.",
    ),
    "entrained_air": Known(
        {"alpha": 0.005},
        "0.1 to 2 % of the volume at atmospheric pressure",
        "It softens the oil at low pressure only: vary the pressure level (supply, load). A lower bulk modulus softens it everywhere.",
    ),
    "viscous_friction": Known(
        {"b": 3000.0},
        "1 to 5 kN·s/m on seals of 40 to 80 mm",
        "It is a straight line through zero in force against speed. k_vp and k_vn of the base model have nearly its shape: use several constant speeds, from creeping to fast.",
    ),
    "stribeck": Known(
        {"k_st": 300.0, "v_s": 5e-3},
        "10 to 80 % of the Coulomb level, over 1 to 20 mm/s",
        "It is there at low speed only, and turns its sign with the motion. Cross zero speed slowly and often; lag and bristle damping show in the reversal itself and grow with acceleration.",
    ),
    "film_friction": Known(
        {"k_h": 60.0, "n": 0.5},
        "about the Coulomb friction of a soft seal, at 10 mm/s (an estimate), with the root of the speed",
        "It rises steeply at low speed and flattens above, where viscous friction is a straight line and Stribeck friction falls: move at many speeds, also the lowest, and at two pressures.",
    ),
    "friction_at_rest": Known(
        {"s": 1.0},
        "all of it (1) in a cylinder whose seals hold at rest, none in the paper's",
        "It is there only while the piston creeps or stands: stop often, and let the force change while it stands. Stribeck friction falls within the sliding itself, at a speed of its own.",
    ),
    "bristle_damping": Known(
        {"sigma_1": 3e4},
        "10 to 300 kN·s/m",
        "It is there only while the bristles bend, over the first micrometres after a reversal: many reversals, logged at 1 kHz or faster.",
    ),
    "frictional_lag": Known(
        {"tau_h": 0.05},
        "20 to 300 ms",
        "Force against speed becomes a loop that widens with frequency: repeat one amplitude of speed at several frequencies, without reversals.",
    ),
    "pressure_friction": Known(
        {"kappa": 5e-5},
        "5 to 30 % of the friction over the range of pressure",
        "It needs a change of the mean pressure, which force control hardly makes: log at two or three supply pressures.",
    ),
    "position_friction": Known(
        {"s_1": 0.15},
        "5 to 25 % of the Coulomb level along the stroke",
        "It repeats at the same places: cross the stroke more than once, at one speed.",
    ),
    "friction_drift": Known(
        {"a": 0.3, "tau": 6.0},
        "0.5 to 1 % of the friction for each kelvin",
        "It follows time and not place or load: repeat the same run warm.",
    ),
    "maxwell_slip": Known(
        {"f_p": 200.0, "f_n": 200.0, "z_m": 1e-3, "gap": 0.4},
        "a pin or a linkage with play in front of what rubs: tenths of a millimetre to several; without play, a seal that bends before it slides",
        "After every turn the force keeps away over the same stretch of the way, fast or slow, and it stays at rest: turn at several amplitudes, some smaller than that stretch.",
    ),
    "payload_inertia": Known(
        {"m": 100.0},
        "the mass between piston and load cell, 2 to 20 kg",
        "It follows the acceleration, so fast motion shows it best; a lag of the load cell follows the rate of the force, also with the joint locked.",
    ),
    "gravity_load": Known(
        {"w_s": 80.0, "w_c": 80.0},
        "the weight of that mass, 20 to 200 N",
        "It follows the angle: cover it widely and slowly. At one angle it is a constant force, as k_0 is.",
    ),
    "rod_compliance": Known(
        {"give": 1 / 2e7},
        "5 to 100 MN/m",
        "With the joint locked it acts as a softer oil, in proportion to the rate of the force; it does not change along the stroke, as the oil does.",
    ),
    "backlash": Known(
        {"b": 5e-5},
        "10 to 200 µm in worn pins",
        "It is crossed only where the force changes sign: references through zero show it, those with an offset do not.",
    ),
    "loadcell_lag": Known(
        {"tau_F": 2e-3},
        "the amplifier's filter, 50 Hz to 1 kHz",
        "Only F is late, the pressures are not. Delay or lag on the valve makes pressures and force late together.",
    ),
    "loadcell_gain": Known(
        {"eps": 0.03},
        "0.1 to 3 %",
        "An area that is off by as much gives the same residual: hang a known weight on the load cell.",
    ),
    "loadcell_bias": Known(
        {"b": 40.0},
        "5 to 100 N",
        "Unload the cell and read it. It stands at every speed and force; a weight between piston and cell (gravity_load) turns with the joint.",
    ),
    "channel_skew": Known(
        {"tau_s": 1e-3},
        "0.1 to 2 ms between two amplifiers or loggers",
        "It keeps the force's shape at every frequency, where a filter rounds it: use force steps. Record one signal on both channels to measure it.",
    ),
    "pressure_sensor_lag": Known(
        {"tau_P": 1e-3},
        "a time constant of 0.2 to 2 ms",
        "The pressures are late and the force is not: steps of the command with the joint locked.",
    ),
    "pressure_sensor_gain": Known(
        {"eps_1": 0.01, "eps_2": 0.0},
        "0.1 to 1 %",
        "It grows with the pressure, where a bias does not: log at two levels, or exchange the sensors. Both off by as much look like an area, or a load cell's gain.",
    ),
    "pressure_sensor_bias": Known(
        {"b_1": 1e5, "b_2": 0.0},
        "0.1 to 0.5 % of the sensor's range",
        "Read the sensors with the pump off. As a force it is a constant, as k_0 and the load cell's zero are.",
    ),
    "signal_filter": Known(
        {"tau": 1 / (2 * np.pi * 15)},
        "a logger's low-pass of 0.5 to 20 Hz",
        "Both pressures are smooth beyond its frequency though the command is not; look at a step at full rate.",
    ),
}  # fmt: skip
