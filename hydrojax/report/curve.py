"""The part of report.json that holds a curve: see `trace --discover`."""

from __future__ import annotations

from pydantic import Field

from hydrojax.errors import COUNT
from hydrojax.report.parts import Name, Part, Share, Size, Unit


class CurveRecord(Part):
    """A curve for what no known effect explains; SI."""

    name: Name = Field(description="of the effect in my_effects.py")
    place: Name = Field(description="where in the rig it acts")
    signal: Name = Field(
        description="what it is over; P_mean is (P_a1 + P_a2) / 2, P_net P_a2 - P_a1"
    )
    signal_unit: Unit = Field(description="of `s`, `seen` and `rug`")
    factor: str = Field("", description="signal that multiplies the curve, or none")
    unit: Unit = Field(description="of `y`, `std` and `law_y`")
    s: list[float] = Field(max_length=COUNT, description="values of the signal")
    y: list[float] = Field(
        max_length=COUNT,
        description="the curve there, less what the rig's fitted parameters can follow",
    )
    std: list[Size] = Field(
        max_length=COUNT, description="its standard deviation, over the whole curve"
    )
    extrapolated: list[bool] = Field(
        [],
        max_length=COUNT,
        description="whether no fitted log has samples about there",
    )
    seen: tuple[float, float] = Field(description="range on which it rests")
    rug: list[float] = Field(
        [], max_length=COUNT, description="samples of the signal in the fitted logs"
    )
    p_value: Share | None = Field(
        None, description="family-wise, over all places and signals"
    )
    before: dict[str, Size | None] = Field(
        {}, description="errors on the validation logs without it, RMS, by channel"
    )
    after: dict[str, Size | None] = Field({}, description="and with it")
    share: Share | None = Field(
        None, description="part of the squared error above the noise that it takes"
    )
    test_before: dict[str, Size | None] = Field(
        {}, description="errors on the test logs without any curve, RMS, by channel"
    )
    test_after: dict[str, Size | None] = Field({}, description="and with all of them")
    alike: list[str] = Field([], description="curves that do as well")
    law: str = Field("", description="a formula that does as well as the curve")
    law_y: list[float] | None = Field(
        None, description="its values, less what is left out of `y`"
    )
